"""Rigs as prims: skeletons, meshes, and their placement on a stage."""
