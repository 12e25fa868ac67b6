"""A cycle's last pose, and the one behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.sim.attach.poses import Pose

# A root that comes back to within so many of its steps stands in its place [1].
IN_PLACE = 2.0
# Part of the cycle over which what is left is brought in [1].
SEAM = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """What a cycle carries the character by, over the ground.

    Attributes:
        shift: ``(3,)`` [m], behind the turn.
        turn: About the up axis, at the world's origin ``(4,)``.
    """

    shift: FloatArray
    turn: FloatArray


def travel_between(rig: Rig, up: FloatArray, poses: tuple[Pose, ...]) -> Travel:
    """Return the travel of a cycle.

    A root that is near its first place at the end has none. Another goes on, from the
    last frame to the one behind it, at the mean of its speeds on either side.

    Args:
        rig: Its first root counts.
        up: Direction away from the ground ``(3,)``.
        poses: The first two of the cycle, and the last two.
    """
    root = rig.roots[0]
    first, second, before, last = (pose.translations[root] for pose in poses)
    ahead, behind = second - first, last - before
    step = max(np.linalg.norm(ahead), np.linalg.norm(behind))
    if np.linalg.norm(last - first) <= IN_PLACE * step + 1e-9:
        return Travel(np.zeros(3), so3.IDENTITY)
    turns = [pose.rotations[root] for pose in poses]
    onward = so3.multiply(turns[3], so3.multiply(so3.conjugate(turns[0]), turns[1]))
    whole = so3.multiply(onward, so3.conjugate(turns[0]))
    along = float((whole[:3] * up).sum()) * up
    turn = so3.normalize(np.append(along, whole[3]))
    place = last + (behind + so3.rotate(turn, ahead)) / 2
    shift = place - so3.rotate(turn, first)
    return Travel(shift - float((shift * up).sum()) * up, turn)


def onward(rig: Rig, pose: Pose, travel: Travel) -> Pose:
    """Return a pose carried on by a cycle's travel."""
    translations, rotations = pose.translations.copy(), pose.rotations.copy()
    roots = np.array(rig.roots)
    translations[roots] = so3.rotate(travel.turn, translations[roots]) + travel.shift
    rotations[roots] = so3.multiply(travel.turn, rotations[roots])
    return replace(pose, translations=translations, rotations=rotations)


def seam_weights(frames: int) -> FloatArray:
    """Return how much of a correction each frame has, before all of it ``(F,)``.

    >>> seam_weights(8).round(3).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    """
    share = np.clip((np.arange(frames) / frames - 1 + SEAM) / SEAM, 0.0, 1.0)
    return np.asarray(share * share * (3 - 2 * share))
