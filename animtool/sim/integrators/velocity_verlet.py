"""Velocity Verlet: half a kick, a drift, half a kick.

References:
    W. C. Swope et al., Journal of Chemical Physics 76, 1982, 637.
"""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Form, Integrator, Step
from animtool.sim.stability import jury_limit


def _step(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> Step:
    """Return where a step leads.

    The second kick's force is the next step's first one, unless it depends on the
    velocity, which that kick changes.
    """
    x, v = y
    kept = memory if isinstance(memory, np.ndarray) else None
    first = equations.acceleration(t, x, v) if kept is None else kept
    halfway = v + (0.5 * h) * first
    moved = x + h * halfway
    second = equations.acceleration(t + h, moved, halfway)
    state = np.array((moved, halfway + (0.5 * h) * second))
    lasts = equations.second is not None and not equations.second.velocity_dependent
    return Step(state, second if lasts else None)


INTEGRATOR = Integrator(
    "velocity_verlet",
    "half a kick, a drift, half a kick; keeps energy in bounds for ever",
    order=2,
    form=Form.ACCELERATIONS,
    step=_step,
    limit=jury_limit(
        lambda z: [2, -2 * z, z * z - 1, 0.5 * z],
        lambda z: [1, -2 * z, z * z],
    ),
    drag_order=1,
    symplectic=True,
    reversible=True,
)
