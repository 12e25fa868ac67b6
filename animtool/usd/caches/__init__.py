"""Animated points: caches of meshes, curves and particles."""
