"""Ropes, strands, cloth and volumes of a scene."""
