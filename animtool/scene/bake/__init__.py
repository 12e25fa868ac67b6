"""The bake: planned, sampled, written."""
