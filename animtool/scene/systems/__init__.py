"""The systems of a scene: entries, order, run and bake."""
