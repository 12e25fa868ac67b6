"""Euler angles of any order, intrinsic and left to right, in degrees.

Order ``ZXY`` means ``R = Rz · Rx · Ry``, as in a BVH CHANNELS line. USD's
``rotateXYZ`` names the axes the other way round.
"""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.maths.so3 import IDENTITY

ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")


def axes_of(order: str) -> tuple[int, int, int]:
    """Return the axis indices of an Euler order.

    >>> axes_of("ZXY")
    (2, 0, 1)
    """
    if order not in ORDERS:
        raise ValueError(f"order {order!r} is not one of {', '.join(ORDERS)}")
    first, second, third = ("XYZ".index(letter) for letter in order)
    return first, second, third


def to_quaternion(angles: ArrayLike, order: str) -> FloatArray:
    """Return quaternions ``(F, 4)`` of Euler angles ``(F, 3)`` [deg] in a given order.

    Angles beyond 360 degrees lose no precision: they are reduced exactly, in degrees.
    Signs are continuous along F; the first is the one nearest to identity.

    >>> to_quaternion([[90, 0, 0]], "ZXY").round(4).tolist()
    [[0.0, 0.0, 0.7071, 0.7071]]
    """
    values = np.ascontiguousarray(angles, np.float64).reshape(-1, 3)
    quaternions = _kernels.euler_to_quaternion(
        values,
        np.array([[0, 1, 2]], np.int32),
        np.array([axes_of(order)], np.int32),
        IDENTITY[None].copy(),
    )
    return quaternions[:, 0]


def from_quaternion(quaternions: ArrayLike, order: str) -> FloatArray:
    """Return angles ``(F, 3)`` [deg] of quaternions ``(F, 4)``, continuous along F.

    Of the equivalent triples, each frame uses the one nearest to the previous frame
    (the first frame: nearest to zero), so revolutions accumulate. At gimbal lock only
    the sum or difference of the outer angles is determined: the first angle is kept.

    >>> from_quaternion([[0, 0, 1, 0]], "XYZ").round(9).tolist()
    [[0.0, 0.0, 180.0]]
    """
    values = np.ascontiguousarray(quaternions, np.float64).reshape(-1, 1, 4)
    axes = np.array([axes_of(order)], np.int32)
    return _kernels.quaternion_to_euler(values, axes)[:, 0]
