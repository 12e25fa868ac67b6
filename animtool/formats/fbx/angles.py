"""Converts Euler angles about X, Y and Z to quaternions and back."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import euler, so3

# Order XYZ as a product: X rotates first, so its factor is last.
XYZ = "ZYX"


def rotations_from_angles(angles: FloatArray, order: str) -> FloatArray:
    """Return quaternions ``(F, 4)`` of angles about X, Y and Z ``(F, 3)`` [deg].

    >>> rotations_from_angles(np.array([[90.0, 0, 0]]), XYZ).round(4).tolist()
    [[0.7071, 0.0, 0.0, 0.7071]]
    """
    return euler.to_quaternion(angles[:, euler.axes_of(order)], order)


def principal_angles(rotations: FloatArray) -> FloatArray:
    """Return XYZ angles ``(F, 3)`` [deg] of quaternions ``(F, 4)``.

    Of the equivalent triples, this is the one with Y within 90 degrees, independent of
    neighbouring frames. Tools that read the angles in another order expect it.

    >>> rotations = rotations_from_angles(np.array([[10.0, 20, 30]]), XYZ)
    >>> principal_angles(rotations).round(6).tolist()
    [[10.0, 20.0, 30.0]]
    """
    matrices = so3.to_matrix(rotations)
    sine = np.clip(-matrices[:, 2, 0], -1.0, 1.0)
    y = np.arctan2(sine, np.hypot(matrices[:, 2, 1], matrices[:, 2, 2]))
    x = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
    z = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    # In gimbal lock only the sum of the other two angles is determined.
    is_gimbal_lock = np.abs(sine) > 1.0 - 1e-12
    x = np.where(is_gimbal_lock, 0.0, x)
    z = np.where(is_gimbal_lock, np.arctan2(-matrices[:, 0, 1], matrices[:, 1, 1]), z)
    return np.asarray(np.degrees(np.stack([x, y, z], axis=1)))
