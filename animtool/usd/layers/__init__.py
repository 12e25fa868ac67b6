"""Layers: opened, written in chunks, named, and kept finite."""
