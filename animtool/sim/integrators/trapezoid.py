"""The trapezoidal rule: along the mean of the rates at both ends of the step."""

from __future__ import annotations

from animtool._types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, Step
from animtool.sim.newton import solve_stage
from animtool.sim.stability import unlimited


def _step(
    equations: Equations,
    t: float,
    y: FloatArray,
    h: float,
    memory: object,
) -> Step | None:
    base = y + (0.5 * h) * equations.rate(t, y)
    state = solve_stage(equations, t + h, base, y, 0.5 * h)
    return None if state is None else Step(state)


INTEGRATOR = Integrator(
    "trapezoid",
    "along the mean of the rates at both ends, by Newton's method; does not damp",
    order=2,
    step=_step,
    limit=unlimited,
    implicit=True,
    reversible=True,
)
