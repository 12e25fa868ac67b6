"""Frames in options, as time codes of a take."""

from __future__ import annotations

import math
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.clock import MAX_FRAMES, Clock
from animtool.core.errors import Fault, OptionError


def exact_fraction(number: float, name: str) -> Fraction:
    """Return the fraction that a decimal literal denotes.

    >>> exact_fraction(0.1, "pivot")
    Fraction(1, 10)
    """
    if not math.isfinite(number):
        raise frame_refusal(f"{name} is {number}, which is not a frame")
    return Fraction(repr(float(number)))


def check_range(first: float | None, last: float | None) -> None:
    """Refuse a reversed range of frames; None is an end of the take."""
    range_ends = [
        exact_fraction(range_end, name)
        for range_end, name in ((first, "first"), (last, "last"))
        if range_end is not None
    ]
    if range_ends != sorted(range_ends):
        message = f"the range from {first:g} to {last:g} is reversed"
        flags = argument("first", f"{last:g}"), argument("last", f"{first:g}")
        hint = f"write {' and '.join(flags)}"
        raise frame_refusal(message, hint)


def frame_refusal(message: str, hint: str | None = None) -> OptionError:
    """Return the error for a frame outside a take."""
    return OptionError(Fault("SCN013", message, hint=hint))


def frame_index(clock: Clock, frame: float, name: str) -> int:
    """Return the index of the frame nearest to a time code.

    >>> frame_index(Clock(Fraction(24), Fraction(1001), Fraction(1), 9), 1003, "first")
    2
    """
    index = round((exact_fraction(frame, name) - clock.start) / clock.step)
    if not 0 <= index < clock.count:
        last = clock.start + (clock.count - 1) * clock.step
        raise frame_refusal(
            f"{name} is frame {frame:g}, but the take has "
            f"{float(clock.start):g}-{float(last):g}"
        )
    return index


def check_count(count: int) -> None:
    """Refuse a result of more than 10 million frames."""
    if count > MAX_FRAMES:
        message = f"the take would have {count} frames; the limit is {MAX_FRAMES}"
        raise OptionError(Fault("SCN021", message))
