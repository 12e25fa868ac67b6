"""Forces on particles: a file a subject, and the table of their names."""

from animtool.systems.particles.forces.table import FORCES, find_force

__all__ = ["FORCES", "find_force"]
