"""An explicit Runge-Kutta method of order eight: scipy's."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Control, Integrator

INTEGRATOR = Integrator(
    "dop853",
    "scipy's, steps by their error: for smooth motion to many digits",
    order=8,
    control=Control.SCIPY,
    solver="scipy.integrate:DOP853",
)
