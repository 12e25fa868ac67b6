"""SMPTE time codes, drop-frame included."""

from __future__ import annotations

import re
from fractions import Fraction

# Frames a second that are labelled, minutes but every tenth leaving so many out.
_DROPPED = {Fraction(30000, 1001): 2, Fraction(60000, 1001): 4}
_LABEL = re.compile(r"(\d\d):(\d\d):(\d\d)([:;])(\d\d+)(\.\d{1,18})?")


def is_timecode(text: object) -> bool:
    """Return whether a text is a time code at some rate.

    >>> is_timecode("01:00:00;02"), is_timecode("1 h")
    (True, False)
    """
    return isinstance(text, str) and _LABEL.fullmatch(text.strip()) is not None


def count_rate(rate: Fraction) -> int:
    """Return the number of labels a second: the rate, or 1001/1000 of it.

    >>> count_rate(Fraction(24000, 1001)), count_rate(Fraction(25))
    (24, 25)
    """
    for labels in (rate, rate * Fraction(1001, 1000)):
        if labels.denominator == 1 and 1 <= labels <= 960:
            return int(labels)
    message = f"time codes do not count {float(rate):g} frames per second"
    raise ValueError(f"{message}: use a whole number, or 1000/1001 of one")


def day_frames(rate: Fraction, *, drop: bool = False) -> int:
    """Return the number of labels in a day.

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
        message = f"{text!r} is not a time code such as 01:00:00:00 or 01:00:00;02"
        raise ValueError(message)
    count, drop = count_rate(rate), match[4] == ";"
    hours, minutes, seconds, frames = (int(match[i]) for i in (1, 2, 3, 5))
    limits = (("hour", hours, 24), ("minute", minutes, 60), ("second", seconds, 60))
    for what, value, limit in (*limits, ("frame", frames, count)):
        if value >= limit:
            message = f"{text!r} has {what} {value:02d}; the largest is {limit - 1:02d}"
            raise ValueError(message)
    left_out = _dropped(rate) if drop else 0
    if minutes % 10 and not seconds and frames < left_out:
        first = f"{hours:02d}:{minutes:02d}:00;{left_out:02d}"
        message = f"drop-frame has no {text!r}: this minute starts at {first}"
        raise ValueError(message)
    total_minutes = 60 * hours + minutes
    labels = count * (60 * total_minutes + seconds) + frames
    return (
        labels
        - left_out * (total_minutes - total_minutes // 10)
        + Fraction(match[6] or 0)
    )


def timecode_label(frame: int, rate: Fraction, *, drop: bool = False) -> str:
    """Return the label of a frame counted from midnight; see `parse_timecode`.

    Frames of other days have the label that they have on this one.

    >>> timecode_label(107892, Fraction(30000, 1001), drop=True)
    '01:00:00;00'
    >>> timecode_label(61, Fraction(24)), timecode_label(-1, Fraction(24))
    ('00:00:02:13', '23:59:59:23')
    """
    count, left_out = count_rate(rate), _dropped(rate) if drop else 0
    frame %= day_frames(rate, drop=drop)
    if left_out:
        tens, rest = divmod(frame, 600 * count - 9 * left_out)
        minute = max(0, rest - left_out) // (60 * count - left_out)
        frame += left_out * (9 * tens + minute)
    seconds, frames = divmod(frame, count)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    wide = max(2, len(str(count - 1)))
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}{':;'[drop]}{frames:0{wide}d}"


def seconds_between(
    first: str, first_rate: Fraction, other: str, other_rate: Fraction
) -> Fraction:
    """Return the time from one label to another, over midnight too [s].

    Each is counted from midnight at its own rate; of two ways around the clock it is
    the shorter.

    >>> seconds_between("23:59:59:00", Fraction(25), "00:00:01:05", Fraction(25))
    Fraction(11, 5)
    """
    gap = parse_timecode(other, other_rate) / other_rate
    gap -= parse_timecode(first, first_rate) / first_rate
    day = day_frames(first_rate, drop=";" in first) / first_rate
    return (gap + day / 2) % day - day / 2


def _dropped(rate: Fraction) -> int:
    """Return how many labels a minute of a drop-frame rate skips."""
    if rate not in _DROPPED:
        message = f"drop-frame (;) does not apply to {float(rate):g} frames per second"
        raise ValueError(f"{message}, only to 30000/1001 and 60000/1001")
    return _DROPPED[rate]
