"""Particles of a scene."""
