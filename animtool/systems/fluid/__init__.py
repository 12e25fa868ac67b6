"""Fluids: incompressible particles (position-based)."""
