"""Builds a take of one frame from a robot file: the robot at its zero pose."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.ik.sub_rig import with_mimics
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig

# Arbitrary: one frame has no rate.
POSE_RATE = Fraction(24)


def zero_coordinates(rig: Rig) -> FloatArray:
    """Return coordinates ``(1, Q)`` at 0, or at the nearest limit.

    Mimic joints follow their leaders.
    """
    slices = coordinate_slices(rig)
    coordinates = np.zeros((1, slices[-1].stop if slices else 0))
    for joint, joint_slice in zip(rig.joints, slices, strict=True):
        if joint.type in {JointType.FREE, JointType.BALL}:
            coordinates[0, joint_slice.stop - 1] = 1.0
        elif isinstance(joint.limits, RangeLimit):
            coordinates[0, joint_slice] = joint.limits.clamped(
                coordinates[0, joint_slice]
            )
    return with_mimics(rig, coordinates, rig.names)


def zero_pose_stream(rig: Rig, format_name: str) -> TakeStream:
    """Return a one-frame take of a robot at zero coordinates."""
    local = local_from_coordinates(rig, zero_coordinates(rig))
    motion = Motion(
        Channel.from_dense(local.translations), Channel.from_dense(local.rotations)
    )
    single_frame = Fraction(1)
    stream = TakeStream(rig, POSE_RATE, single_frame, single_frame, iter([motion]))
    stream.notices += rig.notices
    stream.details = {"format": format_name}
    return stream
