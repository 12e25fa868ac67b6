"""Motion rules for clips, BVH and USD takes."""
