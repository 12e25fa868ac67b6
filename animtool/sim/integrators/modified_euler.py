"""Modified Euler: along the mean of the velocities at both ends of Euler's step.

The velocity at the end is ``v + h a``, so positions move by ``h v + h² a / 2``.
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
    after = v + h * equations.acceleration(t, x, v)
    return Step(np.array((x + (0.5 * h) * (v + after), after)))


INTEGRATOR = Integrator(
    "modified_euler",
    "along the mean of the velocities at both ends; exact in a uniform field",
    order=1,
    form=Form.ACCELERATIONS,
    step=_step,
    limit=jury_limit(lambda z: [2, -2 * z, -0.5], lambda z: [1, -2 * z, 0.5]),
    evaluations=1,
)
