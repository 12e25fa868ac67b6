"""Finds the frame rate of timed rows, and the frame of each row."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.rates import MAX_STATED_RATE, MIN_STATED_RATE, rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.trajectories import CaptureFile

if TYPE_CHECKING:
    from animtool.motion.markers import Markers

# Tolerance of regular times, in addition to the rounding of printed digits, relative to
# the step: accumulating a step in float64 or float32 causes such errors.
STEP_TOLERANCE = 1e-3
# Largest plausible frame number.
MAX_FRAME_NUMBER = 1e9
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
class FrameFit:
    """Row times fitted to frames of constant length."""

    step: float  # length of a frame [s]
    frames: IntArray  # frame of each row ``(R,)``, from 0
    max_error: float  # largest distance of a time from its frame [s]
    is_regular: bool  # whether the error is within the rounding of printed times


def rounding_error(decimals: int) -> float:
    """Return the largest rounding error of numbers with this many decimals."""
    return float(0.5 * 10.0**-decimals)


def fit_frames(times: FloatArray, frames: IntArray, rounding: float) -> FrameFit:
    """Return the constant step of times ``(R,)`` [s] at known frame numbers.

    >>> fit_frames(np.array([0.0, 0.1, 0.3]), np.array([0, 1, 3]), 0.05).is_regular
    True
    """
    step = float(times[-1] - times[0]) / int(frames[-1])
    max_error = float(np.abs(times - (times[0] + step * frames)).max())
    return FrameFit(
        step, frames, max_error, max_error <= STEP_TOLERANCE * step + 3 * rounding
    )


def median_step(times: FloatArray) -> float:
    """Return the lower median of the times between rows [s]."""
    steps = np.sort(np.diff(times))
    return float(steps[(len(steps) - 1) // 2])


def fit_frames_with_gaps(
    times: FloatArray, step: float, rounding: float
) -> FrameFit | None:
    """Return times fitted to frames ``step`` [s] apart, some of them without a row.

    Returns None if two rows are in one frame, or there are too many frames.

    >>> fit_frames_with_gaps(np.array([0.0, 0.1, 0.2, 0.5]), 0.1, 0.0).frames.tolist()
    [0, 1, 2, 5]
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        step_counts = np.rint(np.diff(times) / step)
    is_in_range = (
        np.isfinite(step_counts).all() and step_counts.sum() <= MAX_FRAME_NUMBER
    )
    if not is_in_range or step_counts.min() < 1:
        return None
    frames = np.concatenate([[0], np.cumsum(step_counts)]).astype(np.int64)
    return fit_frames(times, frames, rounding)


def rate_of_step(step: float, rounding: float, step_count: int) -> Fraction | None:
    """Return the frame rate of a step [s] within rounding; None if out of range.

    ``step_count`` is the number of steps between the two times it was measured from.
    """
    rate = 1.0 / step if step > 0 else np.inf
    if not float(MIN_STATED_RATE) <= rate <= float(MAX_STATED_RATE):
        return None
    # Prefer the nearest integer rate within the rounding of the printed times.
    integer_rate = round(rate)
    if integer_rate and abs(1.0 / integer_rate - step) <= 2 * rounding / step_count:
        return Fraction(integer_rate)
    return rate_from_float(rate)


def choose_frame_fit(
    times: FloatArray,
    numbered_frames: IntArray | None,
    stated_rate: float | None,
    rounding: float,
) -> FrameFit:
    """Return times fitted to numbered frames, a stated rate, or their typical step.

    ``rounding`` is the largest rounding error of the times [s].
    """
    row_frames = np.arange(len(times))
    frame_choices = [f for f in (numbered_frames, row_frames) if f is not None]
    fits = [fit_frames(times, frames, rounding) for frames in frame_choices]
    fits = [fit for fit in fits if fit.is_regular]
    stated_step = None
    if stated_rate is not None and stated_rate > 0:
        stated_step = 1.0 / stated_rate
        matching_fits = [
            fit for fit in fits if matches_rate(fit, stated_rate, rounding)
        ]
        # Times with few decimals may also fit another rate.
        gap_fit = fit_frames_with_gaps(times, stated_step, rounding)
        if gap_fit and gap_fit.is_regular and _has_few_gaps(gap_fit.frames):
            matching_fits.append(gap_fit)
        fits = [*matching_fits, *fits]
    if fits:
        return fits[0]
    step = median_step(times)
    intervals = np.diff(times)
    mean_interval = float(intervals[intervals <= MAX_INTERPOLATED_GAP * step].mean())
    gap_fit = fit_frames_with_gaps(times, mean_interval, rounding)
    if gap_fit is not None and gap_fit.is_regular:
        return gap_fit
    max_error = float(np.abs(times - (times[0] + step * row_frames)).max())
    if (
        stated_step is not None
        and abs(stated_step - mean_interval) <= RATE_TOLERANCE * mean_interval
    ):
        step = stated_step
    gap_fit = fit_frames_with_gaps(times, step, rounding)
    if gap_fit is not None:
        max_error = gap_fit.max_error
    return FrameFit(step, row_frames, max_error, False)


