"""Builds a take of one frame from a robot file: the robot at its zero pose."""

from __future__ import annotations

from fractions import Fraction

from animtool.core.array_types import FloatArray
from animtool.ik.sub_rig import with_mimics
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.joints import (
    coordinate_slices,
    local_from_coordinates,
    rest_coordinates,
)
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Rig

# Arbitrary: one frame has no rate.
POSE_RATE = Fraction(24)


def zero_coordinates(rig: Rig) -> FloatArray:
    """Return coordinates ``(1, Q)`` at 0, or at the nearest limit.

    Mimic joints follow their leaders.
    """
    coordinates = rest_coordinates(rig, 1)
    for joint, columns in zip(rig.joints, coordinate_slices(rig), strict=True):
        if isinstance(joint.limits, RangeLimit):
            coordinates[0, columns] = joint.limits.clamped(coordinates[0, columns])
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
