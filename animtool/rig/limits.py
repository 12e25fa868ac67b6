"""Joint limits: ranges of angles and slides, cones and twists of ball joints."""

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
    # cycle x, y, z; None for no limit.
    swing: tuple[float, float] | None = None
    # Minimum and maximum rotation about the axis [rad]; None for no limit; (0, 0) for a
    # joint of two degrees of freedom that cannot twist.
    twist: tuple[float, float] | None = None
    # Unit axis in the joint's rest frame, usually along the bone.
    twist_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def axes(self) -> FloatArray:
        """Twist axis and the two swing axes, unit rows ``(3, 3)``."""
        return _twist_swing_axes(self.twist_axis)

    def excess(self, rotations: FloatArray) -> FloatArray:
        """Return the angle by which rotations ``(F, 4)`` exceed the limits [rad]."""
        return so3.angle_between(rotations, self.clamped(rotations))

    def clamped(self, rotations: FloatArray) -> FloatArray:
        """Return rotations ``(F, 4)`` with swing and twist clamped.

        The swing is shortened along its own direction until it lies on the ellipse.
        """
        rotations = np.asarray(rotations, np.float64)
        swing, twist = swing_twist(rotations, self.twist_axis)
        is_outside = np.zeros(len(twist), np.bool_)
        if self.twist is not None:
            # The revolution nearest to the middle: ranges may exceed half a revolution.
            middle = (self.twist[0] + self.twist[1]) / 2
            revolutions = 2 * np.pi * np.round((twist - middle) / (2 * np.pi))
            twist_in_range = twist - revolutions
            twist = np.clip(twist_in_range, *self.twist)
            is_outside |= twist != twist_in_range
        if self.swing is not None:
            swing_vector = so3.log(swing)
            swing_components = swing_vector @ self.axes[1:].T
            cone_widths = np.maximum(self.swing, MIN_CONE)
            relative_swing = np.linalg.norm(swing_components / cone_widths, axis=-1)
            is_outside |= relative_swing > 1
        if not is_outside.any():
            return rotations
        if self.swing is not None:
            divisors = np.maximum(relative_swing[is_outside], 1.0)[:, None]
            swing[is_outside] = so3.exp(swing_vector[is_outside] / divisors)
        clamped_twist = so3.from_axis_angle(self.twist_axis, twist[is_outside])
        rotations_inside = so3.multiply(swing[is_outside], clamped_twist)
        rotations_outside = rotations[is_outside]
        is_rounding = (
            so3.angle_between(rotations_inside, rotations_outside) < LIMIT_TOLERANCE
        )
        clamped_rotations = rotations.copy()
        clamped_rotations[is_outside] = np.where(
            is_rounding[:, None], rotations_outside, rotations_inside
        )
        return clamped_rotations


# Minimum cone width; with zero width, rounding would always exceed it [rad].
MIN_CONE = 1e-12
# Rotations that differ by less are equal up to rounding [rad].
LIMIT_TOLERANCE = 1e-9


def swing_twist(
    rotations: ArrayLike, axis: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray]:
    """Split rotations ``(F, 4)`` into swing ``(F, 4)`` and twist ``(F,)`` [rad].

    ``q = swing · twist``: twist about the axis in [-π, π], swing about a perpendicular
    axis. A swing of half a revolution leaves the twist undefined; it is then 0.

    >>> swing, twist = swing_twist([[0.0, 1.0, 0.0, 0.0]], (0, 1, 0))
    >>> float(twist[0].round(9)), swing.round(9).tolist()
    (3.141592654, [[0.0, 0.0, 0.0, 1.0]])
    """
    q = np.asarray(rotations, np.float64)
    sine_along_axis = q[:, :3] @ np.asarray(axis, np.float64)
    w = q[:, 3]
    is_undefined = np.hypot(sine_along_axis, w) < LIMIT_TOLERANCE
    half_twist = np.where(is_undefined, 0.0, np.arctan2(sine_along_axis, w))
    twist = 2 * half_twist
    twist = np.where(twist > np.pi, twist - 2 * np.pi, twist)
    twist = np.where(twist < -np.pi, twist + 2 * np.pi, twist)
    inverse_twist = so3.from_axis_angle(axis, -twist)
    swing = so3.multiply(q, inverse_twist)
    return np.where(swing[:, 3:] < 0, -swing, swing), twist


@cache
def _twist_swing_axes(axis: tuple[float, float, float]) -> FloatArray:
    """Return a twist axis and two perpendicular axes, as rows ``(3, 3)``."""
    direction = np.asarray(axis, np.float64)
    largest_component = int(np.argmax(np.abs(direction)))
    basis = np.eye(3)
    first_axis = basis[(largest_component + 1) % 3]
    first_axis = first_axis - (first_axis @ direction) * direction
    first_axis /= np.linalg.norm(first_axis)
    axes = np.stack([direction, first_axis, np.cross(direction, first_axis)])
    axes.setflags(write=False)
    return axes
