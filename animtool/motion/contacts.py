"""When feet stand: found from how slow and how low they are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# Jitter is smoothed by a Gaussian of this width [s]: speeds of walking feet change over
# ten times of it.
SMOOTH = 0.03
# Of jitter in speed, what is left of it must stay below the threshold so many times.
ABOVE_NOISE = 1.2
# A foot that stands goes slower than this many lengths of its leg a second: the edge of
# a step is found within a frame of 60 a second (F1 of 0.99 and more on takes whose
# contacts are known, with jitter and without).
SLOW = 0.18
# A foot that stands is no higher above where it is lowest than this many of these.
LOW = 0.12
# A heel that is higher than this many of these is raised: the toe alone stands.
RAISED = 0.05
# Of all frames, those that a foot is lower in are outliers.
LOWEST = 0.02
# Of fewer frames nobody says what stands.
MIN_FRAMES = 3
# Contacts, and gaps in them, that are shorter are none [s].
SHORT = 0.06


@dataclass(frozen=True, slots=True)
class FootContacts:
    """When the parts of a foot stand."""

    ankle: BoolArray  # (F,)
    toe: BoolArray  # (F,)
    ground: float  # height of the ankle where it stands [m]

    @property
    def any(self) -> BoolArray:
        """Whether the foot stands on any of both ``(F,)``."""
        return self.ankle | self.toe


def smoothed(values: FloatArray, width: float) -> FloatArray:
    """Return rows ``(F, …)`` smoothed by a Gaussian of a width [frames]."""
    reach = math.ceil(4 * width)
    if not reach or len(values) < 2:
        return values
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / width) ** 2)
    weights /= weights.sum()
    # Mirrored through the ends, so that straight ways stay straight.
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
    made = [np.convolve(column, weights, "valid") for column in flat.T]
    return np.stack(made, axis=1).reshape(values.shape)


def find_contacts(
    ankle: FloatArray, toe: FloatArray | None, fps: float, leg: float, up: int = 1
) -> FootContacts:
    """Return when a foot stands.

    Speeds are those of smoothed positions; the width grows where a take has so much
    jitter that it would hide contacts. Nothing is assumed of where the ground is: it is
    where the foot is lowest while it is slow.

    Args:
        ankle: Positions ``(F, 3)`` [m].
        toe: Of its toe ``(F, 3)``, if it has one.
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
        # What a Gaussian leaves of the speed of white noise falls with width^1.5.
        left = noise / max(width, 1.0) ** 1.5
        width *= max(1.0, (ABOVE_NOISE * left / slow) ** (2 / 3))
    stands = []
    for point in points:
        smooth = smoothed(point, width)
        speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) * fps
        stands.append((speed < slow, smooth[:, up]))
    masks = []
    for k, (still, height) in enumerate(stands):
        lows = height[still] if still.any() else height
        base = float(np.quantile(lows, LOWEST))
        low = RAISED if k == 0 and toe is not None else LOW
        masks.append(without_short(still & (height < base + low * leg), fps))
    flat = masks[0] & masks[-1]
    height = stands[0][1]
    ground = float(np.median(height[flat])) if flat.any() else float(height.min())
    return FootContacts(masks[0], masks[-1], ground)


def jitter(points: Sequence[FloatArray], fps: float) -> float:
    """Return the speed of white noise on points: of third differences [m/s]."""
    if len(points[0]) < 8:
        return 0.0
    found = [np.diff(point, 3, axis=0) for point in points]
    # Of white noise, third differences are the root of 20 times as large.
    sizes = [float(np.median(np.abs(each))) / 0.6745 / math.sqrt(20) for each in found]
    return max(sizes) * fps * math.sqrt(3)


def without_short(mask: BoolArray, fps: float) -> BoolArray:
    """Return a mask without gaps and spans that are too short to be any."""
    least = SHORT * fps
    made = mask.copy()
    for start, end in runs(~made):
        if start > 0 and end < len(made) and end - start < least:
            made[start:end] = True
    for start, end in runs(made):
        # What the take cuts off may be longer.
        if start > 0 and end < len(made) and end - start < least:
            made[start:end] = False
    return made
