"""Rotations that are near the rest pose only with w at the other end."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Motion
from animtool.rig.skeleton import Rig

# With fewer rotating joints, half turns may be meant. Frames that are looked at.
MIN_JOINTS, MAX_FRAMES = 5, 16
# Median angles from the rest pose of a wrong and of a right order [rad].
WRONG, RIGHT = np.radians([110.0, 50.0])


@dataclass(frozen=True, slots=True)
class SwappedOrder:
    """Median angles of joints from their rest pose [deg]."""

    joints: int
    as_read: float
    swapped: float

    @property
    def message(self) -> str:
        """What is odd, in numbers."""
        message = f"half of {self.joints} joints are more than {self.as_read:.0f}° "
        message += "from their rest pose; with w at the other end of the quaternions, "
        return f"{message}{self.swapped:.0f}°"


def swapped_order(rig: Rig, motion: Motion) -> SwappedOrder | None:
    """Return angles that tell quaternions in the other order; None for a right one."""
    animated = motion.rotations.animated
    values = motion.rotations.values
    if len(animated) < MIN_JOINTS or not len(values):
        return None
    count = min(len(values), MAX_FRAMES)
    frames = np.linspace(0, len(values) - 1, count).astype(np.int64)
    rotations, rest = values[frames], rig.rest_rotations[animated]
    as_read = _median_angle(rest, rotations)
    if as_read < WRONG:
        return None
    swapped = min(_median_angle(rest, np.roll(rotations, k, axis=2)) for k in (1, -1))
    if swapped > RIGHT:
        return None
    degrees = np.degrees([as_read, swapped]).tolist()
    return SwappedOrder(len(animated), *degrees)


def _median_angle(rest: FloatArray, rotations: FloatArray) -> float:
    """Return the median over joints of their median angle from rest [rad]."""
    angles = so3.angle_between(rest[None], rotations)
    return float(np.median(np.median(angles, axis=0)))


def order_warning(rig: Rig, motion: Motion, path: str) -> list[Fault]:
    """Return a warning about quaternions in the other order (MOT222)."""
    order = swapped_order(rig, motion)
    if order is None:
        return []
    warning = Severity.WARNING
    return [Fault("MOT222", order.message, path, (), ORDER_HINT, warning)]


ORDER_HINT = (
    "USD and clip files have w first, [w, x, y, z]; glTF has it last, [x, y, z, w]"
)
