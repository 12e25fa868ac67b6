"""Takes and rigs from one file format to another."""
