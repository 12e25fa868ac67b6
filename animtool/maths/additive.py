"""The convention of additive motion: how deltas combine with a base.

============ =====================================
rotations    ``base · delta``: about the joint's axes
translations ``base + delta``, parent space
scales       ``base * delta``
weights      ``base + delta``, controls likewise
============ =====================================

A delta that changes nothing has rotation identity, translation and weight 0 and
scale 1. A weight [1] takes a part of the delta, may be beyond 1 or negative, and
broadcasts against the values, whose last axis holds the components.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3

# From the values of a source and a base to the delta between them.
Difference: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]


def turned(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return rotations ``(..., 4)`` with a delta, weighted along the arc from identity.

    >>> turned(np.array([0.6, 0, 0, 0.8]), np.array([0.6, 0, 0, 0.8])).round(2).tolist()
    [0.96, 0.0, 0.0, 0.28]
    """
    if weight is None:
        return so3.multiply(base, delta)
    part = so3.slerp(so3.IDENTITY, delta, weight[..., 0])
    return so3.multiply(base, np.where(weight == 1, delta, part))


def shifted(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return translations or weights ``(..., K)`` with a delta."""
    return base + (delta if weight is None else weight * delta)


def scaled(
    base: FloatArray, delta: FloatArray, weight: FloatArray | None = None
) -> FloatArray:
    """Return scales ``(..., 3)`` with a delta.

    Weighted in proportion, not by powers: scales may be negative.
    """
    if weight is None:
        return base * delta
    return base * np.where(weight == 1, delta, 1 + weight * (delta - 1))


def unturned(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the rotation delta with which `turned` gives ``source``."""
    return so3.multiply(so3.conjugate(base), source) + 0.0


def unshifted(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the delta with which `shifted` gives ``source``."""
    return source - base


def unscaled(source: FloatArray, base: FloatArray) -> FloatArray:
    """Return the delta with which `scaled` gives ``source``; no base may be 0."""
    return source / base
