"""Finds the frames of TRC rows from Time, Frame# and DataRate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.rates import FractionLike, rate_from_float
from animtool.formats.row_times import (
    MAX_START_FRAME,
    STEP_TOLERANCE,
    RowFrames,
    TimeSteps,
    find_steps,
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
    decimals: int,
    stated_rate: float | None,
    fps: FractionLike | None,
    marker_count: int,
) -> RowFrames:
    """Return the frames of the rows; warn about times that contradict each other.

    Args:
        file: The file.
        columns: Frame# and Time [s] ``(R, 2)``.
        line_numbers: Line numbers of the rows ``(R,)``.
        decimals: Number of decimals of the times.
        stated_rate: DataRate [1/s]; None without one.
        fps: Requested rate; Time is then ignored.
        marker_count: Number of markers, to limit the memory of frames without a row.
    """
    numbers, times = columns[:, 0], columns[:, 1]
    counted_frames = _counted_frames(numbers)
    if fps is not None or len(times) == 1 or np.isnan(times).all():
        rate = file.choose_rate(stated_rate, fps)
        if fps is None and len(times) > 1:
            message = f"Time is empty; rows are placed by Frame# at {float(rate):g} fps"
            file.warn("TRC107", message, "write Time, which other programs need")
        if counted_frames is None:
            _warn_numbers(file, numbers, line_numbers, "each row is one frame")
        frames = np.arange(len(times)) if counted_frames is None else counted_frames
        start, begin = _start_frame(numbers[0]), None
    else:
        _check_times(file, numbers, times, line_numbers)
        rounding = rounding_error(decimals)
        steps = find_steps(times, counted_frames, stated_rate, rounding)
        rate = _rate_of_times(file, steps, stated_rate, rounding)
        if not steps.regular:
            with np.errstate(over="ignore"):
                time_frames = (times - times[0]) * float(rate)
            _check_gaps(file, time_frames, marker_count, line_numbers)
            _warn_irregular(file, steps, times, rate, line_numbers)
            start = _start_frame(numbers[0])
            return RowFrames(rate, start, time_frames, float(times[0]))
        frames = steps.frames
        start, begin = _first_frame_and_time(
            file, columns, frames, line_numbers, rate, rounding
        )
    _check_gaps(file, frames, marker_count, line_numbers)
    _warn_gaps(file, frames, line_numbers, float(rate))
    return RowFrames(rate, start, frames.astype(np.float64), begin)


def _counted_frames(numbers: FloatArray) -> IntArray | None:
    """Return frames from 0 by Frame#; None if it does not have ascending integers."""
    first_number = numbers[0]
    usable = np.isfinite(numbers) & (np.abs(numbers) < MAX_START_FRAME)
    if not usable.all() or not np.array_equal(np.floor(numbers), numbers):
        return None
    steps = np.diff(numbers)
    if len(steps) and steps.min() < 1:
        return None
    stride = int(np.gcd.reduce(steps.astype(np.int64))) if len(steps) else 1
    return np.asarray((numbers - first_number).astype(np.int64) // stride, np.int64)


def _start_frame(number: float) -> int:
    is_integer = np.isfinite(number) and number == np.floor(number)
    return int(number) if is_integer and abs(number) < MAX_START_FRAME else 1


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
    rows = np.flatnonzero(is_invalid)
    if not len(rows):
        return
    row, other_count = int(rows[0]), len(rows) - 1
    row_frame = _frame_label(numbers[row], int(line_numbers[row]))
    message = f"the time of {row_frame} is not a finite number"
    if np.isfinite(times[row]):
        previous_frame = _frame_label(numbers[row - 1], int(line_numbers[row - 1]))
        is_repeated = numbers[row] == numbers[row - 1] or times[row] == times[row - 1]
        relation = "repeats" if is_repeated else "does not come after"
        message = f"{row_frame}, at {times[row]:g} s, {relation} {previous_frame}, at "
        message += f"{times[row - 1]:g} s"
    message += f"; {counted(other_count, 'other row')} too" if other_count else ""
    hint = f"repair the rows, or set the rate with {argument('source.fps')} to place "
    hint += "them by Frame#"
    raise file.error("TRC003", message, hint, int(line_numbers[row]))


def _rate_of_times(
    file: CaptureFile, steps: TimeSteps, stated_rate: float | None, rounding: float
) -> Fraction:
    """Return the header's frame rate if it matches the times, else their own rate."""
    if stated_rate is not None and matches_rate(steps, stated_rate, rounding):
        return file.choose_rate(stated_rate, None)
    count = int(steps.frames[-1]) if steps.regular else 1
    rate = rate_of_step(steps.step, rounding, count)
    if rate is None:
        message = f"no frame rate fits a row every {steps.step:g} s"
        hint = f"set the rate with {argument('source.fps')} to place rows by Frame#"
        raise file.error("TRC003", message, hint)
    if stated_rate is None or stated_rate <= 0:
        no_rate = "the header has no DataRate"
        if stated_rate is not None:
            no_rate = f"DataRate is {stated_rate:g}"
        message = f"{no_rate}; using {float(rate):g} fps, from Time"
        file.note("TRC104", message)
        return rate
    message = f"Time has a step of {steps.step:.6g} s, {float(rate):g} fps, but "
    message += f"DataRate is {stated_rate:g}; using Time"
    rate_text = f"{float(rate_from_float(stated_rate)):g}"
    hint = f"{argument('source.fps', rate_text)} uses DataRate"
    file.warn("TRC104", message, hint)
    return rate


def _check_gaps(
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


def _warn_gaps(
    file: CaptureFile, frames: IntArray, line_numbers: IntArray, rate: float
) -> None:
    """Warn about frames without a row (TRC105)."""
    missing_count = int(frames[-1]) + 1 - len(frames)
    if not missing_count:
        return
    rows = np.flatnonzero(np.diff(frames) > 1)
    row = int(rows[0])
    first_gap = int(frames[row + 1] - frames[row]) - 1
    message = f"{counted(first_gap, 'missing frame')} ({first_gap / rate:.4g} s) "
    message += f"before line {line_numbers[row + 1]}"
    if len(rows) > 1:
        message += f", and {missing_count - first_gap} in "
        message += f"{counted(len(rows) - 1, 'other gap')}"
    message += "; markers are missing there"
    hint = "mocap fill computes positions in gaps"
    file.warn("TRC105", message, hint, int(line_numbers[row + 1]))


def _warn_irregular(
    file: CaptureFile,
    steps: TimeSteps,
    times: FloatArray,
    rate: Fraction,
    line_numbers: IntArray,
) -> None:
    """Warn that rows at irregular times are resampled (TRC106)."""
    intervals = np.diff(times)
    row = int(np.abs(intervals - steps.step).argmax()) + 1
    message = (
        f"rows are {intervals.min():.4g} to {intervals.max():.4g} s apart; resampled "
        f"to {float(rate):g} fps by linear interpolation, except across gaps"
    )
    hint = f"set the rate with {argument('source.fps')} to place rows by Frame#"
    file.warn("TRC106", message, hint, int(line_numbers[row]))


def _warn_numbers(
    file: CaptureFile, numbers: FloatArray, line_numbers: IntArray, result: str
) -> None:
    """Warn about a Frame# column that does not count frames (TRC107)."""
    with np.errstate(invalid="ignore"):
        is_number = np.isfinite(numbers)
        is_invalid = ~is_number | (np.floor(numbers) != numbers)
        is_invalid[1:] |= ~(np.diff(numbers) >= 1)
    rows = np.flatnonzero(is_invalid)
    if not len(rows):
        return
    row = int(rows[0])
    message = "Frame# is not a number"
    if is_number[row]:
        message = f"Frame# is {numbers[row]:g}"
        message += f" after {numbers[row - 1]:g}" if row else ""
    if len(rows) > 1:
        message += f", and {counted(len(rows) - 1, 'other row')} too"
    file.warn("TRC107", f"{message}; {result}", None, int(line_numbers[row]))


def _first_frame_and_time(
    file: CaptureFile,
    columns: FloatArray,
    frames: IntArray,
    line_numbers: IntArray,
    rate: Fraction,
    rounding: float,
) -> tuple[int, float | None]:
    """Return the first frame and its time [s]; the time is None if frame 1 is time 0.

    Warns if Frame# and Time disagree.
    """
    numbers, times = columns[:, 0], columns[:, 1]
    start = _start_frame(numbers[0])
    frame_by_time = times[0] * float(rate) + 1
    if _counted_frames(numbers) is None:
        _warn_numbers(file, numbers, line_numbers, "rows are placed by Time")
        return start, float(times[0])
    mismatched_rows = np.flatnonzero(numbers - numbers[0] != frames)
    if len(mismatched_rows):
        row = int(mismatched_rows[0])
        message = (
            f"frame {numbers[row]:g} is {times[row] - times[0]:.6g} s after frame "
            f"{numbers[0]:g}; at {float(rate):g} fps it would be "
            f"{numbers[0] + frames[row]:g}; rows are placed by Time"
        )
        file.warn("TRC107", message, None, int(line_numbers[row]))
    elif abs(frame_by_time - start) > STEP_TOLERANCE + 3 * rounding * float(rate):
        message = (
            f"frame {start} is at {times[0]:.6g} s; a TRC keeps that, but in a MOT "
            f"it would be {(start - 1) / float(rate):.6g} s, as frame 1 is at 0 s"
        )
        file.note("TRC107", message)
        return start, float(times[0])
    return start, None
