"""Writes and reads takes as SkelAnimations."""
