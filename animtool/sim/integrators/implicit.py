"""Implicit methods: Euler, the trapezoidal rule, BDF2.

References:
    E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, V.1.
"""

from __future__ import annotations

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, StepResult
from animtool.sim.newton import solve_stage
from animtool.sim.stability import no_limit

# BDF2 with variable steps is unstable above the ratio 1 + √2 of successive steps.
MAX_STEP_RATIO = 2.4


@dataclass(frozen=True, slots=True)
class PreviousStep:
    """Start state and length [s] of the previous step."""

    state: FloatArray
    h: float


def implicit_euler(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult | None:
    """Advance a state by one implicit (backward) Euler step."""
    state = solve_stage(equations, t + h, y, y, h)
    return None if state is None else StepResult(state)


IMPLICIT_EULER = Integrator(
    "implicit_euler",
    "uses the rate at the end, by Newton's method; stable with any step, damps",
    order=1,
    step=implicit_euler,
    limit=no_limit,
    is_implicit=True,
)


def trapezoid(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult | None:
    """Advance a state by one step of the implicit trapezoidal method."""
    base = y + (0.5 * h) * equations.rate(t, y)
    state = solve_stage(equations, t + h, base, y, 0.5 * h)
    return None if state is None else StepResult(state)


TRAPEZOID = Integrator(
    "trapezoid",
    "uses the mean of the rates at both ends, by Newton's method; does not damp",
    order=2,
    step=trapezoid,
    limit=no_limit,
    is_implicit=True,
    is_reversible=True,
)


def bdf2(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult | None:
    """Advance a state by one step of BDF2 (two-step backward differentiation).

    The first step is an implicit Euler step.
    """
    base, scale = y, h
    previous = memory if isinstance(memory, PreviousStep) else PreviousStep(y, 0.0)
    if (
        previous.h > 0
        and previous.state.shape == y.shape
        and h / previous.h <= MAX_STEP_RATIO
    ):
        ratio = h / previous.h
        weight = 1 / (1 + 2 * ratio)
        base = (weight * (1 + ratio) ** 2) * y - (weight * ratio**2) * previous.state
        scale = h * (1 + ratio) * weight
    state = solve_stage(equations, t + h, base, y, scale)
    return None if state is None else StepResult(state, PreviousStep(y, h))


BDF2 = Integrator(
    "bdf2",
    "backward difference over two steps, by Newton's method; stable, damps little",
    order=2,
    step=bdf2,
    limit=no_limit,
    is_implicit=True,
    is_multistep=True,
)
