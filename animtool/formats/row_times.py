"""Frame rate of timed rows, and the frame of each row."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.rates import (
    HIGHEST_WRITTEN_RATE,
    LOWEST_WRITTEN_RATE,
    rate_from_float,
)
from animtool.core.record import dataclass

# How far times may be off even ones, beside the rounding of their last place, as a
# share of the time between rows: what adding up a step in float64 or float32 gives.
EVEN = 1e-3
# Of a first frame beyond this number the time is no time of a take.
LAST_START = 1e9
# Frames that rows may become, for each of them, and positions that are no matter: more
# frames without a row are a wrong number rather than a pause.
MAX_FRAMES_EACH = 10
MAX_ABSENT = 1_000_000
# Of a rate, below which that of the header is meant by jittering times.
NEAR_RATE = 0.05
# Rows for a gap, on average: more gaps are another rate.
MIN_ROWS_A_GAP = 4
# Of steps, above which nothing is put between two rows.
GAP_STEPS = 1.5


@dataclass(frozen=True, slots=True)
class TimeSteps:
    """Times as frames of constant length.

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
    """Return the rounding error of a number with some decimals."""
    return float(0.5 * 10.0**-decimals)


def fit_frames(times: FloatArray, frames: IntArray, rounding: float) -> TimeSteps:
    """Return times ``(R,)`` [s] fitted to stated frame numbers.

    >>> fit_frames(np.array([0.0, 0.1, 0.3]), np.array([0, 1, 3]), 0.05).even
    True
    """
    step = float(times[-1] - times[0]) / int(frames[-1])
    off = float(np.abs(times - (times[0] + step * frames)).max())
    return TimeSteps(step, frames, off, off <= EVEN * step + 3 * rounding)


def median_step(times: FloatArray) -> float:
    """Return the lower median of the times between rows [s]."""
    steps = np.sort(np.diff(times))
    return float(steps[(len(steps) - 1) // 2])


def fit_gaps(times: FloatArray, step: float, rounding: float) -> TimeSteps | None:
    """Return times fitted to frames of about a step, some without a row.

    None where two rows are in one frame, or frames are too many to count.

    >>> fit_gaps(np.array([0.0, 0.1, 0.2, 0.5]), 0.1, 0.0).frames.tolist()
    [0, 1, 2, 5]
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        between = np.rint(np.diff(times) / step)
    counted = np.isfinite(between).all() and between.sum() <= LAST_START
    if not counted or between.min() < 1:
        return None
    frames = np.concatenate([[0], np.cumsum(between)]).astype(np.int64)
    return fit_frames(times, frames, rounding)


def rate_of_step(step: float, rounding: float, frames: int) -> Fraction | None:
    """Return the rate of a step [s] within rounding; None if out of range.

    frames: How many steps there are between the two times that it was measured by.
    """
    rate = 1.0 / step if step > 0 else np.inf
    if not float(LOWEST_WRITTEN_RATE) <= rate <= float(HIGHEST_WRITTEN_RATE):
        return None
    # The nearest integer rate within the rounding of the printed times.
    rounded = round(rate)
    if rounded and abs(1.0 / rounded - step) <= 2 * rounding / frames:
        return Fraction(rounded)
    return rate_from_float(rate)


def find_steps(
    times: FloatArray,
    counted_frames: IntArray | None,
    stated: float | None,
    rounding: float,
) -> TimeSteps:
    """Return times as frames: by counted frames, a stated rate, or their step."""
    row_frames = np.arange(len(times))
    candidates = (
        [row_frames] if counted_frames is None else [counted_frames, row_frames]
    )
    fits = [fit_frames(times, frames, rounding) for frames in candidates]
    fits = [steps for steps in fits if steps.even]
    rates = [1.0 / stated] if stated is not None and stated > 0 else []
    if stated is not None and rates:
        meant = [steps for steps in fits if is_rate_of(stated, steps, rounding)]
        # Times with few decimals may also fit another rate.
        gaps = fit_gaps(times, rates[0], rounding)
        if gaps is not None and gaps.even and _has_few_gaps(gaps.frames):
            meant.append(gaps)
        fits = [*meant, *fits]
    if fits:
        return fits[0]
    median = median_step(times)
    between = np.diff(times)
    mean = float(between[between <= GAP_STEPS * median].mean())
    fit = fit_gaps(times, mean, rounding)
    if fit is not None and fit.even:
        return fit
    line = times[0] + median * row_frames
    near = [step for step in rates if abs(step - mean) <= NEAR_RATE * mean]
    step = near[0] if near else median
    fit = fit_gaps(times, step, rounding)
    off = fit.off if fit is not None else float(np.abs(times - line).max())
    return TimeSteps(step, row_frames, off, False)


def _has_few_gaps(frames: IntArray) -> bool:
    """Return whether most rows are one frame after the previous row."""
    return int((np.diff(frames) > 1).sum()) <= max(1, len(frames) // MIN_ROWS_A_GAP)


def is_rate_of(stated: float, steps: TimeSteps, rounding: float) -> bool:
    """Return whether a stated rate fits times within their rounding."""
    if not stated > 0:
        return False
    count = int(steps.frames[-1]) if steps.even else 1
    span = steps.step * count
    # Half a frame at the end of the take, for times that add up a rounded step; less
    # than between 60 and 59.94.
    least = min(0.5 / stated, 0.5 * EVEN * span)
    return abs(span - count / stated) <= max(2 * rounding, least)


def has_room(at: FloatArray | IntArray, markers: int) -> bool:
    """Return whether rows at frames ``(R,)`` leave few enough frames empty."""
    frames = (float(at[-1]) + 1) * markers
    return frames <= max(MAX_ABSENT, MAX_FRAMES_EACH * len(at) * markers)


@dataclass(frozen=True, slots=True)
class RowFrames:
    """Frame positions of rows.

    Attributes:
        rate: Frames a second.
        start: Number of the first frame.
        at: Frame of each row ``(R,)``, from 0; whole numbers unless times are uneven.
        begin: Time of the first frame [s]; None where frame 1 is time 0.
    """

    rate: Fraction
    start: int
    at: FloatArray
    begin: float | None

    def placed(self, positions: FloatArray) -> FloatArray:
        """Resample positions ``(R, M, 3)`` at rows to frames ``(F, M, 3)``.

        NaN where no row is near; between rows at uneven times, straight lines.
        """
        count = int(self.at[-1] + EVEN) + 1
        rounded = np.rint(self.at)
        if np.array_equal(rounded, self.at):
            if count == len(positions):
                return positions
            placed = np.full((count, *positions.shape[1:]), np.nan)
            placed[rounded.astype(np.int64)] = positions
            return placed
        frames = np.arange(count)
        low = np.searchsorted(self.at, frames + EVEN, side="right") - 1
        low = np.clip(low, 0, len(self.at) - 2)
        width = self.at[low + 1] - self.at[low]
        fraction = np.clip((frames - self.at[low]) / width, 0.0, 1.0)
        near = EVEN / width
        in_gap = (width > GAP_STEPS) & (fraction > near) & (fraction < 1.0 - near)
        weight = fraction[:, None, None]
        placed = positions[low] * (1.0 - weight) + positions[low + 1] * weight
        placed[fraction <= near] = positions[low][fraction <= near]
        placed[fraction >= 1.0 - near] = positions[low + 1][fraction >= 1.0 - near]
        placed[in_gap] = np.nan
        return placed
