"""Layers: opening, chunked writing, names, and finite values."""
