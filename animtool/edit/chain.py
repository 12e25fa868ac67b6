"""Where one joint of a take is in the world, without working out the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.motion import Motion
from animtool.rig.skeleton import Rig


@dataclass(frozen=True, slots=True)
class Place:
    """A joint in the world, in every frame.

    Attributes:
        position: Its origin ``(F, 3)`` [m].
        rotation: The rotations of the joints down to it, without their scales
            ``(F, 4)``.
        linear: Linear part with scales ``(F, 3, 3)``; column c is its axis c.
    """

    position: FloatArray
    rotation: FloatArray
    linear: FloatArray


def ancestors(rig: Rig, joint: int) -> list[int]:
    """Return the joints above one, the root first.

    >>> from animtool.rig.skeleton import Joint
    >>> ancestors(Rig("arm", (Joint("a", -1), Joint("b", 0), Joint("c", 1))), 2)
    [0, 1]
    """
    found: list[int] = []
    parent = rig.joints[joint].parent
    while parent >= 0:
        found.append(parent)
        parent = rig.joints[parent].parent
    return found[::-1]


def above(rig: Rig, motion: Motion, joint: int) -> Place:
    """Return the frame that a joint's own transform is in: its parent, or the world."""
    return _followed(motion, ancestors(rig, joint))


def place_of(rig: Rig, motion: Motion, joint: int) -> Place:
    """Return where a joint is in every frame."""
    return _followed(motion, [*ancestors(rig, joint), joint])


def rest_rotation(rig: Rig, joint: int) -> FloatArray:
    """Return the rotation of a joint in the world at rest ``(4,)``."""
    whole = so3.IDENTITY
    for one in [*ancestors(rig, joint), joint]:
        whole = so3.multiply(whole, rig.joints[one].rotation)
    return whole


def _followed(motion: Motion, joints: list[int]) -> Place:
    position = np.zeros((motion.frames, 3))
    rotation = np.tile(so3.IDENTITY, (motion.frames, 1))
    linear = np.tile(np.eye(3), (motion.frames, 1, 1))
    for joint in joints:
        step, turn = (
            channel.gather(np.array([joint]))[:, 0]
            for channel in (motion.translations, motion.rotations)
        )
        position = position + np.einsum("fij,fj->fi", linear, step)
        rotation = so3.multiply(rotation, turn)
        linear = linear @ so3.to_matrix(turn)
        if motion.scales is not None:
            linear = linear * motion.scales.gather(np.array([joint]))
    return Place(position, rotation, linear)


def twist(rotation: FloatArray, up: FloatArray) -> FloatArray:
    """Return the part of rotations ``(..., 4)`` about a unit axis ``(3,)``.

    It is identity where a rotation is half a turn about an axis across this one.

    >>> twist(np.array([0.0, 0.6, 0.8, 0.0]), np.array([0.0, 1.0, 0.0])).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    along = np.sum(rotation[..., :3] * up, axis=-1, keepdims=True) * up
    return so3.normalize(np.concatenate([along, rotation[..., 3:]], axis=-1))
