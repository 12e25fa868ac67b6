"""Fastest modes of a system, and the step sizes they allow."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator
from animtool.sim.newton import differences

# The largest number of state components for finite-difference Jacobians.
MAX_COMPONENTS = 240


def allowed_step(integrator: Integrator, modes: FloatArray) -> float | None:
    """Return the largest step that is stable for all of some modes [s].

    They are angular frequencies [rad/s] and damping ratios [1] ``(M, 2)``.

    >>> from animtool.sim.integrators.table import find_integrator
    >>> slow = np.array([[100.0, 0.0]])
    >>> round(allowed_step(find_integrator("symplectic_euler"), slow), 9)
    0.02
    """
    moving = modes[modes[:, 0] > 0]
    steps = [
        integrator.largest_step(float(omega), max(0.0, float(damping)))
        for omega, damping in moving
    ]
    known = [step for step in steps if step is not None]
    if len(known) < len(steps):
        return None
    return min(known, default=math.inf)


def modes_at(equations: Equations, t: float, state: FloatArray) -> FloatArray | None:
    """Return the fastest modes at a state ``(M, 2)``; None if unknown.

    Those that the system names; else those of its derivative by differences, where the
    state is small. What grows by itself, and is no method's fault, is left out.
    """
    named = equations.system.frequencies(t, state)
    if named is not None:
        return named
    if state.size > MAX_COMPONENTS or not np.isfinite(state).all():
        return None

    def rate(flat: FloatArray) -> FloatArray:
        rates: FloatArray = equations.rate(t, flat.reshape(state.shape)).ravel()
        return rates

    slope = differences(rate, state.ravel(), rate(state.ravel()))
    if not np.isfinite(slope).all():
        return None
    values = np.linalg.eigvals(slope)
    sizes = np.abs(values)
    # Finite differences leave rounding of the largest value.
    kept = (sizes > 1e-6 * sizes.max(initial=0.0)) & (values.real <= 1e-6 * sizes)
    damping = np.maximum(-values.real / np.where(sizes > 0, sizes, 1.0), 0.0)
    damping = np.where(damping < 1e-6, 0.0, damping)
    modes: FloatArray = np.stack([sizes, damping], axis=1)[kept]
    return modes
