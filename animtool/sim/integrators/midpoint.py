"""The midpoint method: half of Euler's step, then a whole one along the rate there."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Integrator
from animtool.sim.integrators.tableau import Tableau
from animtool.sim.stability import rate_limit

TABLEAU = Tableau((0.0, 0.5), ((), (0.5,)), (0.0, 1.0))

INTEGRATOR = Integrator(
    "midpoint",
    "along the rate at the middle of Euler's step",
    order=2,
    step=TABLEAU.step,
    limit=rate_limit(TABLEAU.growth()),
    growth=TABLEAU.growth(),
    evaluations=2,
)
