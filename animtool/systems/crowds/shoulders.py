"""Shoulders that agents turn in a jam, so that they slip past each other.

Angles are of the line of the shoulders about up, from straight ahead: more than 0 is to
the left, as headings are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.systems.crowds.ground import about_up

if TYPE_CHECKING:
    from animtool.retarget.roled_skeleton import RoledSkeleton

# They are turned no farther [rad].
MOST = 0.9
# How thick agents are, over the width of their shoulders.
DEPTH = 0.6
# How long they take to turn them, and to turn them back [s].
TURNING, BACK = 0.25, 0.6
# Who is turned less than this part of the most is not turned.
LEAST = 0.02


def lines(headings: FloatArray, shoulders: FloatArray) -> FloatArray:
    """Return along shoulders, as long as they are turned, 1 at most ``(N, 2)``.

    ``headings`` and ``shoulders`` ``(N,)`` [rad].
    """
    angles = headings + shoulders
    along = np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.asarray(along * (np.abs(shoulders) / MOST)[:, None])


def turned_shoulders(
    shoulders: FloatArray, pressed: FloatArray, dt: float
) -> FloatArray:
    """Return how far shoulders are turned a step later ``(N,)`` [rad].

    ``pressed`` ``(N,)``: how far they are to be, of the most; below 0 for who turns
    to its right. Whoever turned to a side stays turned to that side.
    """
    side = np.where(shoulders != 0, np.sign(shoulders), np.sign(pressed))
    target = MOST * side * np.abs(pressed)
    time = np.where(np.abs(target) > np.abs(shoulders), TURNING, BACK)
    made = shoulders + (target - shoulders) * -np.expm1(-dt / time)
    back = (pressed == 0) & (np.abs(made) < LEAST * MOST)
    return np.where(back, 0.0, made)


@dataclass(frozen=True)
class Trunk:
    """What turns the shoulders of a rig: its spine; neck and head turn back."""

    spine: tuple[int, ...]
    neck: tuple[int, ...]  # and head

    @staticmethod
    def of(person: RoledSkeleton) -> Trunk:
        """Return that of a skeleton; of one without a spine nothing turns."""
        named = {
            role: tuple(j for j, own in enumerate(person.roles) if own == role)
            for role in ("spine", "neck", "head")
        }
        return Trunk(named["spine"], named["neck"] + named["head"])

    @property
    def joints(self) -> IntArray:
        """Return the joints that it turns."""
        return np.array([*self.spine, *self.neck], np.int64)

    def turn(self, parents: IntArray, turns: FloatArray, angles: FloatArray) -> None:
        """Turn shoulders of poses by angles ``(N,)`` [rad], in place.

        ``turns`` ``(N, J, 4)`` are local; the head keeps looking ahead.
        """
        some = np.flatnonzero(angles)
        if not len(some) or not self.spine:
            return
        own, angle = turns[some], angles[some]
        each = [(j, 1 / len(self.spine)) for j in self.spine]
        each += [(j, -1 / len(self.neck)) for j in self.neck]
        for joint, share in each:
            above = np.broadcast_to(so3.IDENTITY, (len(some), 4))
            for j in _above(parents, joint):
                above = so3.multiply(above, own[:, j])
            yaw = about_up(share * angle)
            back = so3.multiply(so3.conjugate(above), so3.multiply(yaw, above))
            own[:, joint] = so3.multiply(back, own[:, joint])
        turns[some] = own


def _above(parents: IntArray, joint: int) -> list[int]:
    """Return the joints above one, the first first."""
    made: list[int] = []
    while (joint := int(parents[joint])) >= 0:
        made.insert(0, joint)
    return made
