"""Frame numbers of a recording's rows, from their timecodes."""

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
from animtool.core.timecode import day_frames, parse_timecode

# What clocks of recorders count, and the one that the app starts with.
CLOCKS = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
DEFAULT_CLOCK = 60
# Rows have a constant step if this fraction of them does.
REGULAR_FRACTION = 0.9
MAX_STEP = 16
# Parts of a frame by which rows that follow a clock miss its beat: that of phones is
# off by 2e-4 a row, while time stamps of a network jitter by a frame.
STEADY = 0.1
# Longer gaps between two rows are not filled [s].
MAX_GAP_SECONDS = 600
MAX_NAMED = 12
_LABEL = re.compile(r"(\d\d?):(\d\d):(\d\d)([:;])(\d\d\d?)(\.\d{1,9})?")


@dataclass(frozen=True, slots=True)
class TimecodeFrames:
    """Frame rate, and the frame of each row.

    Attributes:
        clock: Labels a second, exact.
        step: Labels from one frame to the next.
        rows: The rows that count, in the order of time ``(N,)``.
        frames: Which frame each of them is, from 0, ascending ``(N,)``.
        notices: Warnings about the timecodes.
    """

    clock: Fraction
    step: int
    rows: IntArray
    frames: IntArray
    notices: tuple[Fault, ...] = ()

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
        """Frames without a row."""
        missing = np.ones(self.count, np.bool_)
        missing[self.frames] = False
        return np.flatnonzero(missing)


