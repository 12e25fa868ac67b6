"""Molecular dynamics: Lennard-Jones atoms and charges in a periodic box."""
