"""The convention of additive motion: what it means to add one motion to another.

============ =====================================
rotations    ``base · delta``: about the joint's axes
translations ``base + delta``, parent space
scales       ``base * delta``
weights      ``base + delta``, controls likewise
============ =====================================

A delta that changes nothing has rotation identity, translation and weight 0 and
scale 1. `add` undoes `subtract`.
"""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.edit.combine import Operations, Strength, combine
from animtool.maths import so3
from animtool.take import Motion

__all__ = ["add", "subtract"]


def add(base: Motion, delta: Motion, strength: Strength) -> Motion:
    """Return a motion with a weighted delta on top.

    Rotations are weighted along the arc from identity, the rest in proportion; a
    weight may be beyond 1 or negative. Signs of rotations may jump.

    >>> from animtool.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> found = add(Motion(one, turn), Motion(one, turn), Strength(np.ones(1)))
    >>> found.translations.rest.tolist(), found.rotations.rest.round(2).tolist()
    ([[2.0, 2.0, 2.0]], [[0.96, 0.0, 0.0, 0.28]])
    """
    return combine(base, delta, _ADD, strength)


def subtract(source: Motion, base: Motion) -> Motion:
    """Return the delta that makes ``source`` of ``base``.

    Scales of the base must not be 0. Signs of rotations may jump.

    >>> from animtool.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> subtract(Motion(one, turn), Motion(one, turn)).rotations.rest.tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    return combine(source, base, _SUBTRACT, Strength(np.ones(source.frames)))


def _turned(base: FloatArray, delta: FloatArray, weight: FloatArray) -> FloatArray:
    part = so3.slerp(so3.IDENTITY, delta, weight[..., 0])
    return so3.multiply(base, np.where(weight == 1, delta, part))


def _shifted(base: FloatArray, delta: FloatArray, weight: FloatArray) -> FloatArray:
    return base + weight * delta


def _scaled(base: FloatArray, delta: FloatArray, weight: FloatArray) -> FloatArray:
    # In proportion, not by powers: scales may be negative.
    return base * (1 + weight * (delta - 1))


def _without_turn(source: FloatArray, base: FloatArray, _: FloatArray) -> FloatArray:
    return so3.multiply(so3.conjugate(base), source) + 0.0


def _without_shift(source: FloatArray, base: FloatArray, _: FloatArray) -> FloatArray:
    return source - base


def _without_scale(source: FloatArray, base: FloatArray, _: FloatArray) -> FloatArray:
    return source / base


_ADD = Operations(_shifted, _turned, _scaled, _shifted)
_SUBTRACT = Operations(_without_shift, _without_turn, _without_scale, _without_shift)
