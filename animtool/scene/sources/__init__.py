"""Sources of motion: opened, joined, retimed, mapped to rigs."""
