"""Rules on motion: one engine for clips, BVH and USD."""
