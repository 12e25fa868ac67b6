"""Heun's method: along the mean of the rates at both ends of Euler's step."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Integrator
from animtool.sim.integrators.tableau import Tableau
from animtool.sim.stability import rate_limit

TABLEAU = Tableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5))

INTEGRATOR = Integrator(
    "heun",
    "along the mean of the rates at both ends of Euler's step",
    order=2,
    step=TABLEAU.step,
    limit=rate_limit(TABLEAU.growth()),
    growth=TABLEAU.growth(),
    evaluations=2,
)
