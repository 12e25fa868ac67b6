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
    """Median joint angles [deg], as read and with w at the other end.

    They are from the rest pose, or of the rest pose from no rotation.
    """

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
    return _compare_orders(rig.rest_rotations[rotated_joints], rotations)


def _compare_orders(
    references: FloatArray, rotations: FloatArray
) -> SwappedOrder | None:
    """Return the angles of rotations ``(F, J, 4)`` from references ``(J, 4)``."""
    angle_as_read = _median_angle(references, rotations)
    if angle_as_read < MIN_WRONG_ANGLE:
        return None
    angle_swapped = min(
        _median_angle(references, np.roll(rotations, k, axis=2)) for k in (1, -1)
    )
    if angle_swapped > MAX_RIGHT_ANGLE:
        return None
    degrees = np.degrees([angle_as_read, angle_swapped]).tolist()
    return SwappedOrder(rotations.shape[1], *degrees)


def _median_angle(rest_rotations: FloatArray, rotations: FloatArray) -> float:
    """Return the median over joints of their median angle from rest [rad]."""
    angles = so3.angle_between(rest_rotations[None], rotations)
    return float(median(median(angles)))


ORDER_HINT = (
    "USD and clip files have w first, [w, x, y, z]; glTF has it last, [x, y, z, w]"
)
PYTHON_ORDER_HINT = "rotations of a Motion and a Joint have w last, (x, y, z, w)"


def order_warning(rig: Rig, motion: Motion, path: str) -> list[Fault]:
    """Return a warning if quaternions seem to have w at the wrong end (MOT222)."""
    order = find_swapped_order(rig, motion)
    if order is None:
        return []
    return [Fault("MOT222", order.message, path, (), ORDER_HINT, Severity.WARNING)]


def python_order_warning(rig: Rig, motion: Motion, path: str) -> list[Fault]:
    """Return that warning for a take made in Python, whose rest pose may be wrong."""
    rest_order = None
    if len(rig.joints) >= MIN_ROTATING_JOINTS:
        identities = np.tile(so3.IDENTITY, (len(rig.joints), 1))
        rest_order = _compare_orders(identities, rig.rest_rotations[None])
    order = rest_order or find_swapped_order(rig, motion)
    if order is None:
        return []
    message = order.message
    if rest_order is not None:
        message = f"rest rotations of {rest_order.joint_count} joints are "
        message += (
            f"{rest_order.angle_as_read:.0f}° in the median; with w at the other "
        )
        message += f"end of the quaternions, {rest_order.angle_swapped:.0f}°"
    return [Fault("MOT222", message, path, (), PYTHON_ORDER_HINT, Severity.WARNING)]


def with_order_warning(stream: TakeStream, path: str) -> TakeStream:
    """Return a take made in Python with MOT222 among its notices, if it applies.

    It is determined from the first block. Takes of files are checked as they are read.
    """
    if "format" in stream.details:
        return stream

    def blocks() -> Iterator[Motion]:
        for i, block in enumerate(stream.blocks):
            if i == 0:
                stream.notices.extend(python_order_warning(stream.rig, block, path))
            yield block

    return replace(stream, blocks=blocks())
