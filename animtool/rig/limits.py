"""Joint limits."""

from __future__ import annotations

from functools import cache

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3


@dataclass(frozen=True, slots=True)
class RangeLimit:
    """Range of a pin's angle [rad] or a prismatic joint's slide [m]."""

    low: float
    high: float

    def excess(self, coordinate: FloatArray) -> FloatArray:
        """Return the signed excess of coordinates ``(F,)``; 0 within the range."""
        return coordinate - self.clamped(coordinate)

    def clamped(self, coordinate: FloatArray) -> FloatArray:
        """Return coordinates ``(F,)`` clamped to the range."""
        return np.clip(coordinate, self.low, self.high)


@dataclass(frozen=True, slots=True)
class BallLimit:
    """Cone and twist of a ball joint, whose motion is swing · twist."""

    # Half-angles of the cone [rad] about the two axes that follow the twist axis in the
    # cycle x, y, z; None is no limit.
    swing: tuple[float, float] | None = None
    # Least and largest turn about the axis [rad]; None is no limit, and (0, 0) the
    # joint of two degrees of freedom that cannot twist.
    twist: tuple[float, float] | None = None
    # Unit axis in the joint's rest frame, along the bone as a rule.
    twist_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def axes(self) -> FloatArray:
        """Twist axis and the two that swing is about, unit ``(3, 3)``, one a row."""
        return _axes(self.twist_axis)

    def excess(self, rotations: FloatArray) -> FloatArray:
        """Return the angle by which rotations ``(F, 4)`` exceed the limits [rad]."""
        return so3.angle_between(rotations, self.clamped(rotations))

    def clamped(self, rotations: FloatArray) -> FloatArray:
        """Return rotations ``(F, 4)`` with swing and twist clamped.

        The swing is shortened along its own direction until it lies on the ellipse.
        """
        rotations = np.asarray(rotations, np.float64)
        swing, twist = swing_twist(rotations, self.twist_axis)
        outside = np.zeros(len(twist), np.bool_)
        if self.twist is not None:
            # The revolution nearest to the middle: ranges may exceed half a revolution.
            middle = (self.twist[0] + self.twist[1]) / 2
            revolutions = 2 * np.pi * np.round((twist - middle) / (2 * np.pi))
            turned = twist - revolutions
            twist = np.clip(turned, *self.twist)
            outside |= twist != turned
        if self.swing is not None:
            across = so3.log(swing)
            parts = across @ self.axes[1:].T
            wide = np.maximum(self.swing, SMALLEST_CONE)
            reach = np.linalg.norm(parts / wide, axis=-1)
            outside |= reach > 1
        if not outside.any():
            return rotations
        if self.swing is not None:
            shorter = across[outside] / np.maximum(reach[outside], 1.0)[:, None]
            swing[outside] = so3.exp(shorter)
        clamped_twist = so3.from_axis_angle(self.twist_axis, twist[outside])
        inside = so3.multiply(swing[outside], clamped_twist)
        before = rotations[outside]
        within = so3.angle_between(inside, before) < LIMIT_TOLERANCE
        clamped = rotations.copy()
        clamped[outside] = np.where(within[:, None], before, inside)
        return clamped


# Least cone width; rounding always misses a zero one [rad].
SMALLEST_CONE = 1e-12
# Rotations that differ by less are the same but for rounding [rad].
LIMIT_TOLERANCE = 1e-9


def swing_twist(
    rotations: ArrayLike, axis: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray]:
    """Split rotations ``(F, 4)`` into swing ``(F, 4)`` and twist ``(F,)`` [rad].

    ``q = swing · twist``, the twist about the axis, in [-π, π], the swing about an
    axis at right angles to it. A swing of half a turn leaves the twist open: 0.

    >>> swing, twist = swing_twist([[0.0, 1.0, 0.0, 0.0]], (0, 1, 0))
    >>> float(twist[0].round(9)), swing.round(9).tolist()
    (3.141592654, [[0.0, 0.0, 0.0, 1.0]])
    """
    q = np.asarray(rotations, np.float64)
    along = q[:, :3] @ np.asarray(axis, np.float64)
    w = q[:, 3]
    open_twist = np.hypot(along, w) < LIMIT_TOLERANCE
    half = np.where(open_twist, 0.0, np.arctan2(along, w))
    twist = 2 * half
    twist = np.where(twist > np.pi, twist - 2 * np.pi, twist)
    twist = np.where(twist < -np.pi, twist + 2 * np.pi, twist)
    undo = so3.from_axis_angle(axis, -twist)
    swing = so3.multiply(q, undo)
    return np.where(swing[:, 3:] < 0, -swing, swing), twist


@cache
def _axes(axis: tuple[float, float, float]) -> FloatArray:
    """Return a twist axis and the two at right angles to it, one a row ``(3, 3)``."""
    direction = np.asarray(axis, np.float64)
    near = int(np.argmax(np.abs(direction)))
    basis = np.eye(3)
    first = basis[(near + 1) % 3]
    first = first - (first @ direction) * direction
    first /= np.linalg.norm(first)
    axes = np.stack([direction, first, np.cross(direction, first)])
    axes.setflags(write=False)
    return axes
