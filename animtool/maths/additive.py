"""Combines additive motion with a base, and computes deltas.

============ =====================================
rotations    ``base · delta``: about the joint's axes
translations ``base + delta``, parent space
scales       ``base * delta``
weights      ``base + delta``, controls likewise
============ =====================================

The neutral delta has the identity rotation, translation and weight 0, and scale 1.
A weight [1] scales the delta; it may be negative or above 1, and broadcasts against
the values, whose last axis holds the components.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3

# Function of the values of a source and a base that returns the delta between them.
Difference: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]


def add_rotation(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return rotations ``(..., 4)`` with a delta applied, weighted by slerp.

    >>> half = np.array([0.6, 0, 0, 0.8])
    >>> add_rotation(half, half).round(2).tolist()
    [0.96, 0.0, 0.0, 0.28]
    """
    if weight is None:
        return so3.multiply(base, delta)
    weighted_delta = so3.slerp(so3.IDENTITY, delta, weight[..., 0])
    return so3.multiply(base, np.where(weight == 1, delta, weighted_delta))


def add_offset(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return translations or weights ``(..., K)`` with a delta added."""
    return base + (delta if weight is None else weight * delta)


def multiply_scale(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return scales ``(..., 3)`` multiplied by a delta.

    The weight interpolates the factor linearly, not by powers, since scales may be
    negative.
    """
    if weight is None:
        return base * delta
    return base * np.where(weight == 1, delta, 1 + weight * (delta - 1))


def rotation_delta(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the rotation delta from base to source, the inverse of `add_rotation`."""
    return so3.multiply(so3.conjugate(base), source) + 0.0


def offset_delta(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the delta from base to source, the inverse of `add_offset`."""
    return source - base


def scale_delta(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the scale delta from base to source; no base may be 0."""
    return source / base
