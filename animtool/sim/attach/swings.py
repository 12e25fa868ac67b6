"""From where the bones of a chain point to the rotations of its joints."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

# Bones shorter than this [m] point nowhere.
SHORTEST = 1e-9


def least_turns(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotations ``(F, 4)`` from directions to others ``(F, 3)``.

    Identity where either has no length; half a turn about some axis across where they
    are opposed.

    >>> least_turns(np.array([[1.0, 0, 0]]), np.array([[2.0, 0, 0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    lengths = [np.linalg.norm(part, axis=-1, keepdims=True) for part in (before, after)]
    solid = (lengths[0] > SHORTEST) & (lengths[1] > SHORTEST)
    a = before / np.where(solid, lengths[0], 1.0)
    b = after / np.where(solid, lengths[1], 1.0)
    dots = (a * b).sum(axis=-1, keepdims=True)
    across = np.cross(a, b)
    turns = so3.normalize(np.concatenate([across, 1.0 + dots], axis=-1))
    opposed = solid[:, 0] & (dots[:, 0] < -1 + 1e-12)
    if opposed.any():
        least = np.eye(3)[np.abs(a[opposed]).argmin(axis=-1)]
        axes = np.cross(a[opposed], least)
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        turns[opposed] = np.concatenate([axes, np.zeros((len(axes), 1))], axis=-1)
    return np.where(solid, turns, so3.IDENTITY)


def chain_rotations(
    rig: Rig,
    joints: IntArray,
    rotations: FloatArray,
    animated: FloatArray,
    moved: FloatArray,
) -> FloatArray:
    """Return local rotations that point the bones of a chain to where they were moved.

    Each joint is carried along by those above it, and then turned by the least turn
    that points its bone: it does not twist. Joints stay within their limits: a pin
    keeps to its axis, and the bones below go on from where that leaves it. Under
    scales that differ by axis, directions hold only roughly.

    Args:
        rig: J joints.
        joints: Of the chain, from the root on ``(C,)``.
        rotations: Local, of all joints as they are animated ``(F, J, 4)``.
        animated: Where the animation has the ends of the bones ``(F, C + 1, 3)`` [m].
        moved: Where they are to be, likewise.

    Returns:
        ``(F, C, 4)``.
    """
    world = _above(rig, int(joints[0]), rotations)
    inherited = np.tile(so3.IDENTITY, (len(rotations), 1))
    made = np.zeros((len(rotations), len(joints), 4))
    for k, joint in enumerate(joints.tolist()):
        own = rotations[:, joint]
        parent = so3.multiply(inherited, world)
        bone = animated[:, k + 1] - animated[:, k]
        turn = least_turns(so3.rotate(inherited, bone), moved[:, k + 1] - moved[:, k])
        wanted = so3.multiply(turn, so3.multiply(parent, own))
        local = so3.normalize(so3.multiply(so3.conjugate(parent), wanted))
        made[:, k] = _allowed(rig.joints[joint], local, own)
        world = so3.multiply(world, own)
        # What the joints so far have turned the animation by, in the world.
        inherited = so3.multiply(so3.multiply(parent, made[:, k]), so3.conjugate(world))
    return made


def _above(rig: Rig, joint: int, rotations: FloatArray) -> FloatArray:
    """Return the rotation of what carries a joint, in the world ``(F, 4)``."""
    whole = np.tile(so3.IDENTITY, (len(rotations), 1))
    parent = rig.joints[joint].parent
    while parent >= 0:
        whole = so3.multiply(rotations[:, parent], whole)
        parent = rig.joints[parent].parent
    return whole


def _allowed(joint: Joint, local: FloatArray, own: FloatArray) -> FloatArray:
    """Return rotations that a joint can have ``(F, 4)``; its own where it has none."""
    rest = np.array(joint.rotation)
    motion = so3.multiply(so3.conjugate(rest), local)
    if joint.type is JointType.PIN:
        along = (motion[:, :3] * np.array(joint.axis)).sum(axis=-1)
        angle = 2 * np.arctan2(along, motion[:, 3])
        angle = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
        if isinstance(joint.limits, RangeLimit):
            angle = joint.limits.clamped(angle)
        return so3.multiply(rest, so3.from_axis_angle(joint.axis, angle))
    if joint.type in {JointType.FIXED, JointType.PRISMATIC}:
        return own
    if isinstance(joint.limits, BallLimit):
        return so3.multiply(rest, joint.limits.clamped(motion))
    return local
