"""Reads and writes rigs as prims: skeletons, meshes, and their placement."""
