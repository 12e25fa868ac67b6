"""Implicit Euler: along the rate at the end of the step."""

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
    state = solve_stage(equations, t + h, y, y, h)
    return None if state is None else Step(state)


INTEGRATOR = Integrator(
    "implicit_euler",
    "along the rate at the end, by Newton's method; stable with any step, damps",
    order=1,
    step=_step,
    limit=unlimited,
    implicit=True,
)
