"""Array functions: rotations, curves, filters and meshes."""
