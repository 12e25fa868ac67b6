"""The Runge-Kutta method of order four that is called by the name of all."""

from __future__ import annotations

from animtool.sim.integrators.integrator import Integrator
from animtool.sim.integrators.tableau import Tableau
from animtool.sim.stability import rate_limit

TABLEAU = Tableau(
    (0.0, 0.5, 0.5, 1.0),
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)

INTEGRATOR = Integrator(
    "rk4",
    "four rates a step: exact where steps are fixed and forces smooth",
    order=4,
    step=TABLEAU.step,
    limit=rate_limit(TABLEAU.growth()),
    growth=TABLEAU.growth(),
    evaluations=4,
)
