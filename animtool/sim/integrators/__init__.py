"""Integrators: one module per family, and the table of names."""

from animtool.sim.integrators.integrator import INTEGRATORS, find_integrator

__all__ = ["INTEGRATORS", "find_integrator"]
