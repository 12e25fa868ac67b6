"""Crowds: agents that walk to goals and avoid each other."""
