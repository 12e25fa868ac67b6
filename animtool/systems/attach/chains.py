"""Rotations of simulated joint chains."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

# Bones shorter than this have no direction [m].
MIN_BONE_LENGTH = 1e-9


def shortest_rotations(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotations from directions to other directions ``(F, 4)``.

    Directions are ``(F, 3)``.
    Identity if either has no length; 180° about a perpendicular axis if they are
    opposite.

    >>> shortest_rotations(np.array([[1.0, 0, 0]]), np.array([[2.0, 0, 0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    lengths = [np.linalg.norm(v, axis=-1, keepdims=True) for v in (before, after)]
    has_length = (lengths[0] > MIN_BONE_LENGTH) & (lengths[1] > MIN_BONE_LENGTH)
    a = before / np.where(has_length, lengths[0], 1.0)
    b = after / np.where(has_length, lengths[1], 1.0)
    dots = (a * b).sum(axis=-1, keepdims=True)
    cross = np.cross(a, b)
    rotations = so3.normalize(np.concatenate([cross, 1.0 + dots], axis=-1))
    is_opposite = has_length[:, 0] & (dots[:, 0] < -1 + 1e-12)
    if is_opposite.any():
        smallest_axes = np.eye(3)[np.abs(a[is_opposite]).argmin(axis=-1)]
        axes = np.cross(a[is_opposite], smallest_axes)
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        no_scalars = np.zeros((len(axes), 1))
        rotations[is_opposite] = np.concatenate([axes, no_scalars], axis=-1)
    return np.where(has_length, rotations, so3.IDENTITY)


def chain_rotations(
    rig: Rig,
    joints: IntArray,
    rotations: FloatArray,
    animated_points: FloatArray,
    simulated_points: FloatArray,
) -> FloatArray:
    """Return local rotations ``(F, C, 4)`` that align bones with simulated points.

    Each joint inherits the rotation of its parents and gets the shortest rotation
    that aligns its bone, without twist. Joint limits apply: a pin keeps its axis, and
    the bones below continue from there. With non-uniform scales, directions are
    approximate. Rotations of all animated joints are ``(F, J, 4)``; bone ends are
    ``(F, C + 1, 3)`` [m].
    """
    # World rotations of the parent of the first joint.
    world = np.tile(so3.IDENTITY, (len(rotations), 1))
    for ancestor in rig.upwards(int(joints[0]))[1:]:
        world = so3.multiply(rotations[:, ancestor], world)
    relative_rotation = np.tile(so3.IDENTITY, (len(rotations), 1))
    result = np.zeros((len(rotations), len(joints), 4))
    for k, joint in enumerate(joints.tolist()):
        animated_rotation = rotations[:, joint]
        parent = so3.multiply(relative_rotation, world)
        animated_bone = animated_points[:, k + 1] - animated_points[:, k]
        swing = shortest_rotations(
            so3.rotate(relative_rotation, animated_bone),
            simulated_points[:, k + 1] - simulated_points[:, k],
        )
        goal_rotation = so3.multiply(swing, so3.multiply(parent, animated_rotation))
        local_rotation = so3.normalize(
            so3.multiply(so3.conjugate(parent), goal_rotation)
        )
        result[:, k] = _clamp_to_limits(
            rig.joints[joint], local_rotation, animated_rotation
        )
        world = so3.multiply(world, animated_rotation)
        # World rotation of the joints so far relative to the animation.
        simulated_world = so3.multiply(parent, result[:, k])
        relative_rotation = so3.multiply(simulated_world, so3.conjugate(world))
    return result


def _clamp_to_limits(
    joint: Joint, local_rotation: FloatArray, fallback: FloatArray
) -> FloatArray:
    """Return rotations clamped to joint limits ``(F, 4)``; ``fallback`` if fixed."""
    rest_rotation = np.array(joint.rotation)
    rotation = so3.multiply(so3.conjugate(rest_rotation), local_rotation)
    if joint.type is JointType.PIN:
        projection = (rotation[:, :3] * np.array(joint.axis)).sum(axis=-1)
        angle = 2 * np.arctan2(projection, rotation[:, 3])
        angle = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
        if isinstance(joint.limits, RangeLimit):
            angle = joint.limits.clamped(angle)
        return so3.multiply(rest_rotation, so3.from_axis_angle(joint.axis, angle))
    if joint.type in {JointType.FIXED, JointType.PRISMATIC}:
        return fallback
    if isinstance(joint.limits, BallLimit):
        return so3.multiply(rest_rotation, joint.limits.clamped(rotation))
    return local_rotation
