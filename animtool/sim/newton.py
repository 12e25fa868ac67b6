"""Newton's method for the equations of implicit steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.system import Matrix

Residual: TypeAlias = Callable[[FloatArray], FloatArray]

# Relative tolerance of the last correction: as convergence is quadratic, the remaining
# error is rounding.
CONVERGED_CORRECTION = 1e-10
# Velocities that move a particle by less than this fraction of its position count as 0,
# as a body at rest has no velocity to which errors could be relative.
REST_FRACTION = 1e-3
MAX_CORRECTIONS, MAX_HALVINGS = 30, 10
# Finite-difference step: the square root of machine epsilon.
DIFFERENCE_STEP = 1.5e-8


def solve_stage(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    """Solve ``y = base + scale · rate(t, y)`` by Newton's method; None on failure.

    For second-order systems only the velocities are unknowns. Without Jacobians from
    the system, finite differences are used, with one evaluation for each unknown.
    ``scale`` is the step times the method's factor [s].
    """
    if equations.second_order is None:
        return _solve_first_order(equations, t, base, guess, scale)
    return _solve_second_order(equations, t, base, guess, scale)


def _solve_first_order(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    """Solve an implicit stage of a first-order system for the complete state."""
    shape = base.shape

    def residual(unknowns: FloatArray) -> FloatArray:
        y = unknowns.reshape(shape)
        difference: FloatArray = base + scale * equations.rate(t, y) - y
        return difference.ravel()

    def matrix(unknowns: FloatArray, residuals: FloatArray) -> Matrix:
        jacobian = equations.jacobian(t, unknowns.reshape(shape))
        if jacobian is None:
            return -finite_differences(residual, unknowns, residuals)
        return _identity_minus(jacobian * scale)

    solution = _find_root(residual, matrix, guess.ravel(), 0.0)
    return None if solution is None else solution.reshape(shape)


def _solve_second_order(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    """Solve an implicit stage of a second-order system for the velocities alone."""
    shape = base[1].shape

    def full_state(unknowns: FloatArray) -> FloatArray:
        v = unknowns.reshape(shape)
        return np.array((base[0] + scale * v, v))

    def residual(unknowns: FloatArray) -> FloatArray:
        x, v = full_state(unknowns)
        difference: FloatArray = base[1] + scale * equations.acceleration(t, x, v) - v
        return difference.ravel()

    def matrix(unknowns: FloatArray, residuals: FloatArray) -> Matrix:
        jacobians = equations.jacobians(t, *full_state(unknowns))
        if jacobians is None:
            return -finite_differences(residual, unknowns, residuals)
        da_dx, da_dv = jacobians
        return _identity_minus(da_dv * scale + da_dx * (scale * scale))

    rest_velocity = REST_FRACTION * float(np.abs(base[0]).max(initial=0.0)) / abs(scale)
    solution = _find_root(residual, matrix, guess[1].ravel(), rest_velocity)
    return None if solution is None else full_state(solution)


def finite_differences(
    function: Residual, point: FloatArray, function_value: FloatArray
) -> FloatArray:
    """Return the Jacobian ``(n, n)`` of a function by finite differences."""
    min_scale = max(float(np.abs(point).max(initial=0.0)), 1e-3)
    jacobian = np.zeros((len(function_value), len(point)))
    for i in range(len(point)):
        shifted_point = point.copy()
        shifted_point[i] += DIFFERENCE_STEP * max(abs(float(point[i])), min_scale)
        jacobian[:, i] = (function(shifted_point) - function_value) / (
            shifted_point[i] - point[i]
        )
    return jacobian


def _find_root(
    residual: Residual,
    matrix: Callable[[FloatArray, FloatArray], Matrix],
    start: FloatArray,
    min_magnitude: float,
) -> FloatArray | None:
    """Return the root ``(n,)`` of a residual; ``matrix`` is its negative Jacobian.

    ``min_magnitude`` is the magnitude below which unknowns count as 0.
    """
    point, residuals = start, residual(start)
    for _ in range(MAX_CORRECTIONS):
        correction = _solve_linear(matrix(point, residuals), residuals)
        if correction is None:
            return None
        point, residuals = _line_search(residual, point, residuals, correction)
        if not np.isfinite(residuals).all():
            return None
        max_magnitude = max(float(np.abs(point).max(initial=0.0)), min_magnitude)
        tolerance = CONVERGED_CORRECTION * max_magnitude + 1e-300
        if float(np.abs(correction).max(initial=0.0)) <= tolerance:
            return point
    return None


def _line_search(
    residual: Residual, point: FloatArray, residuals: FloatArray, correction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the next iterate and its residuals, halving steps that overshoot."""
    residual_norm = float(np.linalg.norm(residuals))
    new_point, new_residuals = point, residuals
    for halving_count in range(MAX_HALVINGS):
        new_point = point + correction * 0.5**halving_count
        new_residuals = residual(new_point)
        new_norm = float(np.linalg.norm(new_residuals))
        if new_norm <= 2 * residual_norm or residual_norm == 0:
            break
    return new_point, new_residuals


def _identity_minus(matrix: Matrix) -> Matrix:
    """Return the identity minus a matrix."""
    if isinstance(matrix, np.ndarray):
        return np.eye(len(matrix)) - matrix
    from scipy.sparse import eye_array

    return eye_array(matrix.shape[0], format="csc") - matrix


def _solve_linear(matrix: Matrix, rhs: FloatArray) -> FloatArray | None:
    """Return the solution of a dense or sparse linear system; None if singular."""
    solution: FloatArray
    try:
        if isinstance(matrix, np.ndarray):
            solution = np.linalg.solve(matrix, rhs).astype(np.float64, copy=False)
        else:
            from scipy.sparse.linalg import splu

            solution = splu(matrix.tocsc()).solve(rhs)
    except (np.linalg.LinAlgError, RuntimeError):  # of dense, of sparse matrices
        return None
    return solution if np.isfinite(solution).all() else None
