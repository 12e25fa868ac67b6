"""Symplectic methods: semi-implicit Euler and both forms of Verlet.

The midpoint positions are those of Verlet: three consecutive ones have the second
difference h² a. The system applies constraints and contacts after each step, see
`System.settle`.

References:
    W. C. Swope et al., Journal of Chemical Physics 76, 1982, 637.
    M. Tuckerman, B. J. Berne, G. J. Martyna, Reversible multiple time scale molecular
    dynamics, Journal of Chemical Physics 97, 1992, 1990.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import EquationForm, Integrator, StepResult
from animtool.sim.stability import jury_limit


def symplectic_euler(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult:
    """Advance a state by one semi-implicit (symplectic) Euler step.

    The velocity is updated first, then the position with the new velocity.
    """
    x, v = y
    v_end = v + h * equations.acceleration(t, x, v)
    return StepResult(np.array((x + h * v_end, v_end)))


SYMPLECTIC_EULER = Integrator(
    "symplectic_euler",
    "velocity first, then position; cheap, and bounds the energy error",
    order=1,
    form=EquationForm.ACCELERATIONS,
    step=symplectic_euler,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    evaluations=1,
    is_symplectic=True,
)


def velocity_verlet(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult:
    """Advance a state by one velocity Verlet (kick-drift-kick leapfrog) step.

    The force of the second kick is reused by the next step, unless forces depend on the
    velocity, which the kick changes.
    """
    x, v = y
    cached_acceleration = memory if isinstance(memory, np.ndarray) else None
    first_acceleration = (
        equations.acceleration(t, x, v)
        if cached_acceleration is None
        else cached_acceleration
    )
    v_half = v + (0.5 * h) * first_acceleration
    x_end = x + h * v_half
    second_acceleration = equations.acceleration(t + h, x_end, v_half)
    state = np.array((x_end, v_half + (0.5 * h) * second_acceleration))
    system = equations.second_order
    is_reusable = system is not None and not system.velocity_dependent
    return StepResult(state, second_acceleration if is_reusable else None)


VELOCITY_VERLET = Integrator(
    "velocity_verlet",
    "half a kick, a drift, half a kick; bounds the energy error",
    order=2,
    form=EquationForm.ACCELERATIONS,
    step=velocity_verlet,
    limit=jury_limit(
        lambda z: [2, -2 * z, z * z - 1, 0.5 * z], lambda z: [1, -2 * z, z * z]
    ),
    drag_order=1,
    is_symplectic=True,
    is_reversible=True,
)


def position_verlet(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult:
    """Advance a state by one position Verlet (drift-kick-drift leapfrog) step."""
    x, v = y
    x_half = x + (0.5 * h) * v
    v_end = v + h * equations.acceleration(t + 0.5 * h, x_half, v)
    return StepResult(np.array((x_half + (0.5 * h) * v_end, v_end)))


POSITION_VERLET = Integrator(
    "position_verlet",
    "half a drift, a kick, half a drift; one force per step, bounds the energy error",
    order=2,
    form=EquationForm.ACCELERATIONS,
    step=position_verlet,
    limit=jury_limit(lambda z: [2, -2 * z, -1], lambda z: [1, -2 * z]),
    drag_order=1,
    evaluations=1,
    is_symplectic=True,
    is_reversible=True,
)
