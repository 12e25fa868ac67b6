"""Finds the frame of each row of a recording from its time code."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, counted, excerpt, listed
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.timecode import frames_per_day, nominal_rate, parse_timecode
from animtool.formats.trajectories import CaptureFile

# Clock rates of recorders [1/s], and the app's default.
TIMECODE_RATES = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
DEFAULT_TIMECODE_RATE = 60
# Rows have a constant step if this fraction of them does.
MIN_REGULAR_FRACTION = 0.9
MAX_LABEL_STEP = 16
# Largest jitter of rows on a clock [frame]: phone clocks drift by 2e-4 per row, while
# network time stamps jitter by a frame.
MAX_CLOCK_JITTER = 0.1
# Longer gaps between two rows are not filled [s].
MAX_GAP_SECONDS = 600
# A second recording in a file begins this much earlier [s], with this many rows.
MIN_BACK_SECONDS, MIN_RECORDING_ROWS = 1.0, 24
MAX_LISTED_LINES = 12
# If more than this fraction of time codes exceed a stated rate, the rate is wrong.
MIN_ABOVE_LIMIT_FRACTION = 0.1
_TIMECODE_PATTERN = re.compile(r"(\d\d?):(\d\d):(\d\d)([:;])(\d\d\d?)(\.\d{1,9})?")


@dataclass(frozen=True, slots=True)
class RecordingFrames:
    """The frame rate of a recording, and the frame of each row."""

    label_rate: Fraction  # labels per second, exact
    step: int  # labels per frame
    row_indices: IntArray  # indices of the rows that are used, sorted by time ``(N,)``
    frames: IntArray  # frame of each used row, from 0, ascending ``(N,)``
    notices: tuple[Fault, ...] = ()  # warnings about the timecodes

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        return self.label_rate / self.step

    @property
    def count(self) -> int:
        """Number of frames, including those without a row."""
        return int(self.frames[-1]) + 1

    @property
    def dropped_frames(self) -> IntArray:
        """Indices of the frames without a row."""
        is_dropped = np.ones(self.count, np.bool_)
        is_dropped[self.frames] = False
        return np.flatnonzero(is_dropped)


def find_row_frames(
    file: CaptureFile,
    timecodes: Sequence[str],
    line_numbers: IntArray,
    label_rate: Fraction | None = None,
) -> RecordingFrames:
    """Return the frames of rows with time codes ``HH:MM:SS:FF.mmm``.

    The label rate is the one at which the seconds of the time codes end. A recorder may
    write a row every second label. If rows follow the clock, fractions of frames are
    rounded; if they jitter, the label is the frame.

    Args:
        file: The file, to which warnings are added.
        timecodes: One per row, as written.
        line_numbers: Line number of each row ``(R,)``.
        label_rate: Labels per second; None derives it.
    """
    fields = _timecode_fields(file, timecodes, line_numbers)
    is_drop_frame = any(";" in timecode for timecode in timecodes)
    if label_rate is not None:
        _check_stated_rate(file, fields, line_numbers, label_rate, is_drop_frame)
    rate = label_rate or _fit_timecode_rate(file, fields, is_drop_frame)
    label_counts, fractions = _timecode_numbers(file, timecodes, rate, line_numbers)
    labels_per_day = frames_per_day(rate, is_drop_frame=is_drop_frame)
    # Steps wrap at midnight; the shorter direction shows rows that are out of order.
    half_day = labels_per_day // 2
    label_steps = (np.diff(label_counts) + half_day) % labels_per_day - half_day
    _refuse_second_recording(file, timecodes, line_numbers, label_steps / float(rate))
    labels = np.concatenate([[0], np.cumsum(label_steps)])
    time_order = np.argsort(labels + fractions, kind="stable")
    unsorted_indices = np.flatnonzero(np.diff(time_order) < 0)
    if len(unsorted_indices):
        unsorted_lines = line_numbers[time_order[unsorted_indices + 1]].tolist()
        verbs = ("was", "has") if len(unsorted_lines) == 1 else ("were", "have")
        message = f"{counted(len(unsorted_lines), 'row')} {verbs[0]} out of time order "
        message += f"and {verbs[1]} been sorted"
        hint = "check that the file is not two takes joined together"
        file.warn("LLF104", message, hint, *unsorted_lines[:MAX_LISTED_LINES])
    labels, fractions = (
        labels[time_order] - labels[time_order[0]],
        fractions[time_order],
    )
    row_steps = np.diff(labels)
    if len(row_steps) and (longest_gap := row_steps.max()) > MAX_GAP_SECONDS * rate:
        row = time_order[int(row_steps.argmax()) + 1]
        message = f"{longest_gap / float(rate):.6g} s without a row before "
        message += timecodes[row]
        hint = "split the recording there, or repair the time code"
        raise file.error("LLF006", message, hint, int(line_numbers[row]))
    step, frames = _frames_of_labels(labels, fractions)
    is_first = np.concatenate([[True], np.diff(frames) > 0])
    repeated_lines = sorted(line_numbers[time_order[~is_first]].tolist())
    if repeated_lines:
        is_single = len(repeated_lines) == 1
        message = f"{counted(len(repeated_lines), 'row')} "
        message += "repeats" if is_single else "repeat"
        message += " a frame that already has a row, and "
        message += "was skipped (line " if is_single else "were skipped (lines "
        message += f"{listed(repeated_lines, MAX_LISTED_LINES)})"
        hint = "delete them, or split the file if it holds two faces or takes"
        file.warn("LLF105", message, hint, *repeated_lines[:MAX_LISTED_LINES])
    return RecordingFrames(rate, step, time_order[is_first], frames[is_first])


def _refuse_second_recording(
    file: CaptureFile,
    timecodes: Sequence[str],
    line_numbers: IntArray,
    steps: FloatArray,
) -> None:
    """Raise if times go back and on from there, as in pasted recordings (LLF006).

    ``steps`` are those between the times of the rows ``(R - 1,)`` [s]. Rows that are
    out of order go back too, but then jump ahead again.
    """
    back_steps = np.flatnonzero(steps < 0)
    ends = np.append(back_steps, len(steps))[1:]
    for start, end in zip(back_steps.tolist(), ends.tolist(), strict=True):
        run = steps[start + 1 : end]
        is_long = len(run) >= MIN_RECORDING_ROWS and -steps[start] > MIN_BACK_SECONDS
        if is_long and run.max() < -steps[start] / 2:
            message = f"the time goes back from {timecodes[start]} to "
            message += f"{timecodes[start + 1]}: a second recording begins here"
            hint = "split the file at this line"
            raise file.error("LLF006", message, hint, int(line_numbers[start + 1]))


def _timecode_fields(
    file: CaptureFile, timecodes: Sequence[str], line_numbers: IntArray
) -> IntArray:
    """Return hours, minutes, seconds and frames of time codes ``(R, 4)``."""
    matches = [_TIMECODE_PATTERN.fullmatch(timecode) for timecode in timecodes]
    rows = zip(timecodes, matches, line_numbers.tolist(), strict=True)
    faults = [
        _timecode_fault(
            file,
            f"{excerpt(timecode)} is not a time code such as 12:00:00:00.000",
            line,
        )
        for timecode, match, line in rows
        if match is None
    ]
    if faults:
        raise FormatError(faults[:100])
    return np.array([[int(m[i]) for i in (1, 2, 3, 5)] for m in matches if m], np.int64)


def _timecode_fault(
    file: CaptureFile, message: str, line: int, hint: str | None = None
) -> Fault:
    return Fault("LLF005", message, file.path, (line,), hint, column=1)


def _check_stated_rate(
    file: CaptureFile,
    fields: IntArray,
    line_numbers: IntArray,
    label_rate: Fraction,
    is_drop_frame: bool,
) -> None:
    """Refuse a stated rate that many time codes exceed (LLF005)."""
    try:
        label_count = nominal_rate(label_rate)
    except ValueError:
        return  # reported where labels are counted
    is_above_limit = fields[:, 3] >= label_count
    if is_above_limit.sum() < max(2, MIN_ABOVE_LIMIT_FRACTION * len(fields)):
        return
    message = f"its time codes count frames up to {fields[:, 3].max()}; the largest is "
    message += f"{label_count - 1} at {rate_label(label_rate)}"
    fitting_rate = _fit_timecode_rate(CaptureFile(file.path), fields, is_drop_frame)
    hint = f"set {argument('source.fps', fitting_rate)}, or leave it out: the time "
    hint += "codes show it"
    line = int(line_numbers[int(is_above_limit.argmax())])
    raise FormatError(_timecode_fault(file, message, line, hint))


def _fit_timecode_rate(
    file: CaptureFile, fields: IntArray, is_drop_frame: bool
) -> Fraction:
    """Return the label rate [1/s] that fits the time codes best."""
    max_label = int(fields[:, 3].max())
    seconds = fields[:, :3] @ [3600, 60, 1]
    candidates = [n for n in TIMECODE_RATES if n > max_label] or [max_label + 1]
    if is_drop_frame:
        candidates = [n for n in (30, 60) if n > max_label] or [60]
        return Fraction(candidates[0] * 1000, 1001)
    end_indices = np.flatnonzero(np.diff(seconds) == 1)
    if len(candidates) > 1 and not len(end_indices):
        is_default = DEFAULT_TIMECODE_RATE in candidates
        rate = DEFAULT_TIMECODE_RATE if is_default else candidates[0]
        message = f"the time code never reaches another second, so {rate} frames per "
        message += "second are assumed, the default of the app"
        hint = f"set the rate of its time code with {argument('source.fps')}"
        file.note("LLF107", message, hint)
        return Fraction(rate)
    if len(candidates) == 1:
        return Fraction(candidates[0])
    steps = np.diff(fields[:, 3])[np.diff(seconds) == 0]
    typical_step = np.median(steps[steps > 0]) if (steps > 0).any() else 1
    # A step across the end of a second equals those within it.
    wrap_steps = fields[end_indices + 1, 3] - fields[end_indices, 3]
    deviations = [np.median(np.abs(wrap_steps + n - typical_step)) for n in candidates]
    return Fraction(candidates[int(np.argmin(deviations))])


def _timecode_numbers(
    file: CaptureFile, timecodes: Sequence[str], rate: Fraction, line_numbers: IntArray
) -> tuple[IntArray, FloatArray]:
    """Return the frame number since midnight and the frame fraction of each label."""
    label_counts, fractions, faults = [], [], []
    for timecode, line in zip(timecodes, line_numbers.tolist(), strict=True):
        padded_timecode = timecode if timecode[1] != ":" else f"0{timecode}"
        try:
            frame = parse_timecode(padded_timecode, rate)
        except ValueError as error:
            message = f"{error} at {rate_label(rate)}"
            faults.append(_timecode_fault(file, message, line))
            continue
        label_counts.append(frame.numerator // frame.denominator)
        fractions.append(float(frame - label_counts[-1]))
    if faults:
        raise FormatError(faults[:100])
    return np.array(label_counts, np.int64), np.array(fractions)


def _frames_of_labels(labels: IntArray, fractions: FloatArray) -> tuple[int, IntArray]:
    """Return how many labels a frame advances, and each row's frame from 0 ``(R,)``."""
    label_steps = np.diff(labels)
    positive_steps = label_steps[label_steps > 0]
    if not len(positive_steps):
        return 1, np.zeros(len(labels), np.int64)
    exact_steps = label_steps + np.diff(fractions)
    step = 1
    for candidate in range(min(MAX_LABEL_STEP, int(np.median(positive_steps))), 1, -1):
        regular_fraction = max(
            (positive_steps % candidate == 0).mean(),
            _is_step_multiple(exact_steps, candidate).mean(),
        )
        if regular_fraction >= MIN_REGULAR_FRACTION:
            step = candidate
            break
    is_regular = _is_step_multiple(exact_steps, step).mean() >= MIN_REGULAR_FRACTION
    if is_regular and np.ptp(fractions) > 0:
        step_counts = np.round(exact_steps / step)
        return step, np.concatenate([[0], np.cumsum(step_counts)]).astype(np.int64)
    # The label is the frame, whatever fraction follows it.
    return step, np.round(labels / step).astype(np.int64)


def _is_step_multiple(exact_steps: FloatArray, step: int) -> BoolArray:
    """Return whether each row is a whole number of steps after the previous row."""
    step_counts = exact_steps / step
    return np.asarray(
        np.abs(step_counts - np.round(step_counts)) * step <= MAX_CLOCK_JITTER
    )
