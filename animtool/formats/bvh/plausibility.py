"""Detects implausible rates, rotations, root channels and offsets of a BVH file."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.core.quantities import length_text
from animtool.core.rates import RateKind, rate_label, rate_warning
from animtool.formats.bvh.hierarchy import BvhHeader
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig

# Skeletons with fewer joints may be props; their size and rotations are not judged.
MIN_BODY_JOINTS = 8
# Relative tolerance of equal rates; film transferred to video is 0.1 % slower.
RATE_TOLERANCE = Fraction(2, 1000)
# A body travels if its root moves farther than this fraction of its size; its largest
# rotation then looks like radians in this range. Smaller changes are noise [deg].
MIN_TRAVEL_FRACTION, MIN_RADIANS, MAX_RADIANS, MIN_CHANGE = 0.5, 0.7, 6.4, 0.1
# A body that does not travel moves if this fraction of its rotation channels changes;
# most channels are those of fingers.
MIN_MOVING_FRACTION = 0.1


def stated_rate_note(
    header: BvhHeader, stated_rate: Fraction, path: str
) -> list[Fault]:
    """Return a note if the option's rate differs from a plausible Frame Time."""
    file_rate, frame_count = header.rate_choice.fps, header.declared_frame_count
    is_same_rate = (
        abs(stated_rate - file_rate) <= RATE_TOLERANCE * file_rate
        or stated_rate in header.rate_choice.ambiguous_rates
    )
    if is_same_rate or header.rate_choice.kind is RateKind.PRINTED:
        return []
    if rate_warning(file_rate) or rate_warning(stated_rate):
        return []
    durations = (float(frame_count / fps) for fps in (stated_rate, file_rate))
    message = f"Frame Time {header.frame_time} is {rate_label(file_rate)}, not "
    message += f"{argument('source.fps', f'{float(stated_rate):g}')}: {frame_count} "
    message += "frames last {:.3g} s instead of {:.3g} s".format(*durations)
    hint = f"leave it out to keep {rate_label(file_rate)}; to resample the motion, use "
    hint += argument("fps")
    return [Fault("TAKE011", message, path, (), hint, Severity.NOTE)]


def unused_positions_note(header: BvhHeader, path: str) -> list[Fault]:
    """Return a note if no joint below a root has position channels (BVH113)."""
    child_joints = [joint for joint in header.joints if joint.parent >= 0]
    if any(c.endswith("position") for j in child_joints for c in j.channels or ()):
        return []
    message = f"{argument('source.positions', 'offsets')} has no effect: only roots "
    message += "have position channels"
    return [Fault("BVH113", message, path, (), "remove it", Severity.NOTE)]


class ChannelRanges:
    """Smallest and largest rotation channels and root positions of a file."""

    def __init__(self, columns: IntArray) -> None:
        self.columns = columns
        self.min_values = np.full(len(columns) + 3, np.inf)
        self.max_values = -self.min_values

    def add(self, rows: FloatArray, root: FloatArray) -> None:
        """Extend the ranges to include rows of channels and the root positions.

        ``root`` is ``(F, 3)``, or ``(F, 0)`` without position channels.
        """
        rotations = rows[:, self.columns]
        for values, slots in ((rotations, slice(0, -3)), (root, slice(-3, None))):
            if values.shape[1]:
                self.min_values[slots] = np.minimum(
                    self.min_values[slots], values.min(axis=0)
                )
                self.max_values[slots] = np.maximum(
                    self.max_values[slots], values.max(axis=0)
                )

    @property
    def rotation_summary(self) -> tuple[float, int]:
        """Largest absolute rotation [file's angle], and number of changing channels."""
        low, high = self.min_values[:-3], self.max_values[:-3]
        largest = np.maximum(np.abs(low), np.abs(high)).max(initial=0.0)
        return float(largest), int((high - low > MIN_CHANGE).sum())

    @property
    def travel(self) -> float:
        """Diagonal of the bounding box of the path of the first joint [m]."""
        return float(np.linalg.norm(self.max_values[-3:] - self.min_values[-3:]))


def radians_warning(ranges: ChannelRanges, rig: Rig, path: str) -> list[Fault]:
    """Return a notice if the rotations of a body look like radians (BVH112).

    A warning for a body that travels, and a note for one that moves in place.
    """
    if len(rig.joints) < MIN_BODY_JOINTS or not np.isfinite(ranges.travel):
        return []
    max_angle, moving_channel_count = ranges.rotation_summary
    is_static = moving_channel_count < MIN_BODY_JOINTS
    if is_static or not MIN_RADIANS <= max_angle <= MAX_RADIANS:
        return []
    is_traveling = ranges.travel > MIN_TRAVEL_FRACTION * rest_size(rig)
    is_moving = moving_channel_count >= MIN_MOVING_FRACTION * len(ranges.columns)
    if not is_traveling and not (is_moving and max_angle <= np.pi):
        return []
    message = f"none of {moving_channel_count} rotation channels that change exceeds "
    message += f"{max_angle:.3g}, so the body hardly moves, unless they are radians"
    if is_traveling:
        message = (
            f"the body travels {length_text(ranges.travel)}, but none of "
            f"{moving_channel_count} rotation channels that change exceeds "
            f"{max_angle:.3g}, so the rotations look like radians"
        )
    hint = f"a BVH has degrees: {max_angle:.3g} rad is {np.degrees(max_angle):.3g}; "
    hint += "export degrees, or multiply the rotation channels by 57.2958"
    severity = Severity.WARNING if is_traveling else Severity.NOTE
    return [Fault("BVH112", message, path, (), hint, severity)]