def row_frames(
    labels: Sequence[str],
    lines: IntArray,
    path: str,
    clock: Fraction | None = None,
) -> TimecodeFrames:
    """Return the frames of rows with timecodes ``HH:MM:SS:FF.mmm``.

    The clock is the one whose seconds end where those of the labels do. A recorder may
    write a row every second label. Where rows keep the beat of the clock, parts of
    frames are rounded; where they jitter, a label is the frame.

    Args:
        labels: One a row, as written.
        lines: Line of each in the file.
        path: The file, for messages.
        clock: Labels a second; None finds it.

    Raises:
        FormatError: One is no time code (LLF005), or two are very far apart (LLF006).
    """
    fields = _fields(labels, lines, path)
    notices: list[Fault] = []
    drop = any(";" in label for label in labels)
    rate = clock if clock is not None else _clock(fields, drop, path, notices)
    counts, parts = _counted(labels, rate, lines, path)
    day = day_frames(rate, drop=drop)
    # Steps wrap at midnight; the shorter direction shows rows that are out of order.
    steps = (np.diff(counts) + day // 2) % day - day // 2
    times = np.concatenate([[0], np.cumsum(steps)])
    order = np.argsort(times + parts, kind="stable")
    notices += _unsorted(order, lines, path)
    times, parts = times[order] - times[order[0]], parts[order]
    steps_ = np.diff(times)
    if len(steps_) and (worst := steps_.max()) > MAX_GAP_SECONDS * rate:
        at = int(steps_.argmax())
        message = (
            f"{worst / float(rate):.6g} s without a row before {labels[order[at + 1]]}"
        )
        hint = "split the recording there, or repair the time code"
        line = (int(lines[order[at + 1]]),)
        raise FormatError(Fault("LLF006", message, path, line, hint))
    step, frames = _frames(times, parts)
    first = np.concatenate([[True], np.diff(frames) > 0])
    notices += _repeated(first, order, lines, path)
    return TimecodeFrames(rate, step, order[first], frames[first], tuple(notices))


def _fields(labels: Sequence[str], lines: IntArray, path: str) -> IntArray:
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


def _clock(fields: IntArray, drop: bool, path: str, notices: list[Fault]) -> Fraction:
    """Return the timecode rate [1/s] that fits the labels best."""
    most = int(fields[:, 3].max())
    seconds = fields[:, :3] @ [3600, 60, 1]
    fitting = [n for n in CLOCKS if n > most] or [most + 1]
    if drop:
        fitting = [n for n in (30, 60) if n > most] or [60]
        return Fraction(fitting[0] * 1000, 1001)
    seconds_ends = np.flatnonzero(np.diff(seconds) == 1)
    if len(fitting) > 1 and not len(seconds_ends):
        rate = DEFAULT_CLOCK if DEFAULT_CLOCK in fitting else fitting[0]
        message = (
            f"the time code never reaches another second, so {rate} frames per "
            "second are assumed, the default of the app"
        )
        hint = f"set the rate of its time code with {argument('source.fps')}"
        notices.append(Fault("LLF107", message, path, (), hint, Severity.NOTE))
        return Fraction(rate)
    if len(fitting) == 1:
        return Fraction(fitting[0])
    inside = np.diff(fields[:, 3])[np.diff(seconds) == 0]
    typical = np.median(inside[inside > 0]) if (inside > 0).any() else 1
    # The step from a second's last label to the next second's first is as others.
    over = fields[seconds_ends + 1, 3] - fields[seconds_ends, 3]
    misses = [np.median(np.abs(over + n - typical)) for n in fitting]
    return Fraction(fitting[int(np.argmin(misses))])


def _counted(
    labels: Sequence[str], rate: Fraction, lines: IntArray, path: str
) -> tuple[IntArray, FloatArray]:
    """Return labels counted from midnight, and fractions of a frame."""
    counts, parts, faults = [], [], []
    for label, line in zip(labels, lines.tolist(), strict=True):
        text = label if label[1] != ":" else f"0{label}"
        try:
            exact = parse_timecode(text, rate)
        except ValueError as error:
            message = f"{error} at {rate_label(rate)}"
            faults.append(Fault("LLF005", message, path, (line,), column=1))
            continue
        counts.append(exact.numerator // exact.denominator)
        parts.append(float(exact - counts[-1]))
    if faults:
        raise FormatError(faults[:100])
    return np.array(counts, np.int64), np.array(parts)


def _frames(times: IntArray, parts: FloatArray) -> tuple[int, IntArray]:
    """Return labels per frame, and the frame of each row, from 0."""
    steps = np.diff(times)
    moving = steps[steps > 0]
    if not len(moving):
        return 1, np.zeros(len(times), np.int64)
    exact = steps + np.diff(parts)
    step = 1
    for every in range(min(MAX_STEP, int(np.median(moving))), 1, -1):
        regular = max((moving % every == 0).mean(), _on_beat(exact, every).mean())
        if regular >= REGULAR_FRACTION:
            step = every
            break
    if _on_beat(exact, step).mean() >= REGULAR_FRACTION and np.ptp(parts) > 0:
        beats = np.round(exact / step)
    else:
        # The label decides, whatever fraction of a frame follows it.
        return step, np.round(times / step).astype(np.int64)
    return step, np.concatenate([[0], np.cumsum(beats)]).astype(np.int64)


def _on_beat(exact: FloatArray, step: int) -> BoolArray:
    """Return which rows are an integer number of steps after the previous one."""
    beats = exact / step
    return np.asarray(np.abs(beats - np.round(beats)) * step <= STEADY)


def _unsorted(order: IntArray, lines: IntArray, path: str) -> list[Fault]:
    moved = np.flatnonzero(np.diff(order) < 0)
    if not len(moved):
        return []
    late = lines[order[moved + 1]].tolist()
    message = f"{counted(len(late), 'row')} not in order of time: sorted"
    notice = Fault(
        "LLF104", message, path, tuple(late[:MAX_NAMED]), None, Severity.WARNING
    )
    return [notice]


def _repeated(
    first: BoolArray,
    order: IntArray,
    lines: IntArray,
    path: str,
) -> list[Fault]:
    again = sorted(lines[order[~first]].tolist())
    if not again:
        return []
    message = (
        f"{counted(len(again), 'row')} for a frame that already has one: skipped, "
        f"lines {listed(again, MAX_NAMED)}"
    )
    return [
        Fault("LLF105", message, path, tuple(again[:MAX_NAMED]), None, Severity.WARNING)
    ]
