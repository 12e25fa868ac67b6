"""Checks before integration, and divergence checks during it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError, warning
from animtool.core.quantities import MIN_SUSPECT_STEP, plain_number, step_hint
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import (
    EquationForm,
    Integrator,
    StepControl,
    allowed_step,
)
from animtool.sim.options import IntegrateOptions
from animtool.sim.run import step_grid
from animtool.sim.system import Energy, System
from animtool.sim.trajectory import Checkpoint, Stats, Status

# Hint when no step of a method is stable.
STABLE_METHODS = "symplectic_euler, velocity_verlet, rk4 or implicit_euler"
_STATUS_CODES = {
    Status.UNSTABLE: "SIM102",
    Status.STEP_TOO_SMALL: "SIM103",
    Status.OUT_OF_BUDGET: "SIM104",
    Status.NOT_SOLVED: "SIM105",
}


def step_warnings(
    equations: Equations,
    integrator: Integrator,
    options: IntegrateOptions,
    times: FloatArray,
    state: FloatArray,
) -> list[Fault]:
    """Return warnings about fixed steps above the run's length or stability limit.

    The limit is known for systems that report their fastest modes
    (`System.frequencies`).
    """
    step, modes = options.step, equations.system.frequencies(float(times[0]), state)
    if step is None or integrator.control is not StepControl.FIXED:
        return []
    intervals = [(start, end) for start, end in pairwise(times.tolist()) if end > start]
    max_step = max((step_grid(*span, step).h for span in intervals), default=0.0)
    notices = []
    duration = float(times[-1] - times[0])
    if step > max(duration, MIN_SUSPECT_STEP) > 0 and len(intervals) > 1:
        message = f"a step of {plain_number(step)} s is longer than the whole run of "
        message += f"{plain_number(duration)} s; steps of {plain_number(max_step)} s "
        message += "are taken"
        notices.append(warning("SIM109", message, step_hint(step)))
    stable_step = None if modes is None else allowed_step(integrator, modes)
    if stable_step is None or max_step <= stable_step:
        return notices
    message = f"{integrator.name} is not stable with steps of {plain_number(max_step)} "
    message += "s"
    return [*notices, warning("SIM101", message, _stable_step_advice(stable_step))]


def stop_warning(
    integrator: Integrator, options: IntegrateOptions, stats: Stats
) -> Fault:
    """Return a warning about why integration stopped, with a hint."""
    verb = "blew up" if stats.status is Status.UNSTABLE else "stopped"
    message = f"{integrator.name} {verb} at {stats.time:.6g} s: {stats.reason}"
    hints = {
        Status.UNSTABLE: _stable_step_advice(stats.stable_step),
        Status.STEP_TOO_SMALL: f"the smallest step is {options.floor:g} s: raise the "
        "tolerance, soften the stiffest parts, or use radau for stiff systems",
        Status.OUT_OF_BUDGET: "raise the budget or the tolerance, or use lsoda or "
        "radau for stiff systems",
        Status.NOT_SOLVED: "use a shorter step",
    }
    code, hint = _STATUS_CODES[stats.status], hints[stats.status]
    return warning(code, message, hint)


def _stable_step_advice(stable_step: float | None) -> str:
    """Return a hint that names the largest stable step, if that is known."""
    if stable_step is None or math.isinf(stable_step):
        return f"use a shorter step, or {STABLE_METHODS}"
    if stable_step == 0:
        return f"no step is stable: use {STABLE_METHODS}"
    return f"it is stable up to steps of {plain_number(stable_step)} s"


class EnergyWatch:
    """Detects divergence: non-finite states, or energy or strain out of bounds.

    The gain of energy is relative to an energy scale: the largest of the initial
    energies, the energy that may be supplied, and the potential energy released since
    the start. The energy is not checked if the scale is 0.
    """

    def __init__(self, system: System, options: IntegrateOptions) -> None:
        self._system = system
        self._options = options
        self._start_energy: Energy | None = None
        self.energy: Energy | None = None  # of the last checked state
        self._energy_scale = 0.0

    def start(self, t: float, state: FloatArray) -> None:
        """Use the energy of a state as the reference."""
        energy = self._system.energy(t, state)
        self._start_energy = self.energy = energy
        if energy is not None:
            self._energy_scale = max(
                abs(energy.total), energy.kinetic, abs(energy.potential), energy.supply
            )

    def set_system(self, system: System) -> None:
        """Replace the watched system, for example after particles were removed."""
        self._system = system

    def divergence_reason(self, t: float, state: FloatArray) -> str:
        """Return why a state has diverged; empty if it has not."""
        if not np.isfinite(state).all():
            return "its state is not finite"
        return self._energy_reason(t, state) or self._strain_reason(t, state)

    def _energy_reason(self, t: float, state: FloatArray) -> str:
        """Return why the energy of a state indicates divergence; empty if not."""
        start, current = self._start_energy, self._system.energy(t, state)
        self.energy = current
        if start is None or current is None:
            return ""
        released_potential = start.potential - current.potential
        self._energy_scale = max(self._energy_scale, current.supply, released_potential)
        max_energy_gain = self._options.growth * self._energy_scale
        energy_gain = current.total - start.total
        if self._energy_scale > 0 and not energy_gain <= max_energy_gain:
            return f"its energy rose from {start.total:.3g} J to {current.total:.3g} J"
        return ""

    def _strain_reason(self, t: float, state: FloatArray) -> str:
        """Return why the strain of springs indicates divergence; empty if not."""
        if np.isinf(self._options.stretch):
            return ""
        length_ratio = self._system.stretch(t, state)
        if length_ratio is not None and not length_ratio <= self._options.stretch:
            return f"a spring is {plain_number(length_ratio)} times its rest length"
        return ""


def times_problem(times: FloatArray) -> tuple[str, str | None]:
    """Return a message and a hint for an array that is not a list of times."""
    if not times.ndim:
        message = f"times must be a list of times, not the number {times:g}"
        return message, f"for a single time write [{times:g}]"
    shape = times.shape
    return f"times must be a list with at least one time, not of shape {shape}", None


def check_times(
    requested_times: ArrayLike, checkpoint: Checkpoint | None
) -> FloatArray:
    """Return sample times as an array; raise if they are not finite and ascending."""
    times = np.asarray(requested_times, np.float64)
    message, hint = "", None
    if times.ndim != 1 or not len(times):
        message, hint = times_problem(times)
    elif not np.isfinite(times).all():
        message = f"time {int(np.argmin(np.isfinite(times)))} is not finite"
    elif (np.diff(times) < 0).any():
        i = int(np.argmax(np.diff(times) < 0))
        message = f"times go backwards, from {times[i]:g} to {times[i + 1]:g} s"
        hint = "systems that dissipate energy cannot be integrated backwards: start at "
        hint += "the beginning"
    elif checkpoint is not None and times[0] != checkpoint.time:
        message = f"the saved state is at {checkpoint.time:g} s, not {times[0]:g} s"
    if message:
        raise OptionError(Fault("SIM002", message, where="times", hint=hint))
    return times


def check_checkpoint(checkpoint: Checkpoint, state: FloatArray) -> None:
    """Raise if a checkpoint holds the state of another system (SIM002)."""
    if checkpoint.state.shape == state.shape:
        return
    message = (
        f"the saved state has the shape {checkpoint.state.shape}, but that of the "
    )
    message += f"system is {state.shape}: it is the state of another system"
    hint = "resume the system that the checkpoint was made with"
    raise OptionError(Fault("SIM002", message, where="checkpoint", hint=hint))


def check_supported(equations: Equations, integrator: Integrator) -> None:
    """Raise if an integrator does not support the form of a system."""
    name, message, hint = integrator.name, "", None
    if equations.first_order is None and equations.second_order is None:
        kind = type(equations.system).__name__
        message = f"a {kind} has neither rates nor accelerations"
        hint = "derive it from FirstOrder or SecondOrder"
    elif (
        integrator.form is EquationForm.ACCELERATIONS and equations.second_order is None
    ):
        message = f"{name} needs accelerations, but the system has rates"
        hint = "use heun or rk4"
    elif integrator.control is StepControl.SCIPY and equations.system.settles:
        message = f"{name} cannot stop for contacts and constraints"
        hint = "take rk45"
    if message:
        raise OptionError(Fault("SIM006", message, where="method", hint=hint))


def check_start(equations: Equations, t: float, state: FloatArray) -> None:
    """Raise if the initial state is missing or invalid."""
    problems = _state_problems(equations, state) or _rate_problems(equations, t, state)
    if problems:
        raise OptionError(
            [Fault("SIM003", problem, where="state") for problem in problems]
        )


def _state_problems(equations: Equations, state: FloatArray) -> list[str]:
    """Return messages about an initial state of the wrong shape or invalid values."""
    if equations.second_order is not None:
        if state.ndim != 3 or state.shape[0] != 2:
            return [f"the start must have shape (2, N, d), not {state.shape}"]
        fixed = equations.second_order.fixed
        if fixed is not None and fixed.shape != state.shape[1:2]:
            return [f"fixed must have shape {state.shape[1:2]}, not {fixed.shape}"]
        return _non_finite_messages("particle", state.swapaxes(0, 1))
    return _non_finite_messages("component", state)


def _rate_problems(equations: Equations, t: float, state: FloatArray) -> list[str]:
    """Return messages if the initial rate has a wrong shape or is not finite."""
    if equations.second_order is not None:
        rate, expected_shape = equations.acceleration(t, *state), state.shape[1:]
        name, value_name = "the acceleration", "the acceleration of particle"
    else:
        rate, expected_shape = equations.rate(t, state), state.shape
        name, value_name = "the rate", "the rate of component"
    if np.shape(rate) != expected_shape:
        return [f"{name} must have shape {expected_shape}, not {np.shape(rate)}"]
    return _non_finite_messages(value_name, rate)


def _non_finite_messages(value_name: str, values: FloatArray) -> list[str]:
    """Return a message for each particle or component that starts non-finite."""
    is_finite = np.isfinite(np.atleast_1d(values))
    is_finite_value = np.asarray(is_finite.all(axis=tuple(range(1, is_finite.ndim))))
    indices = np.flatnonzero(~is_finite_value).tolist()
    return [f"{value_name} {i} is not finite at the start" for i in indices]
