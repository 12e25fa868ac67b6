"""Clips: sampled motion as sparse keys, within a tolerance in the world."""
