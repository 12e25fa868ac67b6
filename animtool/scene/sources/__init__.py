"""Sources of motion: opened, joined, retimed, brought onto rigs."""
