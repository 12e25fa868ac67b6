"""Reads and writes animated points: caches of meshes, curves and particles."""
