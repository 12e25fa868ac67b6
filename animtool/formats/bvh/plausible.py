"""Rates and rotations of a BVH file that look mistaken."""

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

# Skeletons with fewer joints may be props.
MIN_JOINTS = 8
# Film transferred to video runs slower by a thousandth.
SAME_RATE = Fraction(2, 1000)
# A body that goes farther than this fraction of its size rotates its limbs by more than
# the largest angle in radians; so many channels change by more than noise [deg].
MIN_TRAVEL, MIN_RADIANS, MAX_RADIANS, MIN_ROTATION = 0.5, 0.7, 6.4, 0.1


def rate_contradiction(header: BvhHeader, rate: Fraction, path: str) -> list[Fault]:
    """Return a note that the stated rate is not that of a plausible Frame Time."""
    assert header.rate is not None
    own, frames = header.rate.fps, header.declared_frames
    same = abs(rate - own) <= SAME_RATE * own or rate in header.rate.ambiguous_rates
    if same or header.rate.kind is RateKind.PRINTED or rate_warning(own):
        return []
    stated = argument("source.fps", f"{float(rate):g}")
    message = f"Frame Time {header.frame_time} is {rate_label(own)}, not {stated}"
    if frames:
        lengths = [f"{float(frames / fps):.3g} s" for fps in (rate, own)]
        message += f": {frames} frames last {lengths[0]} instead of {lengths[1]}"
    hint = f"to resample the motion, use {argument('fps')} instead"
    return [Fault("TAKE011", message, path, (), hint, Severity.NOTE)]


def unused_positions(header: BvhHeader, path: str) -> list[Fault]:
    """Return a note that no joint below a root has positions to ignore (BVH113)."""
    below = [joint for joint in header.joints if joint.parent >= 0]
    has_positions = any(
        channel.endswith("position")
        for joint in below
        for channel in joint.channels or ()
    )
    if has_positions:
        return []
    stated = argument("source.positions", "offsets")
    message = f"{stated} has no effect: only roots have position channels"
    return [Fault("BVH113", message, path, (), "remove it", Severity.NOTE)]


class ChannelRanges:
    """Ranges of the rotation channels and of the root over the rows of a file."""

    def __init__(self, columns: IntArray) -> None:
        self.columns = columns
        self.low = np.full(len(columns) + 3, np.inf)
        self.high = -self.low

    def add(self, rows: FloatArray, root: FloatArray) -> None:
        """Extend the ranges by some rows, with the positions of the first joint.

        ``root`` is ``(F, 3)``, or ``(F, 0)`` without position channels.
        """
        values = rows[:, self.columns]
        for k, column in enumerate((values, root)):
            if not column.shape[1]:
                continue
            part = slice(-3, None) if k else slice(0, -3)
            self.low[part] = np.minimum(self.low[part], column.min(axis=0))
            self.high[part] = np.maximum(self.high[part], column.max(axis=0))

    @property
    def rotations(self) -> tuple[float, int]:
        """Largest rotation, and number of rotations that change [file's angle]."""
        low, high = self.low[:-3], self.high[:-3]
        largest = np.maximum(np.abs(low), np.abs(high)).max(initial=0.0)
        return float(largest), int((high - low > MIN_ROTATION).sum())

    @property
    def travel(self) -> float:
        """Extent of the path of the first joint [m]."""
        return float(np.linalg.norm(self.high[-3:] - self.low[-3:]))


def radians_warning(ranges: ChannelRanges, rig: Rig, path: str) -> list[Fault]:
    """Return a warning about a body that travels with rotations of a few degrees."""
    size = rest_size(rig)
    if len(rig.joints) < MIN_JOINTS or not np.isfinite(ranges.travel):
        return []
    largest, count = ranges.rotations
    stays = ranges.travel <= MIN_TRAVEL * size or count < MIN_JOINTS
    if stays or not MIN_RADIANS <= largest <= MAX_RADIANS:
        return []
    message = (
        f"the body travels {length_text(ranges.travel)}, but none of {count} rotation "
        f"channels that change exceeds {largest:.3g}: the rotations look like radians"
    )
    hint = f"a BVH has degrees: {largest:.3g} rad is {np.degrees(largest):.3g}; export "
    hint += "degrees, or multiply the rotation channels by 57.2958"
    return [Fault("BVH112", message, path, (), hint, Severity.WARNING)]
