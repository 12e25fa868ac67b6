"""Forces on particles: one module per topic, and the table of names."""

from animtool.systems.particles.forces.table import FORCES, find_force

__all__ = ["FORCES", "find_force"]
