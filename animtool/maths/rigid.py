"""The rigid motion between two sets of points."""

from __future__ import annotations

import numpy as np

from animtool._types import ArrayLike, FloatArray
from animtool.maths import so3

# Of the largest spread: what rounding makes of points on a line, or at one place.
FLAT = 1e-9


def rigid_motion(before: ArrayLike, after: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the turn ``(4,)`` and shift ``(3,)`` that bring points nearest to others.

    A point p goes to ``rotate(turn, p) + shift``. Points on a line leave the turn about
    it open, and points at one place any: there the least turn is taken.

    Args:
        before: At least one ``(P, 3)``.
        after: Where they are to go ``(P, 3)``.

    References:
        W. Kabsch, A solution for the best rotation to relate two sets of vectors, 1976.

    >>> turn, shift = rigid_motion([[0, 0, 0]], [[1, 2, 3]])
    >>> turn.tolist(), shift.tolist()
    ([0.0, 0.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    """
    start, end = np.asarray(before, np.float64), np.asarray(after, np.float64)
    middle, target = start.mean(axis=0), end.mean(axis=0)
    turn = _turn((start - middle).T @ (end - target), _scale(start) * _scale(end))
    return turn, np.asarray(target - so3.rotate(turn, middle), np.float64)


def _scale(points: FloatArray) -> float:
    return float(np.abs(points).max(initial=0.0))


def _turn(covariance: FloatArray, scale: float) -> FloatArray:
    ways, spreads, others = np.linalg.svd(covariance)
    if spreads[0] <= FLAT**2 * scale:
        return so3.IDENTITY.copy()
    if spreads[1] <= FLAT * spreads[0]:
        return _least_turn(ways[:, 0], others[0])
    sign = np.sign(np.linalg.det(ways) * np.linalg.det(others))
    return so3.from_matrix(others.T @ np.diag([1.0, 1.0, sign]) @ ways.T)


def _least_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the least turn from a unit vector to another."""
    axis = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(axis), a @ b))
    if not np.linalg.norm(axis) > 0:
        # Any axis across will do for half a turn.
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    return so3.from_axis_angle(axis / np.linalg.norm(axis), angle)
