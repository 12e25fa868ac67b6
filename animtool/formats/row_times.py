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
    """Return the largest rounding error of numbers with a number of decimals."""
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
    """Return times fitted to frames of about ``step`` [s], some of which have no row.

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
    """Return times fitted to counted frames, a stated rate, or their typical step."""
    row_frames = np.arange(len(times))
    candidates = (
        [row_frames] if counted_frames is None else [counted_frames, row_frames]
    )
    fitted_steps = [fit_frames(times, frames, rounding) for frames in candidates]
    fitted_steps = [steps for steps in fitted_steps if steps.regular]
    stated_step = None
    if stated_rate is not None and stated_rate > 0:
        stated_step = 1.0 / stated_rate
        matching_steps = [
            steps
            for steps in fitted_steps
            if matches_rate(steps, stated_rate, rounding)
        ]
        # Times with few decimals may also fit another rate.
        gap_steps = fit_frames_with_gaps(times, stated_step, rounding)
        if gap_steps and gap_steps.regular and _has_few_gaps(gap_steps.frames):
            matching_steps.append(gap_steps)
        fitted_steps = [*matching_steps, *fitted_steps]
    if fitted_steps:
        return fitted_steps[0]
    step = median_step(times)
    intervals = np.diff(times)
    mean = float(intervals[intervals <= MAX_INTERPOLATED_GAP * step].mean())
    gap_steps = fit_frames_with_gaps(times, mean, rounding)
    if gap_steps is not None and gap_steps.regular:
        return gap_steps
    error = float(np.abs(times - (times[0] + step * row_frames)).max())
    if stated_step is not None and abs(stated_step - mean) <= RATE_TOLERANCE * mean:
        step = stated_step
    gap_steps = fit_frames_with_gaps(times, step, rounding)
    if gap_steps is not None:
        error = gap_steps.error
    return TimeSteps(step, row_frames, error, False)


def _has_few_gaps(frames: IntArray) -> bool:
    """Return whether most rows are one frame after the previous row."""
    return int((np.diff(frames) > 1).sum()) <= max(1, len(frames) // MIN_ROWS_PER_GAP)


def matches_rate(steps: TimeSteps, stated_rate: float, rounding: float) -> bool:
    """Return whether fitted times have a stated rate, within their rounding [s]."""
    if not stated_rate > 0:
        return False
    count = int(steps.frames[-1]) if steps.regular else 1
    span = steps.step * count
    # Half a frame at the end of the take, for times that accumulate a rounded step;
    # smaller than the difference between 60 and 59.94.
    drift = min(0.5 / stated_rate, 0.5 * STEP_TOLERANCE * span)
    return abs(span - count / stated_rate) <= max(2 * rounding, drift)


def has_few_empty_frames(row_frames: FloatArray | IntArray, marker_count: int) -> bool:
    """Return whether rows at frames ``(R,)`` leave few enough frames without a row."""
    position_count = (float(row_frames[-1]) + 1) * marker_count
    row_position_count = len(row_frames) * marker_count
    return position_count <= max(
        MAX_EMPTY_FRAMES, MAX_FRAMES_PER_ROW * row_position_count
    )


@dataclass(frozen=True, slots=True)
class RowFrames:
    """Frames of the rows of a file, and the rate of the frames."""

    rate: Fraction  # frames per second
    start: int  # number of the first frame
    # Frame of each row ``(R,)``, from 0; integers unless times are irregular.
    frames: FloatArray
    begin: float | None  # time of the first frame [s]; None if frame 1 is time 0

    def resample(self, positions: FloatArray) -> FloatArray:
        """Resample positions ``(R, M, 3)`` at rows to frames ``(F, M, 3)``.

        Frames without a close row are NaN; rows at irregular times are interpolated
        linearly.
        """
        count = int(self.frames[-1] + STEP_TOLERANCE) + 1
        integer_frames = np.rint(self.frames)
        if np.array_equal(integer_frames, self.frames):
            if count == len(positions):
                return positions
            resampled = np.full((count, *positions.shape[1:]), np.nan)
            resampled[integer_frames.astype(np.int64)] = positions
            return resampled
        frames = np.arange(count)
        row_before = (
            np.searchsorted(self.frames, frames + STEP_TOLERANCE, side="right") - 1
        )
        row_before = np.clip(row_before, 0, len(self.frames) - 2)
        interval = self.frames[row_before + 1] - self.frames[row_before]
        fraction = np.clip((frames - self.frames[row_before]) / interval, 0.0, 1.0)
        tolerance = STEP_TOLERANCE / interval
        weight = fraction[:, None, None]
        resampled = (
            positions[row_before] * (1.0 - weight) + positions[row_before + 1] * weight
        )
        is_at_row, is_at_next = fraction <= tolerance, fraction >= 1.0 - tolerance
        resampled[is_at_row] = positions[row_before][is_at_row]
        resampled[is_at_next] = positions[row_before + 1][is_at_next]
        in_gap = (interval > MAX_INTERPOLATED_GAP) & ~is_at_row & ~is_at_next
        resampled[in_gap] = np.nan
        return resampled
