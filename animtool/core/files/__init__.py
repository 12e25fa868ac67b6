"""Files: the one gate to open them, and outputs that are whole or absent."""
