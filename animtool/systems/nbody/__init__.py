"""N-body gravity: bodies and galaxies that attract each other."""
