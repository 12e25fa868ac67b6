"""Finds the frames of TRC rows from Time, Frame# and DataRate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.rates import FractionLike, rate_from_float
from animtool.formats.row_times import (
    MAX_FRAME_NUMBER,
    STEP_TOLERANCE,
    FrameFit,
    RowFrames,
    choose_frame_fit,
    has_few_empty_frames,
    matches_rate,
    rate_of_step,
    rounding_error,
)
from animtool.formats.trajectories import CaptureFile


def find_row_frames(
    file: CaptureFile,
    columns: FloatArray,
    line_numbers: IntArray,
    time_decimals: int,
    stated_rate: float | None,
    fps: FractionLike | None,
    marker_count: int,
) -> RowFrames:
    """Return the frames of the rows; warn about times that contradict each other.

    Args:
        file: The file.
        columns: Frame# and Time [s] ``(R, 2)``.
        line_numbers: Line numbers of the rows ``(R,)``.
        time_decimals: Number of decimals of the times.
        stated_rate: DataRate [1/s]; None if there is none.
        fps: Requested rate; Time is then ignored.
        marker_count: Number of markers, to limit the memory of frames without a row.
    """
    numbers, times = columns[:, 0], columns[:, 1]
    numbered_frames = _frames_by_number(numbers)
    if fps is not None or len(times) == 1 or np.isnan(times).all():
        rate = file.choose_rate(stated_rate, fps)
        if fps is None and len(times) > 1:
            message = f"Time is empty; rows are placed by Frame# at {float(rate):g} fps"
            file.warn("TRC107", message, "write Time, which other programs need")
        if numbered_frames is None:
            _warn_of_numbers(file, numbers, line_numbers, "each row is one frame")
        frames = np.arange(len(times)) if numbered_frames is None else numbered_frames
        first_frame, first_time = _first_frame(numbers[0]), None
    else:
        _check_times(file, numbers, times, line_numbers)
        rounding = rounding_error(time_decimals)
        fit = choose_frame_fit(times, numbered_frames, stated_rate, rounding)
        rate = _rate_of_times(file, fit, stated_rate, rounding)
        if not fit.is_regular:
            with np.errstate(over="ignore"):
                time_frames = (times - times[0]) * float(rate)
            _check_gap_sizes(file, time_frames, marker_count, line_numbers)
            _warn_of_irregular_times(file, fit, times, rate, line_numbers)
            first_frame = _first_frame(numbers[0])
            return RowFrames(rate, first_frame, time_frames, float(times[0]))
        frames = fit.frames
        first_frame, first_time = _first_frame_and_time(
            file, columns, frames, line_numbers, rate, rounding
        )
    _check_gap_sizes(file, frames, marker_count, line_numbers)
    _warn_of_gaps(file, frames, line_numbers, float(rate))
    return RowFrames(rate, first_frame, frames.astype(np.float64), first_time)


def _frames_by_number(numbers: FloatArray) -> IntArray | None:
    """Return frames from 0 by Frame#; None unless its values are ascending integers."""
    first_number = numbers[0]
    is_usable = np.isfinite(numbers) & (np.abs(numbers) < MAX_FRAME_NUMBER)
    if not is_usable.all() or not np.array_equal(np.floor(numbers), numbers):
        return None
    steps = np.diff(numbers)
    if len(steps) and steps.min() < 1:
        return None
    stride = int(np.gcd.reduce(steps.astype(np.int64))) if len(steps) else 1
    return np.asarray((numbers - first_number).astype(np.int64) // stride, np.int64)


def _first_frame(number: float) -> int:
    is_integer = np.isfinite(number) and number == np.floor(number)
    return int(number) if is_integer and abs(number) < MAX_FRAME_NUMBER else 1


def _frame_label(number: float, line: int) -> str:
    is_number = np.isfinite(number)
    return f"frame {number:g} in line {line}" if is_number else f"line {line}"


def _check_times(
    file: CaptureFile, numbers: FloatArray, times: FloatArray, line_numbers: IntArray
) -> None:
    """Raise if the times do not ascend (TRC003)."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_invalid = ~np.isfinite(times)
        is_invalid[1:] |= ~(np.diff(times) > 0)
    invalid_rows = np.flatnonzero(is_invalid)
    if not len(invalid_rows):
        return
    row, other_count = int(invalid_rows[0]), len(invalid_rows) - 1
    row_label = _frame_label(numbers[row], int(line_numbers[row]))
    message = f"the time of {row_label} is not a finite number"
    if np.isfinite(times[row]):
        previous_label = _frame_label(numbers[row - 1], int(line_numbers[row - 1]))
        is_repeated = numbers[row] == numbers[row - 1] or times[row] == times[row - 1]
        relation = "repeats" if is_repeated else "does not come after"
        message = f"{row_label} ({times[row]:g} s) {relation} {previous_label} "
        message += f"({times[row - 1]:g} s)"
    message += f"; {counted(other_count, 'other row')} too" if other_count else ""
    hint = f"correct the times, or set the rate with {argument('source.fps')} to "
    hint += "place rows by Frame#"
    if row and numbers[row] == numbers[row - 1]:
        hint = "delete one of the rows, or correct its Frame# and Time"
    raise file.error("TRC003", message, hint, int(line_numbers[row]))


def _rate_of_times(
    file: CaptureFile, fit: FrameFit, stated_rate: float | None, rounding: float
) -> Fraction:
    """Return the header's frame rate if it matches the times, else their own rate."""
    if stated_rate is not None and matches_rate(fit, stated_rate, rounding):
        return file.choose_rate(stated_rate, None)
    step_count = int(fit.frames[-1]) if fit.is_regular else 1
    rate = rate_of_step(fit.step, rounding, step_count)
    if rate is None:
        message = f"no frame rate fits a row every {fit.step:g} s"
        hint = f"set the rate with {argument('source.fps')} to place rows by Frame#"
        raise file.error("TRC003", message, hint)
    if stated_rate is None or stated_rate <= 0:
        reason = "the header has no DataRate"
        if stated_rate is not None:
            reason = f"DataRate is {stated_rate:g}"
        message = f"{reason}; using {float(rate):g} fps, from Time"
        file.note("TRC104", message)
        return rate
    message = f"Time has a step of {fit.step:.6g} s, {float(rate):g} fps, but "
    message += f"DataRate is {stated_rate:g}; using Time"
    rate_text = f"{float(rate_from_float(stated_rate)):g}"
    hint = f"{argument('source.fps', rate_text)} uses DataRate"
    file.warn("TRC104", message, hint)
    return rate


def _check_gap_sizes(
    file: CaptureFile,
    row_frames: FloatArray | IntArray,
    marker_count: int,
    line_numbers: IntArray,
) -> None:
    """Raise if there are far more frames than rows (TRC003)."""
    if has_few_empty_frames(row_frames, marker_count):
        return
    frame_count = float(row_frames[-1]) + 1
    row = int(np.diff(row_frames).argmax()) + 1
    message = f"{len(row_frames)} rows span {frame_count:.6g} frames; the largest gap "
    message += "is before this row"
    hint = "repair Frame# and Time of the row, or end the file there"
    raise file.error("TRC003", message, hint, int(line_numbers[row]))


def _warn_of_gaps(
    file: CaptureFile, frames: IntArray, line_numbers: IntArray, rate: float
) -> None:
    """Warn about frames without a row (TRC105)."""
    missing_count = int(frames[-1]) + 1 - len(frames)
    if not missing_count:
        return
    gap_indices = np.flatnonzero(np.diff(frames) > 1)
    first_index = int(gap_indices[0])
    gap_length = int(frames[first_index + 1] - frames[first_index]) - 1
    message = f"{counted(gap_length, 'frame')} ({gap_length / rate:.4g} s) "
    message += "is" if gap_length == 1 else "are"
    message += f" missing before line {line_numbers[first_index + 1]}"
    if len(gap_indices) > 1:
        message += f", and {missing_count - gap_length} in "
        message += f"{counted(len(gap_indices) - 1, 'other gap')}"
    hint = "fill the gaps with animtool mocap fill"
    file.warn("TRC105", message, hint, int(line_numbers[first_index + 1]))


def _warn_of_irregular_times(
    file: CaptureFile,
    fit: FrameFit,
    times: FloatArray,
    rate: Fraction,
    line_numbers: IntArray,
) -> None:
    """Warn that rows at irregular times are resampled (TRC106)."""
    intervals = np.diff(times)
    row = int(np.abs(intervals - fit.step).argmax()) + 1
    message = (
        f"rows are {intervals.min():.4g} to {intervals.max():.4g} s apart; resampled "
        f"to {float(rate):g} fps by linear interpolation, except across gaps"
    )
    hint = f"set the rate with {argument('source.fps')} to place rows by Frame#"
    file.warn("TRC106", message, hint, int(line_numbers[row]))


def _warn_of_numbers(
    file: CaptureFile, numbers: FloatArray, line_numbers: IntArray, consequence: str
) -> None:
    """Warn about a Frame# column that does not count frames (TRC107)."""
    with np.errstate(invalid="ignore"):
        is_number = np.isfinite(numbers)
        is_invalid = ~is_number | (np.floor(numbers) != numbers)
        is_invalid[1:] |= ~(np.diff(numbers) >= 1)
    invalid_rows = np.flatnonzero(is_invalid)
    if not len(invalid_rows):
        return
    row = int(invalid_rows[0])
    message = "Frame# is not a number"
    if is_number[row]:
        message = f"Frame# is {numbers[row]:g}"
        message += f" after {numbers[row - 1]:g}" if row else ""
    if len(invalid_rows) > 1:
        message += f", and {counted(len(invalid_rows) - 1, 'other row')} too"
    file.warn("TRC107", f"{message}; {consequence}", None, int(line_numbers[row]))


def _first_frame_and_time(
    file: CaptureFile,
    columns: FloatArray,
    frames: IntArray,
    line_numbers: IntArray,
    rate: Fraction,
    rounding: float,
) -> tuple[int, float | None]:
    """Return the first frame and its time [s]; the time is None if frame 1 is time 0.

    Warns if Frame# and Time disagree (TRC107).
    """
    numbers, times = columns[:, 0], columns[:, 1]
    start = _first_frame(numbers[0])
    time_frame = times[0] * float(rate) + 1
    if len(times) > 1:
        # Times of few decimals may still be exact.
        fit_error = np.abs(times - times[0] - frames / float(rate)).max()
        rounding = min(rounding, float(fit_error))
    if _frames_by_number(numbers) is None:
        _warn_of_numbers(file, numbers, line_numbers, "rows are placed by Time")
        return start, float(times[0])
    mismatched_indices = np.flatnonzero(numbers - numbers[0] != frames)
    if len(mismatched_indices):
        row = int(mismatched_indices[0])
        message = (
            f"frame {numbers[row]:g} is {times[row] - times[0]:.6g} s after frame "
            f"{numbers[0]:g}; at {float(rate):g} fps it would be "
            f"{numbers[0] + frames[row]:g}; rows are placed by Time"
        )
        file.warn("TRC107", message, None, int(line_numbers[row]))
    elif abs(time_frame - start) > STEP_TOLERANCE + 3 * rounding * float(rate):
        message = (
            f"frame {start} is at {times[0]:.6g} s; a TRC keeps that, but in a MOT "
            f"it would be {(start - 1) / float(rate):.6g} s, as frame 1 is at 0 s"
        )
        file.note("TRC107", message)
        return start, float(times[0])
    return start, None
