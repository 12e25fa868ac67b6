"""What cannot be integrated, found before the first step."""

from __future__ import annotations

import numpy as np

from animtool._types import ArrayLike, FloatArray
from animtool.errors import Fault, OptionError
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Control, Form, Integrator
from animtool.sim.trajectory import Checkpoint


def check_times(times: ArrayLike, checkpoint: Checkpoint | None) -> FloatArray:
    """Return times as an array.

    Raises:
        OptionError: They are no times to integrate over (SIM002).
    """
    moments = np.asarray(times, np.float64)
    message, hint = "", None
    if moments.ndim != 1 or not len(moments):
        message = f"times must be a list of at least one, not of shape {moments.shape}"
    elif not np.isfinite(moments).all():
        message = f"time {int(np.argmin(np.isfinite(moments)))} is not finite"
    elif (np.diff(moments) < 0).any():
        i = int(np.argmax(np.diff(moments) < 0))
        message = f"times run backwards, from {moments[i]:g} to {moments[i + 1]:g} s"
        hint = "what loses energy cannot be integrated backwards: begin at the start"
    elif checkpoint is not None and moments[0] != checkpoint.time:
        message = f"what is carried is at {checkpoint.time:g} s, not {moments[0]:g} s"
    if message:
        raise OptionError(Fault("SIM002", message, where="times", hint=hint))
    return moments


def check_fit(equations: Equations, integrator: Integrator) -> None:
    """Raise where a method cannot serve a system.

    Raises:
        OptionError: The method needs accelerations, or leaves no room for contacts
            (SIM006).
    """
    name, message, hint = integrator.name, "", None
    if equations.first is None and equations.second is None:
        kind = type(equations.system).__name__
        message = f"a {kind} has neither rates nor accelerations"
        hint = "derive it from FirstOrder or SecondOrder"
    elif integrator.form is Form.ACCELERATIONS and equations.second is None:
        message = f"{name} is for accelerations, and the system has rates"
        hint = "take heun or rk4"
    elif integrator.control is Control.SCIPY and equations.system.settles:
        message = f"{name} cannot stop for contacts and constraints"
        hint = "take rk45"
    if message:
        raise OptionError(Fault("SIM006", message, where="method", hint=hint))


def check_start(equations: Equations, t: float, state: FloatArray) -> None:
    """Raise where there is nothing to go on from.

    Raises:
        OptionError: The start, or its rate, is not finite or of another shape
            (SIM003).
    """
    faults = _state_faults(equations, state) or _rate_faults(equations, t, state)
    if faults:
        raise OptionError([Fault("SIM003", fault, where="state") for fault in faults])


def _state_faults(equations: Equations, state: FloatArray) -> list[str]:
    if equations.second is not None:
        if state.ndim != 3 or state.shape[0] != 2:
            return [f"the start must have shape (2, N, d), not {state.shape}"]
        held = equations.second.fixed
        if held is not None and held.shape != state.shape[1:2]:
            return [f"fixed must have shape {state.shape[1:2]}, not {held.shape}"]
        return _odd_ones("particle", state.swapaxes(0, 1), "at the start")
    return _odd_ones("component", state, "at the start")


def _rate_faults(equations: Equations, t: float, state: FloatArray) -> list[str]:
    if equations.second is not None:
        rate, wanted = equations.acceleration(t, *state), state.shape[1:]
        what, whose = "the acceleration", "the acceleration of particle"
    else:
        rate, wanted = equations.rate(t, state), state.shape
        what, whose = "the rate", "the rate of component"
    if np.shape(rate) != wanted:
        return [f"{what} must have shape {wanted}, not {np.shape(rate)}"]
    return _odd_ones(whose, rate, "at the start")


def _odd_ones(what: str, values: FloatArray, when: str) -> list[str]:
    """Return a message for each row that is not finite."""
    rows = np.isfinite(values).reshape(len(values), -1) if values.ndim else values
    odd = np.flatnonzero(~np.atleast_2d(rows).all(axis=-1))
    return [f"{what} {i} is not finite {when}" for i in odd.tolist()]
