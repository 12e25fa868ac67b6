"""Rigs as prims: skeletons, meshes, and where a stage has them."""
