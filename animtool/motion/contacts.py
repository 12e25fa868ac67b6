"""Detects foot contacts from the speed and height of feet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# Width of the Gaussian that smooths jitter [s]: the speed of walking feet changes over
# ten times as long.
SMOOTH = 0.03
# Margin of the speed threshold over the jitter that smoothing leaves.
ABOVE_NOISE = 1.2
# Largest speed of a standing foot in leg lengths per second: contact edges are then
# within a frame at 60 fps (F1 of at least 0.99 on takes with known contacts, with and
# without jitter).
SLOW = 0.18
# Largest height of a standing foot above its lowest, in leg lengths.
LOW = 0.12
# A heel higher than this is raised, and only the toe stands.
RAISED = 0.05
# Quantile of heights below which frames are outliers.
LOWEST = 0.02
# Fewer frames have no contacts.
MIN_FRAMES = 3
# Shorter contacts and gaps are ignored [s].
SHORT = 0.06


@dataclass(frozen=True, slots=True)
class FootContacts:
    """Contact frames of the parts of a foot."""

    ankle: BoolArray  # (F,)
    toe: BoolArray  # (F,)
    ground: float  # height of the standing ankle [m]

    @property
    def any(self) -> BoolArray:
        """Mask of frames in which ankle or toe stands ``(F,)``."""
        return self.ankle | self.toe


def smoothed(values: FloatArray, width: float) -> FloatArray:
    """Return rows ``(F, …)`` smoothed by a Gaussian of a width [frames]."""
    reach = math.ceil(4 * width)
    if not reach or len(values) < 2:
        return values
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / width) ** 2)
    weights /= weights.sum()
    # Mirrored at the ends, so that straight lines stay straight.
    count = len(values)
    folded = np.arange(-reach, count + reach)
    inside = np.clip(folded, 0, count - 1)
    beyond = np.clip(2 * inside - folded, 0, count - 1)
    padded = np.where(
        (folded == inside).reshape(-1, *[1] * (values.ndim - 1)),
        values[inside],
        2 * values[inside] - values[beyond],
    )
    flat = padded.reshape(len(padded), -1)
    smooth = [np.convolve(column, weights, "valid") for column in flat.T]
    return np.stack(smooth, axis=1).reshape(values.shape)


def find_contacts(
    ankle: FloatArray, toe: FloatArray | None, fps: float, leg: float, up: int = 1
) -> FootContacts:
    """Return the contact frames of a foot.

    Speeds are of smoothed positions; the width grows for takes whose jitter would hide
    contacts. The ground is not assumed: it is where the foot is lowest while slow.

    Args:
        ankle: Positions ``(F, 3)`` [m].
        toe: Positions of its toe ``(F, 3)``, if any.
        fps: Frames a second.
        leg: Length of thigh and shin [m].
        up: Component that points up.
    """
    slow = SLOW * leg
    points = [ankle] if toe is None else [ankle, toe]
    if len(ankle) < MIN_FRAMES or leg <= 0:
        nothing = np.zeros(len(ankle), np.bool_)
        return FootContacts(nothing, nothing, float(ankle[:, up].min(initial=np.inf)))
    width = SMOOTH * fps
    noise = jitter(points, fps)
    if noise > 0:
        # A Gaussian reduces the speed of white noise by width^1.5.
        left = noise / max(width, 1.0) ** 1.5
        width *= max(1.0, (ABOVE_NOISE * left / slow) ** (2 / 3))
    stands = []
    for point in points:
        smooth = smoothed(point, width)
        speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) * fps
        stands.append((speed < slow, smooth[:, up]))
    masks = []
    for k, (slow_frames, height) in enumerate(stands):
        lows = height[slow_frames] if slow_frames.any() else height
        base = float(np.quantile(lows, LOWEST))
        low = RAISED if k == 0 and toe is not None else LOW
        masks.append(without_short(slow_frames & (height < base + low * leg), fps))
    flat = masks[0] & masks[-1]
    height = stands[0][1]
    ground = float(np.median(height[flat])) if flat.any() else float(height.min())
    return FootContacts(masks[0], masks[-1], ground)


def jitter(points: Sequence[FloatArray], fps: float) -> float:
    """Return the speed of white noise on points, from third differences [m/s]."""
    if len(points[0]) < 8:
        return 0.0
    differences = [np.diff(point, 3, axis=0) for point in points]
    # Third differences of white noise are sqrt(20) times as large.
    sizes = [
        float(np.median(np.abs(each))) / 0.6745 / math.sqrt(20) for each in differences
    ]
    return max(sizes) * fps * math.sqrt(3)


def without_short(mask: BoolArray, fps: float) -> BoolArray:
    """Return a mask without short gaps and short spans."""
    least = SHORT * fps
    cleaned = mask.copy()
    for start, end in runs(~cleaned):
        if start > 0 and end < len(cleaned) and end - start < least:
            cleaned[start:end] = True
    for start, end in runs(cleaned):
        # Spans cut off by the take may be longer.
        if start > 0 and end < len(cleaned) and end - start < least:
            cleaned[start:end] = False
    return cleaned
