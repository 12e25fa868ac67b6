"""Finds the frame of each row of a recording from its timecode."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.timecode import count_rate, day_frames, parse_timecode

# Clock rates of recorders [1/s], and the app's default.
TIMECODE_RATES = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
DEFAULT_TIMECODE_RATE = 60
# Rows have a constant step if this fraction of them does.
REGULAR_FRACTION = 0.9
MAX_STEP = 16
# Largest jitter of rows on a clock [frame]: phone clocks drift by 2e-4 per row, while
# network time stamps jitter by a frame.
MAX_CLOCK_JITTER = 0.1
# Longer gaps between two rows are not filled [s].
MAX_GAP_SECONDS = 600
MAX_LISTED_LINES = 12
# If more than this fraction of labels exceed a stated rate, the rate is wrong.
MIN_BEYOND_FRACTION = 0.1
_LABEL = re.compile(r"(\d\d?):(\d\d):(\d\d)([:;])(\d\d\d?)(\.\d{1,9})?")


@dataclass(frozen=True, slots=True)
class TimecodeFrames:
    """Frame rate, and the frame of each row."""

    clock: Fraction  # labels per second, exact
    step: int  # labels per frame
    rows: IntArray  # indices of the rows that are used, sorted by time ``(N,)``
    frames: IntArray  # frame of each used row, from 0, ascending ``(N,)``
    notices: tuple[Fault, ...] = ()  # warnings about the timecodes

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        return self.clock / self.step

    @property
    def count(self) -> int:
        """Count of frames, including those without a row."""
        return int(self.frames[-1]) + 1

    @property
    def dropped(self) -> IntArray:
        """Indices of the frames without a row."""
        is_dropped = np.ones(self.count, np.bool_)
        is_dropped[self.frames] = False
        return np.flatnonzero(is_dropped)


def row_frames(
    labels: Sequence[str], lines: IntArray, path: str, clock: Fraction | None = None
) -> TimecodeFrames:
    """Return the frames of rows with timecodes ``HH:MM:SS:FF.mmm``.

    The clock is the one whose seconds end with those of the labels. A recorder may
    write a row every second label. If rows follow the clock, fractions of frames are
    rounded; if they jitter, the label is the frame.

    Args:
        labels: One per row, as written.
        lines: Line number of each row.
        path: The file, for messages.
        clock: Labels per second; None derives it.
    """
    fields = _label_fields(labels, lines, path)
    notices: list[Fault] = []
    is_drop_frame = any(";" in label for label in labels)
    if clock is not None:
        _check_stated_rate(fields, lines, path, clock, is_drop_frame)
    rate = clock or _fit_timecode_rate(fields, is_drop_frame, path, notices)
    label_counts, fractions = _label_numbers(labels, rate, lines, path)
    labels_per_day = day_frames(rate, drop=is_drop_frame)
    # Steps wrap at midnight; the shorter direction shows rows that are out of order.
    steps = (
        np.diff(label_counts) + labels_per_day // 2
    ) % labels_per_day - labels_per_day // 2
    times = np.concatenate([[0], np.cumsum(steps)])
    order = np.argsort(times + fractions, kind="stable")
    notices += _unsorted_notice(order, lines, path)
    times, fractions = times[order] - times[order[0]], fractions[order]
    time_steps = np.diff(times)
    if len(time_steps) and (longest_gap := time_steps.max()) > MAX_GAP_SECONDS * rate:
        gap_index = int(time_steps.argmax())
        message = f"{longest_gap / float(rate):.6g} s without a row before "
        message += f"{labels[order[gap_index + 1]]}"
        hint = "split the recording there, or repair the time code"
        line = (int(lines[order[gap_index + 1]]),)
        raise FormatError(Fault("LLF006", message, path, line, hint))
    step, frames = _frames_of_labels(times, fractions)
    is_first = np.concatenate([[True], np.diff(frames) > 0])
    notices += _repeated_notice(is_first, order, lines, path)
    return TimecodeFrames(rate, step, order[is_first], frames[is_first], tuple(notices))


def _label_fields(labels: Sequence[str], lines: IntArray, path: str) -> IntArray:
    """Return hours, minutes, seconds and frames of labels ``(R, 4)``."""
    matches = [_LABEL.fullmatch(label) for label in labels]
    faults = [
        Fault(
            "LLF005",
            f"{excerpt(label)} is not a time code such as 12:00:00:00.000",
            path,
            (int(line),),
            column=1,
        )
        for label, match, line in zip(labels, matches, lines.tolist(), strict=True)
        if match is None
    ]
    if faults:
        raise FormatError(faults[:100])
    return np.array([[int(m[i]) for i in (1, 2, 3, 5)] for m in matches if m], np.int64)


def _check_stated_rate(
    fields: IntArray, lines: IntArray, path: str, clock: Fraction, is_drop_frame: bool
) -> None:
    """Refuse a stated rate that many labels exceed (LLF005)."""
    try:
        limit = count_rate(clock)
    except ValueError:
        return  # reported where labels are counted
    is_beyond = fields[:, 3] >= limit
    if is_beyond.sum() < max(2, MIN_BEYOND_FRACTION * len(fields)):
        return
    message = f"its time codes count frames up to {fields[:, 3].max()}; the largest is "
    message += f"{limit - 1} at {rate_label(clock)}"
    fitting_rate = _fit_timecode_rate(fields, is_drop_frame, path, [])
    hint = f"set {argument('source.fps', fitting_rate)}, or leave it out: the time "
    hint += "codes show it"
    line = (int(lines[int(is_beyond.argmax())]),)
    raise FormatError(Fault("LLF005", message, path, line, hint, column=1))


def _fit_timecode_rate(
    fields: IntArray, is_drop_frame: bool, path: str, notices: list[Fault]
) -> Fraction:
    """Return the timecode rate [1/s] that fits the labels best."""
    max_label = int(fields[:, 3].max())
    seconds = fields[:, :3] @ [3600, 60, 1]
    candidates = [n for n in TIMECODE_RATES if n > max_label] or [max_label + 1]
    if is_drop_frame:
        candidates = [n for n in (30, 60) if n > max_label] or [60]
        return Fraction(candidates[0] * 1000, 1001)
    seconds_ends = np.flatnonzero(np.diff(seconds) == 1)
    if len(candidates) > 1 and not len(seconds_ends):
        rate = candidates[0]
        if DEFAULT_TIMECODE_RATE in candidates:
            rate = DEFAULT_TIMECODE_RATE
        message = f"the time code never reaches another second, so {rate} frames per "
        message += "second are assumed, the default of the app"
        hint = f"set the rate of its time code with {argument('source.fps')}"
        notices.append(Fault("LLF107", message, path, (), hint, Severity.NOTE))
        return Fraction(rate)
    if len(candidates) == 1:
        return Fraction(candidates[0])
    steps = np.diff(fields[:, 3])[np.diff(seconds) == 0]
    typical_step = np.median(steps[steps > 0]) if (steps > 0).any() else 1
    # A step across the end of a second equals those within it.
    wrap_steps = fields[seconds_ends + 1, 3] - fields[seconds_ends, 3]
    misses = [np.median(np.abs(wrap_steps + n - typical_step)) for n in candidates]
    return Fraction(candidates[int(np.argmin(misses))])


def _label_numbers(
    labels: Sequence[str], rate: Fraction, lines: IntArray, path: str
) -> tuple[IntArray, FloatArray]:
    """Return the frame number since midnight and the frame fraction of each label."""
    counts, fractions, faults = [], [], []
    for label, line in zip(labels, lines.tolist(), strict=True):
        text = label if label[1] != ":" else f"0{label}"
        try:
            exact = parse_timecode(text, rate)
        except ValueError as error:
            message = f"{error} at {rate_label(rate)}"
            faults.append(Fault("LLF005", message, path, (line,), column=1))
            continue
        counts.append(exact.numerator // exact.denominator)
        fractions.append(float(exact - counts[-1]))
    if faults:
        raise FormatError(faults[:100])
    return np.array(counts, np.int64), np.array(fractions)


def _frames_of_labels(times: IntArray, fractions: FloatArray) -> tuple[int, IntArray]:
    """Return labels per frame, and the frame of each row, from 0."""
    steps = np.diff(times)
    positive_steps = steps[steps > 0]
    if not len(positive_steps):
        return 1, np.zeros(len(times), np.int64)
    exact = steps + np.diff(fractions)
    step = 1
    for interval in range(min(MAX_STEP, int(np.median(positive_steps))), 1, -1):
        regular = max(
            (positive_steps % interval == 0).mean(),
            _is_step_multiple(exact, interval).mean(),
        )
        if regular >= REGULAR_FRACTION:
            step = interval
            break
    is_regular = _is_step_multiple(exact, step).mean() >= REGULAR_FRACTION
    if is_regular and np.ptp(fractions) > 0:
        step_counts = np.round(exact / step)
        return step, np.concatenate([[0], np.cumsum(step_counts)]).astype(np.int64)
    # The label is the frame, whatever fraction follows it.
    return step, np.round(times / step).astype(np.int64)


def _is_step_multiple(exact: FloatArray, step: int) -> BoolArray:
    """Return which rows are a whole number of steps after the previous row."""
    step_counts = exact / step
    return np.asarray(
        np.abs(step_counts - np.round(step_counts)) * step <= MAX_CLOCK_JITTER
    )


def _unsorted_notice(order: IntArray, lines: IntArray, path: str) -> list[Fault]:
    out_of_order = np.flatnonzero(np.diff(order) < 0)
    if not len(out_of_order):
        return []
    late_lines = lines[order[out_of_order + 1]].tolist()
    message = f"{counted(len(late_lines), 'row')} not in order of time: sorted"
    rows = tuple(late_lines[:MAX_LISTED_LINES])
    return [Fault("LLF104", message, path, rows, None, Severity.WARNING)]


def _repeated_notice(
    is_first: BoolArray, order: IntArray, lines: IntArray, path: str
) -> list[Fault]:
    repeats = sorted(lines[order[~is_first]].tolist())
    if not repeats:
        return []
    message = f"{counted(len(repeats), 'row')} for a frame that already has one: "
    message += f"skipped, lines {listed(repeats, MAX_LISTED_LINES)}"
    rows = tuple(repeats[:MAX_LISTED_LINES])
    return [Fault("LLF105", message, path, rows, None, Severity.WARNING)]
