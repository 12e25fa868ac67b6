"""Finds the frame rate of timed rows, and the frame of each row."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.rates import (
    MAX_STATED_RATE,
    MIN_STATED_RATE,
    rate_from_float,
)
from animtool.core.record import dataclass

# Tolerance of regular times, in addition to the rounding of printed digits, relative to
# the step: accumulating a step in float64 or float32 causes such errors.
STEP_TOLERANCE = 1e-3
# Largest plausible number of a first frame.
MAX_START_FRAME = 1e9
# Maximum frames per row, and number of empty positions that is always allowed: more
# frames without a row indicate a wrong number, not a pause.
MAX_FRAMES_PER_ROW = 10
MAX_EMPTY_FRAMES = 1_000_000
# Relative difference up to which jittering times have the header's rate.
RATE_TOLERANCE = 0.05
# Minimum rows per gap, on average; more gaps indicate another rate.
MIN_ROWS_PER_GAP = 4
# Longest interval that is interpolated between two rows [steps].
MAX_INTERPOLATED_GAP = 1.5


@dataclass(frozen=True, slots=True)
class TimeSteps:
    """Row times fitted to frames of constant length."""

    step: float  # length of a frame [s]
    frames: IntArray  # frame of each row ``(R,)``, from 0
    error: float  # largest distance of a time from its frame [s]
    regular: bool  # whether the error is within the rounding of printed times


def rounding_error(decimals: int) -> float:
    """Return the rounding error of numbers with a number of decimals."""
    return float(0.5 * 10.0**-decimals)


def fit_frames(times: FloatArray, frames: IntArray, rounding: float) -> TimeSteps:
    """Return times ``(R,)`` [s] fitted to stated frame numbers.

    >>> fit_frames(np.array([0.0, 0.1, 0.3]), np.array([0, 1, 3]), 0.05).regular
    True
    """
    step = float(times[-1] - times[0]) / int(frames[-1])
    error = float(np.abs(times - (times[0] + step * frames)).max())
    return TimeSteps(step, frames, error, error <= STEP_TOLERANCE * step + 3 * rounding)


def median_step(times: FloatArray) -> float:
    """Return the lower median of the times between rows [s]."""
    steps = np.sort(np.diff(times))
    return float(steps[(len(steps) - 1) // 2])


def fit_frames_with_gaps(
    times: FloatArray, step: float, rounding: float
) -> TimeSteps | None:
    """Return times fitted to frames of about ``step``; frames may lack a row.

    Returns None if two rows are in one frame, or there are too many frames.

    >>> fit_frames_with_gaps(np.array([0.0, 0.1, 0.2, 0.5]), 0.1, 0.0).frames.tolist()
    [0, 1, 2, 5]
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        steps_between = np.rint(np.diff(times) / step)
    is_countable = (
        np.isfinite(steps_between).all() and steps_between.sum() <= MAX_START_FRAME
    )
    if not is_countable or steps_between.min() < 1:
        return None
    frames = np.concatenate([[0], np.cumsum(steps_between)]).astype(np.int64)
    return fit_frames(times, frames, rounding)


def rate_of_step(step: float, rounding: float, frames: int) -> Fraction | None:
    """Return the rate of a step [s] within rounding; None if out of range.

    ``frames`` is the number of steps between the two times it was measured from.
    """
    rate = 1.0 / step if step > 0 else np.inf
    if not float(MIN_STATED_RATE) <= rate <= float(MAX_STATED_RATE):
        return None
    # Prefer the nearest integer rate within the rounding of the printed times.
    integer_rate = round(rate)
    if integer_rate and abs(1.0 / integer_rate - step) <= 2 * rounding / frames:
        return Fraction(integer_rate)
    return rate_from_float(rate)


