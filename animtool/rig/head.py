"""Finds head and eye joints, and converts face rotations to their frames."""

from __future__ import annotations

import re

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.units import UpAxis
from animtool.maths.so3 import conjugate, multiply
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

HEAD, LEFT_EYE, RIGHT_EYE = "head", "left eye", "right eye"
_JOINT_NAMES = {
    HEAD: ("head",),
    LEFT_EYE: ("eyel", "lefteye", "leye", "eyeleft", "eyeballl", "eyeballleft"),
    RIGHT_EYE: ("eyer", "righteye", "reye", "eyeright", "eyeballr", "eyeballright"),
}
# From Y up (face along +Z) to Z up (face along -Y).
_Z_UP_ROTATION = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])


def head_joints(rig: Rig) -> dict[str, int]:
    """Return the existing head and eye joints by part.

    >>> from animtool.rig.skeleton import Joint
    >>> head_joints(Rig("r", (Joint("mixamorig:Head", -1), Joint("LeftEye", 0))))
    {'head': 0, 'left eye': 1}
    """
    joint_by_part: dict[str, int] = {}
    for j, joint in enumerate(rig.joints):
        normalized_name = re.sub(
            r"[\s_-]", "", re.split(r"[:|/]", joint.name)[-1]
        ).lower()
        for part, names in _JOINT_NAMES.items():
            if normalized_name in names:
                joint_by_part.setdefault(part, j)
    return joint_by_part


def local_rotations(rig: Rig, joint: int, rotations: FloatArray) -> FloatArray:
    """Convert face rotations to a joint's local rotations ``(F, 4)``.

    The joints above it are at rest.

    Args:
        rig: Rig of the joint.
        joint: Index of the joint.
        rotations: Rotations in the frame of a face: X to its left, Y up, Z forward
            ``(F, 4)``.
    """
    if rig.up is UpAxis.Z:
        rotations = multiply(
            multiply(_Z_UP_ROTATION, rotations), conjugate(_Z_UP_ROTATION)
        )
    parent = rig.joints[joint].parent
    if parent >= 0:
        parent_rotation = rest_world(rig).rotations[0, parent]
        rotations = multiply(
            conjugate(parent_rotation), multiply(rotations, parent_rotation)
        )
    return multiply(rotations, rig.rest_rotations[joint])


def face_rotations(rig: Rig, joint: int, local: FloatArray) -> FloatArray:
    """Convert a joint's local rotations to face rotations ``(F, 4)``."""
    parent = rig.joints[joint].parent
    rotation_from_rest = multiply(local, conjugate(rig.rest_rotations[joint]))
    if parent >= 0:
        parent_rotation = rest_world(rig).rotations[0, parent]
        rotation_from_rest = multiply(
            multiply(parent_rotation, rotation_from_rest), conjugate(parent_rotation)
        )
    if rig.up is UpAxis.Z:
        rotation_from_rest = multiply(
            multiply(conjugate(_Z_UP_ROTATION), rotation_from_rest), _Z_UP_ROTATION
        )
    return rotation_from_rest
