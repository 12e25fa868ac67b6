"""Crowds: agents that walk to their goals and avoid each other."""
