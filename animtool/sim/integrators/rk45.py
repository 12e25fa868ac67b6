"""An embedded Runge-Kutta pair: order five, and an estimate of the error of order four.

References:
    J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, Journal of
    Computational and Applied Mathematics 6, 1980, table 2 (RK5(4)7M).
"""

from __future__ import annotations

from animtool.sim.integrators.integrator import Control, Integrator
from animtool.sim.integrators.tableau import Tableau
from animtool.sim.stability import rate_limit

FIFTH = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
FOURTH = (
    5179 / 57600,
    0.0,
    7571 / 16695,
    393 / 640,
    -92097 / 339200,
    187 / 2100,
    1 / 40,
)
TABLEAU = Tableau(
    (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0),
    (
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        FIFTH,
    ),
    (*FIFTH, 0.0),
    tuple(a - b for a, b in zip((*FIFTH, 0.0), FOURTH, strict=True)),
)

INTEGRATOR = Integrator(
    "rk45",
    "steps by their error, six rates each: for smooth motion, the first to try",
    order=5,
    control=Control.ADAPTIVE,
    step=TABLEAU.step,
    limit=rate_limit(TABLEAU.growth()),
    growth=TABLEAU.growth(),
    evaluations=6,
    error_order=5,
)
