"""C3D: marker trajectories of optical motion capture systems."""
