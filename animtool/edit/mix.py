"""A weighted mean of two motions."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.edit.combine import Operations, Strength, combine
from animtool.maths import so3
from animtool.motion import Motion


def mix(base: Motion, other: Motion, strength: Strength) -> Motion:
    """Return a motion on the way from one to another, weight 0 to 1.

    Rotations go along the shortest arc (slerp), the rest in a straight line; at
    weight 0 and 1 the values are exactly those of one motion. Signs of rotations
    may jump.

    >>> from animtool.take import Channel
    >>> zero, one = (Channel.from_dense(np.full((1, 1, 3), x)) for x in (0.0, 1.0))
    >>> turn = Channel.from_dense(np.array([[[0.0, 0, 0, 1]]]))
    >>> half = mix(Motion(zero, turn), Motion(one, turn), Strength(np.array([0.5])))
    >>> half.translations.rest.tolist()
    [[0.5, 0.5, 0.5]]
    """
    return combine(base, other, _MIX, strength)


def _line(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    return np.where(weight == 1, b, a + (b - a) * weight)


def _arc(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    between = so3.slerp(a, b, weight[..., 0])
    # What both hold alike stays as it is, to the last bit.
    kept = (weight == 0) | (a == b).all(axis=-1, keepdims=True)
    return np.where(kept, a, np.where(weight == 1, b, between))


_MIX = Operations(_line, _arc, _line, _line)
