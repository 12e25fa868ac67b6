"""Fastest modes of a system, which limit its steps."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.newton import finite_differences

# The largest number of state components for finite-difference Jacobians.
MAX_STATE_SIZE = 240


def modes_at(equations: Equations, t: float, state: FloatArray) -> FloatArray | None:
    """Return the fastest modes at a state as (ω, ζ) ``(M, 2)``; None if unknown.

    The modes that the system reports; for small states without them, the eigenvalues of
    a finite-difference Jacobian. Modes that grow physically are left out.
    """
    reported_modes = equations.system.frequencies(t, state)
    if reported_modes is not None:
        return reported_modes
    if state.size > MAX_STATE_SIZE or not np.isfinite(state).all():
        return None

    def rate(flat_state: FloatArray) -> FloatArray:
        rates: FloatArray = equations.rate(t, flat_state.reshape(state.shape)).ravel()
        return rates

    jacobian = finite_differences(rate, state.ravel(), rate(state.ravel()))
    if not np.isfinite(jacobian).all():
        return None
    eigenvalues = np.linalg.eigvals(jacobian)
    magnitudes = np.abs(eigenvalues)
    # Finite differences have rounding errors relative to the largest value.
    is_relevant = magnitudes > 1e-6 * magnitudes.max(initial=0.0)
    is_relevant &= eigenvalues.real <= 1e-6 * magnitudes
    damping_ratios = -eigenvalues.real / np.where(magnitudes > 0, magnitudes, 1.0)
    damping_ratios = np.maximum(damping_ratios, 0.0)
    damping_ratios = np.where(damping_ratios < 1e-6, 0.0, damping_ratios)
    modes: FloatArray = np.stack([magnitudes, damping_ratios], axis=1)[is_relevant]
    return modes
