"""The rate of rows that stand at times, and the frame of each."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rates import HIGHEST_WRITTEN_RATE, LOWEST_WRITTEN_RATE, rate_from_float

# How far times may be off even ones, beside the rounding of their last place, as a
# share of the time between rows: what adding up a step in float64 or float32 gives.
EVEN = 1e-3
# Of a first frame beyond this number the time is no time of a take.
LAST_START = 1e9


@dataclass(frozen=True, slots=True)
class Steps:
    """Times as frames of one length.

    Attributes:
        step: Length of a frame [s].
        frames: Frame of each row ``(R,)``, from 0.
        off: The farthest that a time is from its frame [s].
        even: Whether that is within what printing leaves open.
    """

    step: float
    frames: IntArray
    off: float
    even: bool


def rounding_of(decimals: int) -> float:
    """Return how far a number printed with some places may be off."""
    return float(0.5 * 10.0**-decimals)


def fit_frames(times: FloatArray, frames: IntArray, rounding: float) -> Steps:
    """Return times ``(R,)`` [s] as the frames that rows are said to have.

    >>> fit_frames(np.array([0.0, 0.1, 0.3]), np.array([0, 1, 3]), 0.05).even
    True
    """
    step = float(times[-1] - times[0]) / int(frames[-1])
    off = float(np.abs(times - (times[0] + step * frames)).max())
    return Steps(step, frames, off, off <= EVEN * step + 3 * rounding)


def usual_step(times: FloatArray) -> float:
    """Return the median time between rows [s], the lower one of two."""
    steps = np.sort(np.diff(times))
    return float(steps[(len(steps) - 1) // 2])


def fit_gaps(times: FloatArray, step: float, rounding: float) -> Steps | None:
    """Return times as frames of about a step, of which some have no row.

    None where two rows are in one frame, or frames are too many to count.

    >>> fit_gaps(np.array([0.0, 0.1, 0.2, 0.5]), 0.1, 0.0).frames.tolist()
    [0, 1, 2, 5]
    """
    between = np.rint(np.diff(times) / step)
    counted = np.isfinite(between).all() and between.sum() <= LAST_START
    if not counted or between.min() < 1:
        return None
    frames = np.concatenate([[0], np.cumsum(between)]).astype(np.int64)
    return fit_frames(times, frames, rounding)


def rate_of_step(step: float, rounding: float, frames: int) -> Fraction | None:
    """Return the rate of a step [s] between times that are rounded; None beyond all.

    frames: How many steps there are between the two times that it was measured by.
    """
    rate = 1.0 / step if step > 0 else np.inf
    if not float(LOWEST_WRITTEN_RATE) <= rate <= float(HIGHEST_WRITTEN_RATE):
        return None
    # The nearest whole rate that the printed times leave open.
    whole = round(rate)
    if whole and abs(1.0 / whole - step) <= 2 * rounding / frames:
        return Fraction(whole)
    return rate_from_float(rate)
