"""How far joints go from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.take import Take

__all__ = ["Steps", "steps_of"]


@dataclass(frozen=True, slots=True)
class Steps:
    """How far joints go from each frame to the next.

    Attributes:
        take: F frames, J joints.
        turns: ``(F - 1, J)`` [rad].
        shifts: Against their parents ``(F - 1, J)`` [m].
    """

    take: Take
    turns: FloatArray
    shifts: FloatArray


def steps_of(take: Take) -> Steps:
    """Return how far the joints of a take go from frame to frame."""
    translations, rotations, _ = take.motion.dense()
    turns = so3.angle_between(rotations[:-1], rotations[1:])
    shifts = np.linalg.norm(np.diff(translations, axis=0), axis=2)
    return Steps(take, turns, shifts)