def find_steps(
    times: FloatArray,
    counted_frames: IntArray | None,
    stated_rate: float | None,
    rounding: float,
) -> TimeSteps:
    """Fit times to frames by counted frames, a stated rate, or their typical step."""
    row_frames = np.arange(len(times))
    candidates = (
        [row_frames] if counted_frames is None else [counted_frames, row_frames]
    )
    fitted_steps = [fit_frames(times, frames, rounding) for frames in candidates]
    fitted_steps = [steps for steps in fitted_steps if steps.regular]
    stated_steps = (
        [1.0 / stated_rate] if stated_rate is not None and stated_rate > 0 else []
    )
    if stated_rate is not None and stated_steps:
        matching_steps = [
            steps for steps in fitted_steps if is_rate_of(stated_rate, steps, rounding)
        ]
        # Times with few decimals may also fit another rate.
        gaps = fit_frames_with_gaps(times, stated_steps[0], rounding)
        if gaps is not None and gaps.regular and _has_few_gaps(gaps.frames):
            matching_steps.append(gaps)
        fitted_steps = [*matching_steps, *fitted_steps]
    if fitted_steps:
        return fitted_steps[0]
    median = median_step(times)
    intervals = np.diff(times)
    mean = float(intervals[intervals <= MAX_INTERPOLATED_GAP * median].mean())
    gap_steps = fit_frames_with_gaps(times, mean, rounding)
    if gap_steps is not None and gap_steps.regular:
        return gap_steps
    regular_times = times[0] + median * row_frames
    close_steps = [s for s in stated_steps if abs(s - mean) <= RATE_TOLERANCE * mean]
    step = close_steps[0] if close_steps else median
    gap_steps = fit_frames_with_gaps(times, step, rounding)
    error = float(np.abs(times - regular_times).max())
    if gap_steps is not None:
        error = gap_steps.error
    return TimeSteps(step, row_frames, error, False)


def _has_few_gaps(frames: IntArray) -> bool:
    """Return whether most rows are one frame after the previous row."""
    return int((np.diff(frames) > 1).sum()) <= max(1, len(frames) // MIN_ROWS_PER_GAP)


def is_rate_of(stated_rate: float, steps: TimeSteps, rounding: float) -> bool:
    """Return whether a stated rate fits times within their rounding."""
    if not stated_rate > 0:
        return False
    count = int(steps.frames[-1]) if steps.regular else 1
    span = steps.step * count
    # Half a frame at the end of the take, for times that accumulate a rounded step;
    # smaller than the difference between 60 and 59.94.
    drift = min(0.5 / stated_rate, 0.5 * STEP_TOLERANCE * span)
    return abs(span - count / stated_rate) <= max(2 * rounding, drift)


def has_few_empty_frames(at: FloatArray | IntArray, markers: int) -> bool:
    """Return whether rows at frames ``(R,)`` leave few enough frames empty."""
    frames = (float(at[-1]) + 1) * markers
    return frames <= max(MAX_EMPTY_FRAMES, MAX_FRAMES_PER_ROW * len(at) * markers)


@dataclass(frozen=True, slots=True)
class RowFrames:
    """Frame positions of rows."""

    rate: Fraction  # frames per second
    start: int  # number of the first frame
    # Frame of each row ``(R,)``, from 0; integers unless times are irregular.
    at: FloatArray
    begin: float | None  # time of the first frame [s]; None if frame 1 is time 0

    def at_frames(self, positions: FloatArray) -> FloatArray:
        """Resample positions ``(R, M, 3)`` at rows to frames ``(F, M, 3)``.

        Frames without a close row are NaN; rows at irregular times are interpolated
        linearly.
        """
        count = int(self.at[-1] + STEP_TOLERANCE) + 1
        integer_frames = np.rint(self.at)
        if np.array_equal(integer_frames, self.at):
            if count == len(positions):
                return positions
            at_frames = np.full((count, *positions.shape[1:]), np.nan)
            at_frames[integer_frames.astype(np.int64)] = positions
            return at_frames
        frames = np.arange(count)
        row_before = np.searchsorted(self.at, frames + STEP_TOLERANCE, side="right") - 1
        row_before = np.clip(row_before, 0, len(self.at) - 2)
        width = self.at[row_before + 1] - self.at[row_before]
        fraction = np.clip((frames - self.at[row_before]) / width, 0.0, 1.0)
        tolerance = STEP_TOLERANCE / width
        in_gap = (
            (width > MAX_INTERPOLATED_GAP)
            & (fraction > tolerance)
            & (fraction < 1.0 - tolerance)
        )
        weight = fraction[:, None, None]
        at_frames = (
            positions[row_before] * (1.0 - weight) + positions[row_before + 1] * weight
        )
        at_frames[fraction <= tolerance] = positions[row_before][fraction <= tolerance]
        at_frames[fraction >= 1.0 - tolerance] = positions[row_before + 1][
            fraction >= 1.0 - tolerance
        ]
        at_frames[in_gap] = np.nan
        return at_frames
