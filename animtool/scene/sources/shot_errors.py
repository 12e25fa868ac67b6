"""Errors of shots that show none of their take's frames."""

from __future__ import annotations

from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.shot import Shot
from animtool.core.timecode import parse_timecode

SECONDS_PER_HOUR = 3600
# A distance within this time of a multiple of an hour suggests a wrong hour [s].
HOUR_TOLERANCE = 600


def no_frames_error(
    shot: Shot, first: int, last: int, length: Fraction, path: str | None = None
) -> OptionError:
    """Return the error of a shot whose frames are all outside its take (SCN042).

    The shot places its media. ``length`` is the duration of the take [s].
    """
    prefix = f"shot {shot.name}: " if shot.name else ""
    message, hint = f"{prefix}the take has no frame from {first} to {last}", None
    if shot.timecode is not None:
        distance, hint = range_distance(shot, first, last, length)
        message += f"; {distance}"
    return OptionError(Fault("SCN042", message, path, (), hint))


def range_distance(
    shot: Shot, first: int, last: int, length: Fraction
) -> tuple[str, str]:
    """Return the distance of a shot's frames from its take as text, and a hint.

    ``length`` is the duration of the take [s].
    """
    clock = shot.timecode
    assert clock is not None
    shot_seconds = sorted(shot.seconds_at(frame) for frame in (first, last))
    frame = 1 / clock.rate
    shot_range = f"{clock.label(shot_seconds[0])} to {clock.label(shot_seconds[1])}"
    take_seconds = Fraction(0), max(Fraction(0), length - frame)
    take_range = f"{clock.label(take_seconds[0])} to {clock.label(take_seconds[1])}"
    side = "after" if shot_seconds[0] > 0 else "before"
    message = (
        f"the range shows {shot_range}, but the take is {take_range}: the range is "
    )
    message += f"{_distance(shot_seconds[0])} {side} it"
    code = _first_label(shot, shot_seconds[0], length)
    hint = "if the first timecode of the take is different, set it: "
    hint += argument("first_timecode", code)
    hint += ", or `first_timecode` under [timeline] in animtool.toml or in "
    hint += "metadata.animtool of the clip"
    return message, hint


def _distance(seconds: Fraction) -> str:
    """Return a distance in time as text.

    >>> _distance(Fraction(3601)), _distance(Fraction(-12))
    ('about an hour (3601 s)', '12 s')
    """
    duration = abs(seconds)
    hours = round(duration / SECONDS_PER_HOUR)
    seconds_text = f"{float(duration):.7g} s"
    if hours and abs(duration - hours * SECONDS_PER_HOUR) < HOUR_TOLERANCE:
        return f"about {'an hour' if hours == 1 else f'{hours} hours'} ({seconds_text})"
    return seconds_text


def _first_label(shot: Shot, shot_seconds: Fraction, length: Fraction) -> str:
    """Return the full hour that is likely the take's first time code, or a pattern."""
    clock = shot.timecode
    assert clock is not None
    label = clock.label(shot_seconds)
    hour = f"{label[:2]}:00:00{';' if clock.drop_frame else ':'}00"
    try:
        begin = parse_timecode(hour, clock.rate) / clock.rate
    except ValueError:
        return "HH:MM:SS:FF"
    fits = begin <= clock.first + shot_seconds < begin + length and begin != clock.first
    return hour if fits else "HH:MM:SS:FF"
