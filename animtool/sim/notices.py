"""What there is to say of a motion: steps too long, and why it stopped."""

from __future__ import annotations

import math
from itertools import pairwise

from animtool._types import FloatArray
from animtool.errors import Fault, Severity
from animtool.quantities import plain
from animtool.sim.division import divide
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Control, Integrator
from animtool.sim.modes import allowed_step
from animtool.sim.options import IntegrateOptions
from animtool.sim.trajectory import Stats, Status

# What to take where no step of a method is stable.
STEADY = "symplectic_euler, velocity_verlet, rk4 or implicit_euler"
_CODES = {
    Status.UNSTABLE: "SIM102",
    Status.STEP_TOO_SMALL: "SIM103",
    Status.OUT_OF_BUDGET: "SIM104",
    Status.NOT_SOLVED: "SIM105",
}


def step_notices(
    equations: Equations,
    integrator: Integrator,
    options: IntegrateOptions,
    moments: FloatArray,
    state: FloatArray,
) -> list[Fault]:
    """Return a warning where fixed steps to come are too long to be stable.

    Only of systems that say how fast they move (`System.frequencies`).
    """
    step, modes = options.step, equations.system.frequencies(float(moments[0]), state)
    if step is None or modes is None or integrator.control is not Control.FIXED:
        return []
    gaps = [(start, end) for start, end in pairwise(moments.tolist()) if end > start]
    longest = max((divide(*gap, step).h for gap in gaps), default=0.0)
    limit = allowed_step(integrator, modes)
    if limit is None or longest <= limit:
        return []
    message = f"{integrator.name} is not stable with steps of {plain(longest)} s"
    return [Fault("SIM101", message, hint=_advice(limit), severity=Severity.WARNING)]


def ending(integrator: Integrator, options: IntegrateOptions, stats: Stats) -> Fault:
    """Return what a motion stopped for, and what to change."""
    verb = "blew up" if stats.status is Status.UNSTABLE else "stopped"
    message = f"{integrator.name} {verb} at {stats.time:.6g} s: {stats.reason}"
    advice = {
        Status.UNSTABLE: _advice(stats.stable_step),
        Status.STEP_TOO_SMALL: f"the floor is {options.floor:g} s: raise the "
        "tolerance, soften what is hard there, or take radau where the system is stiff",
        Status.OUT_OF_BUDGET: "raise the budget or the tolerance, or take lsoda or "
        "radau where the system is stiff",
        Status.NOT_SOLVED: "take a shorter step",
    }
    code, hint = _CODES[stats.status], advice[stats.status]
    return Fault(code, message, hint=hint, severity=Severity.WARNING)


def _advice(stable_step: float | None) -> str:
    if stable_step is None or math.isinf(stable_step):
        return f"take a shorter step, or {STEADY}"
    if stable_step == 0:
        return f"no step of it is: take {STEADY}"
    return f"steps up to {plain(stable_step)} s are stable"
