"""Prims that move rigidly: props, cameras, bodies and crowd characters."""
