"""Parsers of option texts: frame ranges, offsets, time codes and rest poses."""

from __future__ import annotations

import re
from fractions import Fraction

from animtool.core.errors import excerpt
from animtool.core.rates import MAX_FRAME_NUMBER, FractionLike, exact_number
from animtool.core.shot import FrameList, FrameRange

# First, last and step of a range in the notation of other tools.
_OTHER_RANGE_PATTERN = re.compile(
    r"(-?\d{1,9})\s*[-,:;. ]+\s*(-?\d{1,9})(?:\s*[,:;x ]+\s*(\d{1,9}))?"
)
_RANGE_PATTERN = re.compile(r"(-?\d{1,9})(?:-(-?\d{1,9})(?:x(\d{1,9}))?)?")


def parse_frame_range(text: str) -> FrameRange:
    """Parse a frame range: ``1-240``, ``1-240x2`` or ``12``.

    >>> parse_frame_range("1-240x2")
    FrameRange(first=1, last=240, step=2)
    """
    match = _RANGE_PATTERN.fullmatch(text.strip())
    if match is None:
        foreign_match = _OTHER_RANGE_PATTERN.fullmatch(text.strip())
        suggestion = "1-240 or 1-240x2"
        if foreign_match is not None:
            first, last, step = foreign_match.groups()
            if int(first) > int(last):
                first, last = last, first
            suggestion = f"{first}-{last}" + (f"x{step}" if step else "")
        raise ValueError(f"{text!r} is not a range such as {suggestion}")
    first = int(match[1])
    last, step = int(match[2] or first), int(match[3] or 1)
    if last < first:
        raise ValueError(f"{text!r} is reversed: write {last}-{first}")
    if step < 1:
        raise ValueError(f"{text!r} contains no frame")
    return FrameRange(first, last, step)


def parse_frames(text: str) -> FrameRange:
    """Parse frames: a range such as ``1-240x2``, or a list such as ``1,20,40``.

    >>> parse_frames("1,20,40").frames
    (1, 20, 40)
    """
    if "," not in text:
        return parse_frame_range(text)
    try:
        return FrameList.of_frames([int(number) for number in text.split(",")])
    except ValueError as error:
        raise ValueError(f"{text!r} is not a list such as 1,20,40") from error


def parse_offsets(text: str) -> tuple[Fraction, ...]:
    """Parse a list of offsets such as ``-.25,0,.25``; they are sorted.

    >>> parse_offsets("-.25,0,.25")
    (Fraction(-1, 4), Fraction(0, 1), Fraction(1, 4))
    """
    offsets: list[Fraction] = []
    for number_text in text.split(","):
        try:
            offset = exact_number(number_text)
        except (ValueError, ArithmeticError) as error:
            message = f"{excerpt(text)} is not a list of offsets such as -.25,0,.25"
            raise ValueError(message) from error
        if not -1 < offset < 1:
            message = f"offset {number_text.strip()} is not between -1 and 1"
            raise ValueError(f"{message}: offsets are in frames{_unit_hint(text)}")
        offsets.append(offset)
    if len(set(offsets)) < len(offsets) or max(offsets) - min(offsets) >= 1:
        raise ValueError(f"offsets {text!r} overlap those of the next frame")
    return tuple(sorted(offsets))


def _unit_hint(text: str) -> str:
    """Return a hint for offsets that look like degrees or percent; else "".

    >>> _unit_hint("-90,0,90"), _unit_hint("-20,20")
    ('; for degrees of a shutter write -0.25,0,0.25', '; for percent write -0.2,0.2')
    """
    try:
        numbers = [exact_number(number) for number in text.split(",")]
    except (ValueError, ArithmeticError):
        return ""
    largest = max(map(abs, numbers))
    full_value, unit = (
        (360, "degrees of a shutter") if largest >= 45 else (100, "percent")
    )
    if not 2 <= largest < full_value:
        return ""
    offsets_text = ",".join(f"{float(number / full_value):.4g}" for number in numbers)
    return f"; for {unit} write {offsets_text}"


def parse_frame(time_code: FractionLike) -> Fraction:
    """Parse a frame such as ``1001`` or ``1000.5``.

    >>> parse_frame("1000.5")
    Fraction(2001, 2)
    """
    try:
        frame = exact_number(time_code)
    except (ValueError, ArithmeticError) as error:
        message = f"{excerpt(str(time_code))} is not a frame such as 1001"
        raise ValueError(message) from error
    if abs(frame) > MAX_FRAME_NUMBER:
        raise ValueError(f"frame {time_code!r} is beyond {MAX_FRAME_NUMBER}")
    return frame


def parse_rest(text: str) -> int | None:
    """Parse a rest pose: the frame of ``frame:N``, or None for ``offsets``.

    >>> parse_rest("frame:12")
    12
    """
    if text == "offsets":
        return None
    match = re.fullmatch(r"frame:(-?\d{1,9})", text)
    if match is None:
        raise ValueError(f"{text!r} is neither offsets nor frame:N")
    return int(match[1])


def parse_source_rest(text: str) -> int | str | None:
    """Return ``rig`` unchanged; parse any other text by `parse_rest`.

    >>> parse_source_rest("rig")
    'rig'
    """
    if text == "rig":
        return text
    try:
        return parse_rest(text)
    except ValueError:
        raise ValueError(f"{text!r} is neither offsets, frame:N nor rig") from None
