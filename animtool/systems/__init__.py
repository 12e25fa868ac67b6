"""Simulated systems of scenes: the framework, and one package per kind."""
