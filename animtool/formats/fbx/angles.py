"""Euler angles about X, Y and Z to quaternions and back, for any order."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import euler, so3

# What XYZ is as a product: X turns first, so its factor is the last.
XYZ = "ZYX"


def rotations_of(angles: FloatArray, order: str) -> FloatArray:
    """Return quaternions ``(F, 4)`` of angles about X, Y and Z ``(F, 3)`` [deg].

    >>> rotations_of(np.array([[90.0, 0, 0]]), XYZ).round(4).tolist()
    [[0.7071, 0.0, 0.0, 0.7071]]
    """
    return euler.to_quaternion(angles[:, euler.axes_of(order)], order)


def principal_angles(rotations: FloatArray) -> FloatArray:
    """Return angles about X, Y and Z ``(F, 3)`` [deg] of quaternions, of order XYZ.

    Of the equal triples it is the one whose Y is within a quarter turn, whatever the
    frames around: tools that read the angles by another order mean that one.

    >>> turn = rotations_of(np.array([[10.0, 20, 30]]), XYZ)
    >>> principal_angles(turn).round(6).tolist()
    [[10.0, 20.0, 30.0]]
    """
    m = so3.to_matrix(rotations)
    sine = np.clip(-m[:, 2, 0], -1.0, 1.0)
    y = np.arctan2(sine, np.hypot(m[:, 2, 1], m[:, 2, 2]))
    x = np.arctan2(m[:, 2, 1], m[:, 2, 2])
    z = np.arctan2(m[:, 1, 0], m[:, 0, 0])
    # At a quarter turn only the sum of the others is determined.
    locked = np.abs(sine) > 1.0 - 1e-12
    x = np.where(locked, 0.0, x)
    z = np.where(locked, np.arctan2(-m[:, 0, 1], m[:, 1, 1]), z)
    return np.asarray(np.degrees(np.stack([x, y, z], axis=1)))
