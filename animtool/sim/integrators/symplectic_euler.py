"""Semi-implicit Euler: the velocity first, then the position along the new velocity."""

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
    after = v + h * equations.acceleration(t, x, v)
    return Step(np.array((x + h * after, after)))


INTEGRATOR = Integrator(
    "symplectic_euler",
    "the velocity first, then along the new one; cheap, and keeps energy in bounds",
    order=1,
    form=Form.ACCELERATIONS,
    step=_step,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    evaluations=1,
    symplectic=True,
)
