"""When the frames of a take are, exactly, and SMPTE time codes of them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from numbers import Rational

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.rates import rate_label

# Frames a second that are labelled, minutes but every tenth leaving so many out.
_DROPPED = {Fraction(30000, 1001): 2, Fraction(60000, 1001): 4}
_LABEL = re.compile(r"(\d\d):(\d\d):(\d\d)([:;])(\d\d+)(\.\d{1,18})?")


def count_rate(rate: Fraction) -> int:
    """Return how many labels a second has: the rate, or what is 1001/1000 of it.

    >>> count_rate(Fraction(24000, 1001)), count_rate(Fraction(25))
    (24, 25)
    """
    for labels in (rate, rate * Fraction(1001, 1000)):
        if labels.denominator == 1 and 1 <= labels <= 960:
            return int(labels)
    message = f"time codes do not count {float(rate):g} frames a second"
    raise ValueError(f"{message}: a whole number, or 1000/1001 of one, is needed")


def day_frames(rate: Fraction, *, drop: bool = False) -> int:
    """Return the labels from one midnight to the next.

    >>> day_frames(Fraction(30000, 1001), drop=True)
    2589408
    """
    return 24 * 3600 * count_rate(rate) - (24 * 54 * _dropped(rate) if drop else 0)


def parse_timecode(text: str, rate: Fraction) -> Fraction:
    """Return the frames from midnight to a label, ``HH:MM:SS:FF`` or ``HH:MM:SS;FF``.

    A semicolon is drop-frame: all minutes but each tenth begin with label 02, at 59.94
    with 04. ``FF.25`` is a quarter of a frame behind FF. What is no label of the rate,
    or one that drop-frame leaves out, is a `ValueError`.

    >>> parse_timecode("01:00:00;00", Fraction(30000, 1001))
    Fraction(107892, 1)
    """
    match = _LABEL.fullmatch(text.strip())
    if match is None:
        message = f"{text!r} is no time code such as 01:00:00:00 or 01:00:00;02"
        raise ValueError(message)
    count, drop = count_rate(rate), match[4] == ";"
    hours, minutes, seconds, frames = (int(match[i]) for i in (1, 2, 3, 5))
    limits = (("hour", hours, 24), ("minute", minutes, 60), ("second", seconds, 60))
    for what, value, limit in (*limits, ("frame", frames, count)):
        if value >= limit:
            message = f"{text!r} has {what} {value:02d}; the last is {limit - 1:02d}"
            raise ValueError(message)
    left_out = _dropped(rate) if drop else 0
    if minutes % 10 and not seconds and frames < left_out:
        first = f"{hours:02d}:{minutes:02d}:00;{left_out:02d}"
        message = f"drop-frame has no {text!r}: this minute begins with {first}"
        raise ValueError(message)
    whole = 60 * hours + minutes
    labels = count * (60 * whole + seconds) + frames
    return labels - left_out * (whole - whole // 10) + Fraction(match[6] or 0)


def seconds_between(
    first: str, first_rate: Fraction, other: str, other_rate: Fraction
) -> Fraction:
    """Return by how much one label is later than another, over midnight too [s].

    Each is counted from midnight at its own rate; of two ways around the clock it is
    the shorter.

    >>> seconds_between("23:59:59:00", Fraction(25), "00:00:01:05", Fraction(25))
    Fraction(11, 5)
    """
    apart = parse_timecode(other, other_rate) / other_rate
    apart -= parse_timecode(first, first_rate) / first_rate
    day = day_frames(first_rate, drop=";" in first) / first_rate
    return (apart + day / 2) % day - day / 2


def _dropped(rate: Fraction) -> int:
    """Return how many labels a minute of a drop-frame rate leaves out."""
    if rate not in _DROPPED:
        message = f"drop-frame (;) is not for {float(rate):g} frames a second"
        raise ValueError(f"{message}, but for 30000/1001 and 60000/1001")
    return _DROPPED[rate]


# Days of animation: rather a number that is mistyped.
MAX_FRAMES = 10_000_000
# Time codes are doubles of fractions such as 1001 + 1/5: this finds them again.
LARGEST_STEP_DENOMINATOR = 10_000


def time_codes(start: Fraction, step: Fraction, count: int) -> FloatArray:
    """Return start + i·step for i < count ``(count,)``, each rounded once.

    >>> time_codes(Fraction(1001), Fraction(1, 5), 3).tolist()
    [1001.0, 1001.2, 1001.4]
    """
    common = start.denominator * step.denominator
    first = start.numerator * step.denominator
    each = step.numerator * start.denominator
    # Integers this size are exact in float64, so one division rounds correctly.
    if max(abs(first), abs(first + each * count), common) < 2**53:
        return (first + each * np.arange(count, dtype=np.int64)) / float(common)
    return np.array([float(start + i * step) for i in range(count)])


def time_fraction(time: float) -> Fraction:
    """Return the fraction that a time code of a file stands for.

    >>> time_fraction(1001.2)
    Fraction(5006, 5)
    """
    return Fraction(time).limit_denominator(LARGEST_STEP_DENOMINATOR)


@dataclass(frozen=True, slots=True)
class Clock:
    """When the frames of a take are.

    Attributes:
        fps: Time codes a second.
        start: Time code of the first frame.
        step: Time codes from one frame to the next.
        count: Number of frames.

    Raises:
        OptionError: One is a float, or fps or step are not positive (TAKE003).

    >>> Clock(Fraction(30000, 1001), Fraction(1), Fraction(1), 5).rate
    Fraction(30000, 1001)
    """

    fps: Fraction
    start: Fraction
    step: Fraction
    count: int

    def __post_init__(self) -> None:
        """Check that times are exact; whole numbers become fractions."""
        faults = []
        for name in ("fps", "start", "step"):
            value = getattr(self, name)
            if not isinstance(value, Rational):
                message = f"{name} is {value!r}, which is not exact"
                faults.append(Fault("TAKE003", message, hint="write a Fraction"))
                continue
            object.__setattr__(self, name, Fraction(value))
            if value <= 0 and name != "start":
                message = f"{name} is {value}; it must be positive"
                faults.append(Fault("TAKE003", message))
        if faults:
            raise OptionError(faults)

    @property
    def times(self) -> FloatArray:
        """Time code of every frame ``(F,)``."""
        return time_codes(self.start, self.step, self.count)

    @property
    def rate(self) -> Fraction:
        """Frames a second."""
        return self.fps / self.step

    @property
    def duration(self) -> Fraction:
        """From the first frame to the last [s]."""
        return self.step * max(0, self.count - 1) / self.fps

    @property
    def span(self) -> FrameSpan:
        """First frame, last frame and rate."""
        last = self.start + self.step * max(0, self.count - 1)
        return FrameSpan(self.start, last, self.fps)


@dataclass(frozen=True, slots=True)
class FrameSpan:
    """First and last frame, as reports print them."""

    first: Fraction  # time code of the first frame
    last: Fraction  # time code of the last frame
    fps: Fraction  # time codes a second

    def __str__(self) -> str:
        """Return the span as people read it.

        >>> str(FrameSpan(Fraction(1001), Fraction(2017, 2), Fraction(24)))
        'frames 1001 to 1008.5 at 24 fps'
        """
        ends = dict.fromkeys(map(frame_label, (self.first, self.last)))
        word = "frames" if len(ends) > 1 else "frame"
        return f"{word} {' to '.join(ends)} at {rate_label(self.fps)}"


def span_label(first: Fraction | float, last: Fraction | float) -> str:
    """Return the first and the last of a range of time codes.

    >>> span_label(1001.0, 1024.0)
    '1001 to 1024'
    """
    return f"{frame_label(first)} to {frame_label(last)}"


def frame_label(frame: Fraction | float) -> str:
    """Return a time code as people read it: all digits of the frame, no exponent.

    >>> frame_label(Fraction(1001)), frame_label(Fraction(5, 3)), frame_label(2073600.5)
    ('1001', '1.66667', '2073600.5')
    """
    if not math.isfinite(frame):
        return f"{frame:g}"
    frame = Fraction(frame)
    if frame.denominator == 1:
        return str(frame)
    digits = 5 + len(str(int(abs(frame))))
    return f"{float(frame):.{digits}g}"