def _has_few_gaps(frames: IntArray) -> bool:
    """Return whether most rows are one frame after the previous row."""
    return int((np.diff(frames) > 1).sum()) <= max(1, len(frames) // MIN_ROWS_PER_GAP)


def matches_rate(fit: FrameFit, stated_rate: float, rounding: float) -> bool:
    """Return whether fitted times agree with a stated rate, within rounding [s]."""
    if not stated_rate > 0:
        return False
    step_count = int(fit.frames[-1]) if fit.is_regular else 1
    span = fit.step * step_count
    # Half a frame at the end of the take, for times that accumulate a rounded step;
    # smaller than the difference between 60 and 59.94.
    drift = min(0.5 / stated_rate, 0.5 * STEP_TOLERANCE * span)
    return abs(span - step_count / stated_rate) <= max(2 * rounding, drift)


def has_few_empty_frames(row_frames: FloatArray | IntArray, marker_count: int) -> bool:
    """Return whether few enough frames have no row, for rows at the given frames."""
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
    first_time: float | None  # time of the first frame [s]; None if frame 1 is time 0

    def build_markers(
        self,
        file: CaptureFile,
        names: tuple[str, ...],
        positions: FloatArray,
        up: UpAxis,
    ) -> Markers:
        """Return markers at frames from positions ``(R, M, 3)`` [m] at rows."""
        from animtool.motion.markers import Markers

        positions = self._resample(positions)
        clock = Clock(self.rate, Fraction(self.start), Fraction(1), len(positions))
        notices, begin = tuple(file.notices), self.first_time
        return Markers(names, clock, positions, up, notices=notices, begin=begin)

    def _resample(self, positions: FloatArray) -> FloatArray:
        """Resample positions ``(R, M, 3)`` at rows to frames ``(F, M, 3)``.

        Frames without a close row are NaN; rows at irregular times are interpolated
        linearly.
        """
        frame_count = int(self.frames[-1] + STEP_TOLERANCE) + 1
        integer_frames = np.rint(self.frames)
        if np.array_equal(integer_frames, self.frames):
            if frame_count == len(positions):
                return positions
            frame_positions = np.full((frame_count, *positions.shape[1:]), np.nan)
            frame_positions[integer_frames.astype(np.int64)] = positions
            return frame_positions
        frames = np.arange(frame_count)
        row_before = (
            np.searchsorted(self.frames, frames + STEP_TOLERANCE, side="right") - 1
        )
        row_before = np.clip(row_before, 0, len(self.frames) - 2)
        row_interval = self.frames[row_before + 1] - self.frames[row_before]
        fraction = np.clip((frames - self.frames[row_before]) / row_interval, 0.0, 1.0)
        tolerance = STEP_TOLERANCE / row_interval
        weight = fraction[:, None, None]
        frame_positions = (
            positions[row_before] * (1.0 - weight) + positions[row_before + 1] * weight
        )
        is_at_row, is_at_next = fraction <= tolerance, fraction >= 1.0 - tolerance
        frame_positions[is_at_row] = positions[row_before][is_at_row]
        frame_positions[is_at_next] = positions[row_before + 1][is_at_next]
        is_in_gap = (row_interval > MAX_INTERPOLATED_GAP) & ~is_at_row & ~is_at_next
        frame_positions[is_in_gap] = np.nan
        return frame_positions
