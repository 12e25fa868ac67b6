"""The other side of a joint: its reflection in the plane between left and right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.rig.limits import BallLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Joint, Pose

# Translation and rotation, world space.
Transform = tuple[FloatArray, FloatArray]
ORIGIN: Transform = (np.zeros(3), so3.IDENTITY)

# The plane x = 0: left and right are along X, whichever axis is up.
_ACROSS = np.array([-1.0, 1.0, 1.0])

# Differences below are rounding [m], [rad]: the file's own numbers are kept.
SAME_PLACE = 1e-12


def reflect_vector(vector: FloatArray) -> FloatArray:
    """Return vectors ``(..., 3)`` reflected in the plane x = 0."""
    return np.asarray(vector * _ACROSS)


def reflect_rotation(rotation: FloatArray) -> FloatArray:
    """Return rotations ``(..., 4)`` conjugated by the reflection in x = 0.

    >>> reflect_rotation(np.array([0.6, 0.0, 0.0, 0.8])).tolist()
    [0.6, -0.0, -0.0, 0.8]
    """
    return np.asarray(rotation * np.array([1.0, -1.0, -1.0, 1.0]))


def placed(parent_world: Transform, pose: Pose) -> Transform:
    """Return the world transform of a local one below a parent."""
    position, rotation = parent_world
    return (
        position + so3.rotate(rotation, pose.translation),
        so3.multiply(rotation, pose.rotation),
    )


def mirrored_pose(pose: Pose, world: Transform, parent_world: Transform) -> Pose:
    """Return the local transform of the other side's joint, a reflection in the world.

    Args:
        pose: Of the joint that the file describes.
        world: That joint's translation and rotation, world space.
        parent_world: Translation and rotation of the other joint's parent.
    """
    local = reflect_vector(np.array(pose.translation)) + 0.0
    turn = reflect_rotation(np.array(pose.rotation)) + 0.0
    position, rotation = reflect_vector(world[0]), reflect_rotation(world[1])
    back = so3.conjugate(parent_world[1])
    place, facing = position - parent_world[0], so3.multiply(back, rotation)
    if (
        np.abs(so3.rotate(back, place) - local).max() > SAME_PLACE
        or so3.angle_between(facing, turn) > SAME_PLACE
    ):
        # Parents that are no mirror images of each other themselves.
        local, turn = so3.rotate(back, place) + 0.0, facing + 0.0
    a, b, c, d = turn.tolist()
    return Pose(_vector(local), (a, b, c, d))


def mirrored_joint(
    joint: Joint, world: Transform, parent: int, parent_world: Transform
) -> Joint:
    """Return the joint named ``joint.mirror``, a joint's reflection at rest.

    A pin's axis keeps its sense such that equal coordinates are mirror images: both
    elbows bend by positive angles, and limits carry over.

    Args:
        joint: The one that the file describes.
        world: Its translation and rotation at rest, world space.
        parent: Index of the new joint's parent.
        parent_world: That one's translation and rotation.
    """
    pose = mirrored_pose(Pose(joint.translation, joint.rotation), world, parent_world)
    limits = joint.limits
    if isinstance(limits, BallLimit):
        limits = replace(limits, twist_axis=_turned(limits.twist_axis))
    slides = joint.type == "prismatic"
    return replace(
        joint,
        name=joint.mirror,
        mirror=joint.name,
        parent=parent,
        translation=pose.translation,
        rotation=pose.rotation,
        axis=_vector(reflect_vector(np.array(joint.axis)))
        if slides
        else _turned(joint.axis),
        tips=tuple(_vector(reflect_vector(np.array(tip))) for tip in joint.tips),
        limits=limits,
        source_name="",
    )


def _turned(axis: Vector) -> Vector:
    """Return the axis about which equal angles are mirror images."""
    return _vector(-reflect_vector(np.array(axis)))


def _vector(values: FloatArray) -> Vector:
    x, y, z = (values + 0.0).tolist()
    return (x, y, z)
