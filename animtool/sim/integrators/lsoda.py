"""Multistep methods that change between stiff and other systems: scipy's ODEPACK."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Control, Integrator

INTEGRATOR = Integrator(
    "lsoda",
    "scipy's, changes between methods for stiff and other systems by itself",
    order=5,
    control=Control.SCIPY,
    implicit=True,
    solver="scipy.integrate:LSODA",
)
