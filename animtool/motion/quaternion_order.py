"""Detects rotations whose quaternions have w at the wrong end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, median
from animtool.core.errors import Fault, Severity
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

# With fewer rotating joints, half turns may be intended. Number of sampled frames.
MIN_ROTATING_JOINTS, MAX_SAMPLED_FRAMES = 5, 16
# Median angles from the rest pose of a wrong and of a right order [rad].
MIN_WRONG_ANGLE, MAX_RIGHT_ANGLE = np.radians([110.0, 50.0])
# Static joints closer to their rest pose than this are at rest [rad].
MIN_STATIC_ANGLE = 1e-3


@dataclass(frozen=True, slots=True)
class SwappedOrder:
    """Median joint angles from rest [deg], as read and with w at the other end."""

    joint_count: int
    angle_as_read: float
    angle_swapped: float

    @property
    def message(self) -> str:
        """Description of the angles that suggest the other order."""
        message = f"{self.joint_count} joints are {self.angle_as_read:.0f}° from their "
        message += "rest pose in the median; with w at the other end of the "
        return f"{message}quaternions, {self.angle_swapped:.0f}°"


def find_swapped_order(rig: Rig, motion: Motion) -> SwappedOrder | None:
    """Return the angles from rest in both orders if w seems misplaced, else None."""
    channel = motion.rotations
    is_rotated = so3.angle_between(rig.rest_rotations, channel.rest) > MIN_STATIC_ANGLE
    is_rotated[channel.animated] = True
    rotated_joints, frame_count = np.flatnonzero(is_rotated), len(channel.values)
    if len(rotated_joints) < MIN_ROTATING_JOINTS or not frame_count:
        return None
    sample_count = min(frame_count, MAX_SAMPLED_FRAMES)
    frames = np.linspace(0, frame_count - 1, sample_count).astype(np.int64)
    rotations = channel.select(frames).gather(rotated_joints)
    rest_rotations = rig.rest_rotations[rotated_joints]
    angle_as_read = _median_angle(rest_rotations, rotations)
    if angle_as_read < MIN_WRONG_ANGLE:
        return None
    angle_swapped = min(
        _median_angle(rest_rotations, np.roll(rotations, k, axis=2)) for k in (1, -1)
    )
    if angle_swapped > MAX_RIGHT_ANGLE:
        return None
    degrees = np.degrees([angle_as_read, angle_swapped]).tolist()
    return SwappedOrder(len(rotated_joints), *degrees)


def _median_angle(rest_rotations: FloatArray, rotations: FloatArray) -> float:
    """Return the median over joints of their median angle from rest [rad]."""
    angles = so3.angle_between(rest_rotations[None], rotations)
    return float(median(median(angles)))


ORDER_HINT = (
    "USD and clip files have w first, [w, x, y, z]; glTF has it last, [x, y, z, w]"
)
MOTION_ORDER_HINT = "rotations of a Motion have w last, (x, y, z, w)"


def order_warning(
    rig: Rig, motion: Motion, path: str, hint: str = ORDER_HINT
) -> list[Fault]:
    """Return a warning if quaternions seem to have w at the wrong end (MOT222)."""
    order = find_swapped_order(rig, motion)
    if order is None:
        return []
    return [Fault("MOT222", order.message, path, (), hint, Severity.WARNING)]


def with_order_warning(stream: TakeStream, path: str) -> TakeStream:
    """Return a take made in Python with MOT222 among its notices, if it applies.

    It is determined from the first block. Takes of files are checked as they are read.
    """
    if "format" in stream.details:
        return stream

    def blocks() -> Iterator[Motion]:
        for i, block in enumerate(stream.blocks):
            if i == 0:
                notices = order_warning(stream.rig, block, path, MOTION_ORDER_HINT)
                stream.notices.extend(notices)
            yield block

    return replace(stream, blocks=blocks())
