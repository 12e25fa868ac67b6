"""An implicit Runge-Kutta method of order five for stiff systems: scipy's."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Control, Integrator

INTEGRATOR = Integrator(
    "radau",
    "scipy's, implicit, steps by their error: for stiff systems",
    order=5,
    control=Control.SCIPY,
    implicit=True,
    solver="scipy.integrate:Radau",
)
