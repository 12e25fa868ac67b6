"""Integrators: one module per family, and the table of names."""

from animtool.sim.integrators.table import INTEGRATORS, find_integrator

__all__ = ["INTEGRATORS", "find_integrator"]
