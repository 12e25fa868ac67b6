"""Shots without frames of their media: the distance, and a hint."""

from __future__ import annotations

from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.shot import Shot
from animtool.core.timecode import parse_timecode

HOUR = 3600
# A range this near to an integer number of hours from its take is hours away.
NEAR_HOUR = 600


def no_frames(
    shot: Shot, first: int, last: int, length: Fraction, path: str | None = None
) -> OptionError:
    """Return the error of a shot whose take has none of its frames (SCN042).

    Args:
        shot: It places its media.
        first: First of the frames.
        last: Last of them.
        length: How long the take is [s].
        path: The take's file.
    """
    named = f"shot {shot.name}: " if shot.name else ""
    message, hint = f"{named}the take has no frame from {first} to {last}", None
    if shot.timecode is not None:
        away, hint = range_away(shot, first, last, length)
        message += f"; {away}"
    return OptionError(Fault("SCN042", message, path, (), hint))


def range_away(shot: Shot, first: int, last: int, length: Fraction) -> tuple[str, str]:
    """Return the distance of shot frames from a take without any, and a hint.

    Args:
        shot: It places its media.
        first: First of the frames.
        last: Last of them.
        length: How long the take is [s].
    """
    clock = shot.timecode
    assert clock is not None
    shown = sorted(shot.seconds_at(frame) for frame in (first, last))
    frame = 1 / clock.rate
    here = f"{clock.label(shown[0])} to {clock.label(shown[1])}"
    ends = Fraction(0), max(Fraction(0), length - frame)
    there = f"{clock.label(ends[0])} to {clock.label(ends[1])}"
    message = f"the range shows {here}, but the take is {there}: the range is "
    message += f"{_distance(shown[0])} {'after' if shown[0] > 0 else 'before'} it"
    code = _first_label(shot, shown[0], length)
    hint = (
        "if the first timecode of the take is different, set it: "
        f"{argument('first_timecode', code)}"
    )
    hint += ", or `first_timecode` under [timeline] in animtool.toml or in "
    hint += "metadata.animtool of the clip"
    return message, hint


def _distance(seconds: Fraction) -> str:
    """Return a time as text.

    >>> _distance(Fraction(3601)), _distance(Fraction(-12))
    ('about an hour (3601 s)', '12 s')
    """
    away = abs(seconds)
    hours = round(away / HOUR)
    text = f"{float(away):.7g} s"
    if hours and abs(away - hours * HOUR) < NEAR_HOUR:
        return f"about {'an hour' if hours == 1 else f'{hours} hours'} ({text})"
    return text


def _first_label(shot: Shot, shown: Fraction, length: Fraction) -> str:
    """Return the hour of a take's first time code, else a pattern."""
    clock = shot.timecode
    assert clock is not None
    label = clock.label(shown)
    hour = f"{label[:2]}:00:00{';' if clock.drop else ':'}00"
    try:
        begin = parse_timecode(hour, clock.rate) / clock.rate
    except ValueError:
        return "HH:MM:SS:FF"
    fits = begin <= clock.first + shown < begin + length and begin != clock.first
    return hour if fits else "HH:MM:SS:FF"
