"""Newton's method for the equations of implicit steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.system import Matrix

Residual: TypeAlias = Callable[[FloatArray], FloatArray]

# Tolerance of the last correction over the unknowns: convergence is quadratic, so what
# remains is rounding.
SOLVED = 1e-10
# Velocities that move a particle by less than this fraction of its position count as 0:
# a body coming to rest has no velocity to compare with.
AT_REST = 1e-3
MAX_CORRECTIONS, MAX_HALVINGS = 30, 10
# Finite-difference step: the square root of machine epsilon.
NUDGE = 1.5e-8


def solve_stage(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    """Solve ``y = base + scale · rate(t, y)``; None if it does not converge.

    Of a system of second order only the velocities are unknowns. Where the system does
    not say its derivatives, they are taken by differences, one evaluation an unknown.
    The scale is the step times the method's factor [s].
    """
    if equations.second is None:
        return _first_order(equations, t, base, guess, scale)
    return _second_order(equations, t, base, guess, scale)


def _first_order(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    shape = base.shape

    def residual(flat: FloatArray) -> FloatArray:
        y = flat.reshape(shape)
        left: FloatArray = base + scale * equations.rate(t, y) - y
        return left.ravel()

    def matrix(flat: FloatArray, at: FloatArray) -> Matrix:
        slope = equations.jacobian(t, flat.reshape(shape))
        if slope is None:
            return -differences(residual, flat, at)
        return _less(slope * scale)

    solution = _newton(residual, matrix, guess.ravel(), 0.0)
    return None if solution is None else solution.reshape(shape)


def _second_order(
    equations: Equations, t: float, base: FloatArray, guess: FloatArray, scale: float
) -> FloatArray | None:
    shape = base[1].shape

    def state(flat: FloatArray) -> FloatArray:
        v = flat.reshape(shape)
        return np.array((base[0] + scale * v, v))

    def residual(flat: FloatArray) -> FloatArray:
        x, v = state(flat)
        left: FloatArray = base[1] + scale * equations.acceleration(t, x, v) - v
        return left.ravel()

    def matrix(flat: FloatArray, at: FloatArray) -> Matrix:
        slopes = equations.jacobians(t, *state(flat))
        if slopes is None:
            return -differences(residual, flat, at)
        by_x, by_v = slopes
        return _less(by_v * scale + by_x * (scale * scale))

    slow = AT_REST * float(np.abs(base[0]).max(initial=0.0)) / abs(scale)
    solution = _newton(residual, matrix, guess[1].ravel(), slow)
    return None if solution is None else state(solution)


def differences(function: Residual, point: FloatArray, value: FloatArray) -> FloatArray:
    """Return the Jacobian ``(n, n)`` of a function by finite differences."""
    size = max(float(np.abs(point).max(initial=0.0)), 1e-3)
    columns = np.zeros((len(value), len(point)))
    for i in range(len(point)):
        moved = point.copy()
        moved[i] += NUDGE * max(abs(float(point[i])), size)
        columns[:, i] = (function(moved) - value) / (moved[i] - point[i])
    return columns


def _newton(
    residual: Residual,
    matrix: Callable[[FloatArray, FloatArray], Matrix],
    start: FloatArray,
    least: float,
) -> FloatArray | None:
    """Return the root of a residual ``(n,)``; the matrix is its negative Jacobian.

    Unknowns below the least size are as good as 0.
    """
    point, left = start, residual(start)
    for _ in range(MAX_CORRECTIONS):
        correction = _solved(matrix(point, left), left)
        if correction is None:
            return None
        point, left = _corrected(residual, point, left, correction)
        if not np.isfinite(left).all():
            return None
        size = max(float(np.abs(point).max(initial=0.0)), least)
        if float(np.abs(correction).max(initial=0.0)) <= SOLVED * size + 1e-300:
            return point
    return None


def _corrected(
    residual: Residual, point: FloatArray, left: FloatArray, correction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the next iterate and residual, with a shorter step where it doubled."""
    size = float(np.linalg.norm(left))
    moved, after = point, left
    for halving in range(MAX_HALVINGS):
        moved = point + correction * 0.5**halving
        after = residual(moved)
        if float(np.linalg.norm(after)) <= 2 * size or size == 0:
            break
    return moved, after


def _less(matrix: Matrix) -> Matrix:
    """Return the identity minus a matrix."""
    if isinstance(matrix, np.ndarray):
        return np.eye(len(matrix)) - matrix
    from scipy.sparse import eye_array

    return eye_array(matrix.shape[0], format="csc") - matrix


def _solved(matrix: Matrix, right: FloatArray) -> FloatArray | None:
    if not isinstance(matrix, np.ndarray):
        return _solved_sparse(matrix, right)
    try:
        solution = np.linalg.solve(matrix, right).astype(np.float64, copy=False)
    except np.linalg.LinAlgError:
        return None
    return solution if np.isfinite(solution).all() else None


def _solved_sparse(matrix: Matrix, right: FloatArray) -> FloatArray | None:
    from scipy.sparse.linalg import splu

    try:
        solution: FloatArray = splu(matrix.tocsc()).solve(right)
    except RuntimeError:
        # The matrix is singular.
        return None
    return solution if np.isfinite(solution).all() else None
