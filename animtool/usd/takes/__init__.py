"""Takes as SkelAnimations, written and read."""
