"""Symplectic methods: semi-implicit Euler and both forms of Verlet.

The positions halfway are Verlet's: three in a row have the second difference h² a.
Constraints and contacts that move positions at the end of a step are the system's
(`System.settle`).

References:
    W. C. Swope et al., Journal of Chemical Physics 76, 1982, 637.
    M. Tuckerman, B. J. Berne, G. J. Martyna, Reversible multiple time scale molecular
    dynamics, Journal of Chemical Physics 97, 1992, 1990.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Form, Integrator, Step
from animtool.sim.stability import jury_limit


def symplectic_euler(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> Step:
    """Return the state after a step: velocity first, then position."""
    x, v = y
    after = v + h * equations.acceleration(t, x, v)
    return Step(np.array((x + h * after, after)))


SYMPLECTIC_EULER = Integrator(
    "symplectic_euler",
    "velocity first, then position; cheap, and bounds the energy error",
    order=1,
    form=Form.ACCELERATIONS,
    step=symplectic_euler,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    evaluations=1,
    symplectic=True,
)


def velocity_verlet(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> Step:
    """Return the state after a step: half a kick, a drift, half a kick.

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


VELOCITY_VERLET = Integrator(
    "velocity_verlet",
    "half a kick, a drift, half a kick; bounds the energy error",
    order=2,
    form=Form.ACCELERATIONS,
    step=velocity_verlet,
    limit=jury_limit(
        lambda z: [2, -2 * z, z * z - 1, 0.5 * z], lambda z: [1, -2 * z, z * z]
    ),
    drag_order=1,
    symplectic=True,
    reversible=True,
)


def position_verlet(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> Step:
    """Return the state after a step: half a drift, a kick, half a drift."""
    x, v = y
    halfway = x + (0.5 * h) * v
    after = v + h * equations.acceleration(t + 0.5 * h, halfway, v)
    return Step(np.array((halfway + (0.5 * h) * after, after)))


POSITION_VERLET = Integrator(
    "position_verlet",
    "half a drift, a kick, half a drift; one force per step, bounds the energy error",
    order=2,
    form=Form.ACCELERATIONS,
    step=position_verlet,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    drag_order=1,
    evaluations=1,
    symplectic=True,
    reversible=True,
)
