"""Integrators: a file a family, and the table of their names."""

from animtool.sim.integrators.table import INTEGRATORS, find_integrator

__all__ = ["INTEGRATORS", "find_integrator"]
