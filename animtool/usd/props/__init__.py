"""Reads and writes prims that move rigidly: props, cameras, bodies and crowds."""
