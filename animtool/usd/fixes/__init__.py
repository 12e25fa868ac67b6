"""Edits of a USD layer that fix findings with one safe remedy."""
