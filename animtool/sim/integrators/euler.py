"""Euler's method: along the rate at the start of the step."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Integrator
from animtool.sim.integrators.tableau import Tableau
from animtool.sim.stability import rate_limit

TABLEAU = Tableau((0.0,), ((),), (1.0,))

INTEGRATOR = Integrator(
    "euler",
    "along the rate at the start; grows without damping, for comparison only",
    order=1,
    step=TABLEAU.step,
    limit=rate_limit(TABLEAU.growth()),
    growth=TABLEAU.growth(),
    evaluations=1,
)
