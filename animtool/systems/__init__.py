"""Simulations of scenes: what a kind is, what takes it through time, and the kinds."""
