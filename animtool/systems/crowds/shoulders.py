"""Shoulder yaw of agents, to slip past each other in a jam.

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

# Largest yaw [rad].
MOST = 0.9
# Depth of agents over their shoulder width.
DEPTH = 0.6
# Time constants of yaw, and of its return [s].
TURNING, BACK = 0.25, 0.6
# Smaller yaws, over the largest, count as none.
LEAST = 0.02


def lines(headings: FloatArray, shoulders: FloatArray) -> FloatArray:
    """Return vectors along the shoulders, longer with more yaw, 1 at most ``(N, 2)``.

    ``headings`` and ``shoulders`` ``(N,)`` [rad].
    """
    angles = headings + shoulders
    along = np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.asarray(along * (np.abs(shoulders) / MOST)[:, None])


def turned_shoulders(
    shoulders: FloatArray, pressed: FloatArray, dt: float
) -> FloatArray:
    """Return shoulder yaws after a step ``(N,)`` [rad].

    ``pressed`` ``(N,)``: target yaw over the largest; negative is to the right. Yawed
    shoulders keep their side.
    """
    side = np.where(shoulders != 0, np.sign(shoulders), np.sign(pressed))
    target = MOST * side * np.abs(pressed)
    time = np.where(np.abs(target) > np.abs(shoulders), TURNING, BACK)
    next_yaws = shoulders + (target - shoulders) * -np.expm1(-dt / time)
    back = (pressed == 0) & (np.abs(next_yaws) < LEAST * MOST)
    return np.where(back, 0.0, next_yaws)


@dataclass(frozen=True)
class Trunk:
    """Joints that rotate the shoulders: the spine; neck and head counter-rotate."""

    spine: tuple[int, ...]
    neck: tuple[int, ...]  # with the head

    @staticmethod
    def of(person: RoledSkeleton) -> Trunk:
        """Return the trunk of a skeleton; without a spine nothing rotates."""
        named = {
            role: tuple(j for j, actual in enumerate(person.roles) if actual == role)
            for role in ("spine", "neck", "head")
        }
        return Trunk(named["spine"], named["neck"] + named["head"])

    @property
    def joints(self) -> IntArray:
        """Return the joints it rotates."""
        return np.array([*self.spine, *self.neck], np.int64)

    def rotate(
        self, parents: IntArray, rotations: FloatArray, angles: FloatArray
    ) -> None:
        """Rotate the shoulders of poses by angles ``(N,)`` [rad], in place.

        ``rotations`` ``(N, J, 4)`` are local; the head keeps facing forward.
        """
        some = np.flatnonzero(angles)
        if not len(some) or not self.spine:
            return
        posed, angle = rotations[some], angles[some]
        each = [(j, 1 / len(self.spine)) for j in self.spine]
        each += [(j, -1 / len(self.neck)) for j in self.neck]
        for joint, fraction in each:
            above = np.broadcast_to(so3.IDENTITY, (len(some), 4))
            for j in _above(parents, joint):
                above = so3.multiply(above, posed[:, j])
            yaw = about_up(fraction * angle)
            back = so3.multiply(so3.conjugate(above), so3.multiply(yaw, above))
            posed[:, joint] = so3.multiply(back, posed[:, joint])
        rotations[some] = posed


def _above(parents: IntArray, joint: int) -> list[int]:
    """Return the ancestors of a joint, root first."""
    chain: list[int] = []
    while (joint := int(parents[joint])) >= 0:
        chain.insert(0, joint)
    return chain
