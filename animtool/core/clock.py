"""Exact frame times of a take."""

from __future__ import annotations

import math
from fractions import Fraction
from numbers import Rational
from typing import TYPE_CHECKING

from animtool.core.errors import Fault, OptionError
from animtool.core.rates import rate_from_float, rate_label
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.core.array_types import FloatArray

# Days of animation; larger numbers are probably mistyped.
MAX_FRAME_COUNT = 10_000_000
# Time codes are float64 values of fractions such as 1001 + 1/5; fractions up to this
# denominator are recovered.
MAX_STEP_DENOMINATOR = 10_000


# Rates have smaller denominators, or some that are no powers of 2.
MAX_BINARY_FRACTION = 2**30


def time_codes(start: Fraction, step: Fraction, count: int) -> FloatArray:
    """Return start + i·step for i < count ``(count,)``, each rounded once.

    >>> time_codes(Fraction(1001), Fraction(1, 5), 3).tolist()
    [1001.0, 1001.2, 1001.4]
    """
    import numpy as np

    denominator = start.denominator * step.denominator
    first_numerator = start.numerator * step.denominator
    step_numerator = step.numerator * start.denominator
    # Integers of this size are exact in float64, so that one division rounds correctly.
    last_numerator = first_numerator + step_numerator * count
    if max(abs(first_numerator), abs(last_numerator), denominator) < 2**53:
        numerators = first_numerator + step_numerator * np.arange(count, dtype=np.int64)
        return numerators / float(denominator)
    return np.array([float(start + i * step) for i in range(count)])


def _is_float(number: Rational) -> bool:
    """Return whether a fraction is that of a binary float, such as Fraction(23.976)."""
    denominator = int(number.denominator)
    return denominator > MAX_BINARY_FRACTION and denominator.bit_count() == 1


def time_fraction(time: float) -> Fraction:
    """Return a time code of a file as an exact fraction.

    >>> time_fraction(1001.2)
    Fraction(5006, 5)
    """
    return Fraction(time).limit_denominator(MAX_STEP_DENOMINATOR)


@dataclass(frozen=True, slots=True)
class Clock:
    """Frame times of a take.

    Attributes:
        fps: Time codes per second.
        start: Time code of the first frame.
        step: Time codes per frame.
        count: Number of frames.

    Raises:
        OptionError: A value is a float, or fps or step are not positive (TAKE003).

    >>> Clock(Fraction(30000, 1001), Fraction(1), Fraction(1), 5).rate
    Fraction(30000, 1001)
    """

    fps: Fraction
    start: Fraction
    step: Fraction
    count: int

    def __post_init__(self) -> None:
        """Check that the times are exact, and convert integers to fractions."""
        faults = []
        for name in ("fps", "start", "step"):
            value = getattr(self, name)
            is_exact = isinstance(value, Rational)
            # Starts and steps may be those of a file's floats.
            if not is_exact or (name == "fps" and _is_float(value)):
                message = f"{name} is {value!r}, which is not exact"
                hint = "write a Fraction"
                is_number = isinstance(value, float | Fraction)
                if not is_number and not is_exact:
                    message = f"{name} is {value!r}, which is not a number"
                    hint = "write a whole number or a Fraction"
                if name == "fps" and is_number and 0 < value < math.inf:
                    hint = f"write {rate_from_float(float(value))!r}"
                faults.append(Fault("TAKE003", message, hint=hint))
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
        """Frames per second."""
        return self.fps / self.step

    @property
    def duration(self) -> Fraction:
        """Time from the first frame to the last [s]."""
        return self.step * max(0, self.count - 1) / self.fps

    @property
    def last(self) -> Fraction:
        """Time code of the last frame."""
        return self.start + self.step * max(0, self.count - 1)

    @property
    def span(self) -> FrameSpan:
        """First and last time code, with the time codes per second."""
        return FrameSpan(self.start, self.last, self.fps)


@dataclass(frozen=True, slots=True)
class FrameSpan:
    """First and last frame, formatted for reports."""

    first: Fraction  # time code of the first frame
    last: Fraction  # time code of the last frame
    fps: Fraction  # time codes per second

    def __str__(self) -> str:
        """Return the frames and their rate as text.

        >>> str(FrameSpan(Fraction(1001), Fraction(2017, 2), Fraction(24)))
        'frames 1001 to 1008.5 at 24 fps'
        """
        return f"{self.frames_text} at {rate_label(self.fps)}"

    @property
    def frames_text(self) -> str:
        """Range of time codes as text: ``frames 1 to 10``, or ``frame 1`` for one."""
        labels = dict.fromkeys(map(frame_label, (self.first, self.last)))
        return f"{'frames' if len(labels) > 1 else 'frame'} {' to '.join(labels)}"


def span_label(first: Fraction | float, last: Fraction | float) -> str:
    """Return the first and last time code of a range as text.

    >>> span_label(1001.0, 1024.0)
    '1001 to 1024'
    """
    return f"{frame_label(first)} to {frame_label(last)}"


def frame_label(frame: Fraction | float) -> str:
    """Return a time code as text: all digits of the frame, no exponent.

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
