"""SMPTE time codes, including drop-frame time codes."""

from __future__ import annotations

import re
from fractions import Fraction

# Labelled frame rates with drop-frame, and the labels skipped per minute except every
# tenth.
_DROPPED_LABELS = {Fraction(30000, 1001): 2, Fraction(60000, 1001): 4}
_LABEL_PATTERN = re.compile(r"(\d\d):(\d\d):(\d\d)([:;])(\d\d+)(\.\d{1,18})?")


def is_timecode(value: object) -> bool:
    """Return whether a text is a time code at any rate.

    >>> is_timecode("01:00:00;02"), is_timecode("1 h")
    (True, False)
    """
    return (
        isinstance(value, str) and _LABEL_PATTERN.fullmatch(value.strip()) is not None
    )


def nominal_rate(rate: Fraction) -> int:
    """Return the number of labels per second: the rate, or 1001/1000 of it.

    >>> nominal_rate(Fraction(24000, 1001)), nominal_rate(Fraction(25))
    (24, 25)
    """
    for labels in (rate, rate * Fraction(1001, 1000)):
        if labels.denominator == 1 and 1 <= labels <= 960:
            return int(labels)
    message = f"time codes do not count {float(rate):g} frames per second"
    raise ValueError(f"{message}: use a whole number, or 1000/1001 of one")


def frames_per_day(rate: Fraction, *, is_drop_frame: bool = False) -> int:
    """Return the number of time code labels in a day.

    >>> frames_per_day(Fraction(30000, 1001), is_drop_frame=True)
    2589408
    """
    dropped_labels = 24 * 54 * _labels_dropped_per_minute(rate) if is_drop_frame else 0
    return 24 * 3600 * nominal_rate(rate) - dropped_labels


def parse_timecode(text: str, rate: Fraction) -> Fraction:
    """Return the number of frames from midnight to a time code label.

    A semicolon means drop-frame: all minutes except every tenth begin with label 02, at
    59.94 with 04. ``FF.25`` is a quarter of a frame after FF. An invalid label, or one
    that drop-frame skips, raises `ValueError`.

    >>> parse_timecode("01:00:00;00", Fraction(30000, 1001))
    Fraction(107892, 1)
    """
    match = _LABEL_PATTERN.fullmatch(text.strip())
    if match is None:
        message = f"{text!r} is not a time code such as 01:00:00:00 or 01:00:00;02"
        raise ValueError(message)
    labels_per_second, is_drop_frame = nominal_rate(rate), match[4] == ";"
    hours, minutes, seconds, frames = (int(match[i]) for i in (1, 2, 3, 5))
    limits = (("hour", hours, 24), ("minute", minutes, 60), ("second", seconds, 60))
    for component, value, limit in (*limits, ("frame", frames, labels_per_second)):
        if value >= limit:
            message = f"{text!r} has {component} {value:02d}; the largest is "
            raise ValueError(f"{message}{limit - 1:02d}")
    dropped_labels = _labels_dropped_per_minute(rate) if is_drop_frame else 0
    if minutes % 10 and not seconds and frames < dropped_labels:
        first_label = f"{hours:02d}:{minutes:02d}:00;{dropped_labels:02d}"
        message = f"drop-frame has no {text!r}: this minute starts at {first_label}"
        raise ValueError(message)
    total_minutes = 60 * hours + minutes
    labels = labels_per_second * (60 * total_minutes + seconds) + frames
    return (
        labels
        - dropped_labels * (total_minutes - total_minutes // 10)
        + Fraction(match[6] or 0)
    )


def timecode_label(frame: int, rate: Fraction, *, is_drop_frame: bool = False) -> str:
    """Return the time code label of a frame counted from midnight.

    Frames of other days have the same label as on this day.

    >>> timecode_label(107892, Fraction(30000, 1001), is_drop_frame=True)
    '01:00:00;00'
    >>> timecode_label(61, Fraction(24)), timecode_label(-1, Fraction(24))
    ('00:00:02:13', '23:59:59:23')
    """
    labels_per_second = nominal_rate(rate)
    dropped_labels = _labels_dropped_per_minute(rate) if is_drop_frame else 0
    frame %= frames_per_day(rate, is_drop_frame=is_drop_frame)
    if dropped_labels:
        ten_minutes, frame_in_ten_minutes = divmod(
            frame, 600 * labels_per_second - 9 * dropped_labels
        )
        minute = max(0, frame_in_ten_minutes - dropped_labels) // (
            60 * labels_per_second - dropped_labels
        )
        frame += dropped_labels * (9 * ten_minutes + minute)
    seconds, frames = divmod(frame, labels_per_second)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    digits = max(2, len(str(labels_per_second - 1)))
    time, separator = f"{hours:02d}:{minutes:02d}:{seconds:02d}", ":;"[is_drop_frame]
    return f"{time}{separator}{frames:0{digits}d}"


def seconds_between(
    first: str, first_rate: Fraction, second: str, second_rate: Fraction
) -> Fraction:
    """Return the time between two labels, which may be on both sides of midnight [s].

    Each is counted from midnight at its own rate; the shorter way around the clock is
    used.

    >>> seconds_between("23:59:59:00", Fraction(25), "00:00:01:05", Fraction(25))
    Fraction(11, 5)
    """
    difference = parse_timecode(second, second_rate) / second_rate
    difference -= parse_timecode(first, first_rate) / first_rate
    day_seconds = frames_per_day(first_rate, is_drop_frame=";" in first) / first_rate
    return (difference + day_seconds / 2) % day_seconds - day_seconds / 2


def has_drop_frame(rate: Fraction) -> bool:
    """Return whether drop-frame time codes exist at a frame rate.

    >>> has_drop_frame(Fraction(30000, 1001)), has_drop_frame(Fraction(24))
    (True, False)
    """
    return rate in _DROPPED_LABELS


def _labels_dropped_per_minute(rate: Fraction) -> int:
    """Return the number of labels that a drop-frame rate skips per minute."""
    if rate not in _DROPPED_LABELS:
        message = f"drop-frame (;) does not apply to {float(rate):g} frames per second"
        raise ValueError(f"{message}, only to 30000/1001 and 60000/1001")
    return _DROPPED_LABELS[rate]
