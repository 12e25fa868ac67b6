"""Adding one motion to another, and taking it away again.

What addition means for each kind of channel is said in `animtool.maths.additive`.
"""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.edit.combine import Operation, Operations, Strength, combine
from animtool.maths import additive
from animtool.motion import Motion


def add(base: Motion, delta: Motion, strength: Strength) -> Motion:
    """Return a motion with a weighted delta on top.

    A weight may be beyond 1 or negative. Signs of rotations may jump.

    >>> from animtool.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> found = add(Motion(one, turn), Motion(one, turn), Strength(np.ones(1)))
    >>> found.translations.rest.tolist(), found.rotations.rest.round(2).tolist()
    ([[2.0, 2.0, 2.0]], [[0.96, 0.0, 0.0, 0.28]])
    """
    return combine(base, delta, _ADD, strength)


def subtract(source: Motion, base: Motion) -> Motion:
    """Return the delta that makes ``source`` of ``base``; `add` undoes it.

    Scales of the base must not be 0. Signs of rotations may jump.

    >>> from animtool.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> subtract(Motion(one, turn), Motion(one, turn)).rotations.rest.tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    return combine(source, base, _SUBTRACT, Strength(np.ones(source.frames)))


def _whole(operation: additive.Difference) -> Operation:
    def apply(source: FloatArray, base: FloatArray, _: FloatArray) -> FloatArray:
        return operation(source, base)

    return apply


_ADD = Operations(additive.shifted, additive.turned, additive.scaled, additive.shifted)
_SUBTRACT = Operations(
    _whole(additive.unshifted),
    _whole(additive.unturned),
    _whole(additive.unscaled),
    _whole(additive.unshifted),
)
