"""Arrays in, arrays out: rotations and Euler angles."""
