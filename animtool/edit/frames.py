"""Frame options, as time codes of a take: checks, indices, and hints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.clock import MAX_FRAME_COUNT, Clock
from animtool.core.errors import Fault, OptionError, value_excerpt
from animtool.core.shot import SHOT_START


def exact_fraction(number: float, argument_name: str) -> Fraction:
    """Return the fraction that a decimal literal denotes.

    >>> exact_fraction(0.1, "pivot")
    Fraction(1, 10)
    """
    try:
        is_finite = math.isfinite(number)
    except TypeError as error:
        message = f"{argument_name} must be a number, not {value_excerpt(number)}"
        raise TypeError(message) from error
    if not is_finite:
        raise frame_error(f"{argument_name} is {number}, which is not a frame")
    return Fraction(repr(float(number)))


def check_range(first: float | None, last: float | None) -> None:
    """Raise if a frame range is reversed; None stands for an end of the take."""
    range_ends = [
        exact_fraction(range_end, name)
        for range_end, name in ((first, "first"), (last, "last"))
        if range_end is not None
    ]
    if range_ends != sorted(range_ends):
        message = f"the range from {first:g} to {last:g} is reversed"
        swapped_options = argument("first", f"{last:g}"), argument("last", f"{first:g}")
        hint = f"write {' and '.join(swapped_options)}"
        if range_ends[1] < 0 <= range_ends[0]:
            hint = "frames are not counted from the end: leave out "
            hint += f"{argument('last')} to keep all frames up to the end"
        raise frame_error(message, hint)


def frame_error(message: str, hint: str | None = None) -> OptionError:
    """Return the error for a frame outside a take."""
    return OptionError(Fault("SCN013", message, hint=hint))


def frame_index(clock: Clock, frame: float, argument_name: str) -> int:
    """Return the index of the frame nearest to a time code.

    >>> frame_index(Clock(Fraction(24), Fraction(1001), Fraction(1), 9), 1003, "first")
    2
    """
    index = round((exact_fraction(frame, argument_name) - clock.start) / clock.step)
    if not 0 <= index < clock.count:
        last = clock.start + (clock.count - 1) * clock.step
        nearest = clock.start if index < 0 else last
        raise frame_error(
            f"{argument_name} is {frame:g}, but the take has frames "
            f"{float(clock.start):g} to {float(last):g}",
            seconds_hint({argument_name: frame}, clock.start, clock.fps, last)
            or _shot_hint(clock, exact_fraction(frame, argument_name), argument_name)
            or f"write {argument(argument_name, f'{float(nearest):g}')}",
        )
    return index


def _shot_hint(clock: Clock, frame: Fraction, name: str) -> str | None:
    """Return a hint about a shot's frame in a take that starts elsewhere, or None."""
    frame_in_take = frame - SHOT_START + clock.start
    last = clock.start + (clock.count - 1) * clock.step
    if not clock.start < SHOT_START <= frame or frame_in_take > last:
        return None
    option = argument(name, f"{float(frame_in_take):g}")
    return (
        f"the take starts at {float(clock.start):g}, not {SHOT_START}: write {option}"
    )


def seconds_hint(
    value_by_option: Mapping[str, float],
    start: Fraction,
    fps: Fraction,
    last: Fraction | None = None,
) -> str | None:
    """Return a hint with the frames for options that look like seconds, or None.

    At least one of the options must be fractional. The take has time codes from
    ``start`` to ``last``, None if the end is unknown.
    """
    values = list(value_by_option.values())
    if all(value == round(value) for value in values) or min(values) < 0:
        return None
    codes = [float(start) + value * float(fps) for value in values]
    if last is not None and max(codes) > float(last) + 1:
        return None
    round_functions = {"first": math.ceil, "last": math.floor}
    frames = [
        round_functions.get(name, round)(
            code - 1e-9 if name == "first" else code + 1e-9
        )
        for name, code in zip(value_by_option, codes, strict=True)
    ]
    if frames != sorted(frames):
        return None
    seconds_text = " to ".join(f"{value:g}" for value in values)
    codes_text = " to ".join(f"{code:.4g}" for code in codes)
    noun = "frame" if len(codes) == 1 else "frames"
    verb = "is" if len(codes) == 1 else "are"
    option_texts = [
        argument(name, frame)
        for name, frame in zip(value_by_option, frames, strict=True)
    ]
    return (
        f"are these seconds? {seconds_text} s {verb} {noun} {codes_text}: write "
        f"{' and '.join(option_texts)}"
    )


def check_count(count: int) -> None:
    """Raise if a result would have more than 10 million frames."""
    if count > MAX_FRAME_COUNT:
        message = f"the take would have {count} frames; the limit is {MAX_FRAME_COUNT}"
        raise OptionError(Fault("SCN021", message))
