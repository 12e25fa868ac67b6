"""Position Verlet: half a drift, a kick, half a drift.

The positions halfway are Verlet's: three in a row have the second difference h² a.
Constraints and contacts that move positions at the end of a step are the system's
(`System.settle`).

References:
    M. Tuckerman, B. J. Berne, G. J. Martyna, Reversible multiple time scale molecular
    dynamics, Journal of Chemical Physics 97, 1992, 1990.
"""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Form, Integrator, Step
from animtool.sim.stability import jury_limit


def _step(
    equations: Equations,
    t: float,
    y: FloatArray,
    h: float,
    memory: object,
) -> Step:
    x, v = y
    halfway = x + (0.5 * h) * v
    after = v + h * equations.acceleration(t + 0.5 * h, halfway, v)
    return Step(np.array((halfway + (0.5 * h) * after, after)))


INTEGRATOR = Integrator(
    "position_verlet",
    "half a drift, a kick, half a drift; one force a step, energy in bounds",
    order=2,
    form=Form.ACCELERATIONS,
    step=_step,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    drag_order=1,
    evaluations=1,
    symplectic=True,
    reversible=True,
)
