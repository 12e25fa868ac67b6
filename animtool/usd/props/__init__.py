"""Prims that move as a whole: props, cameras, bodies and characters."""
