"""Media of each clip of a timeline: nesting, trims, speeds, disabled items."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import field
from fractions import Fraction
from math import isfinite
from typing import Any, TypeAlias

from animtool.batch.timeline import (
    FASTEST,
    LARGEST_DENOMINATOR,
    exact_rate,
    seconds_of,
)
from animtool.core.errors import excerpt
from animtool.core.record import dataclass

# What systems call effects that are no `TimeEffect` and change times all the same.
_OF_TIME = re.compile(r"time\W*_?(warp|remap|ramp|curve)|retime|speed", re.IGNORECASE)
# Begin and end [s]; None is whatever there is.
Window: TypeAlias = tuple[Fraction, Fraction] | None


class UnsupportedTimeError(ValueError):
    """An item's time effect cannot be represented in a shot."""


@dataclass(frozen=True, slots=True)
class ShownClip:
    """A clip on a track, and its visible part.

    Attributes:
        clip: The clip.
        track: Path of its track.
        named: What the clip is called in messages.
        part: Time since the clip's first frame, of what is shown [s]; None is all.
        speed: How many times as fast as themselves the tracks and stacks around the
            clip play.
        name: Of its shot.
    """

    clip: Any
    track: str
    named: str
    part: Window = None
    speed: Fraction = Fraction(1)
    name: str = ""


@dataclass(frozen=True, slots=True)
class Span:
    """The media range that a clip shows.

    Attributes:
        begin: Earliest time of the media shown, as time codes of the clip count [s].
        seconds: How long the timeline shows it [s].
        speed: How many times as fast as the media it plays; below 0 it goes backwards.
        rate: Frames a second in which the clip counts.
        head: Whether the clip's own begin is shown.
        tail: Whether its own end is shown.
    """

    begin: Fraction
    seconds: Fraction
    speed: Fraction
    rate: Fraction
    head: bool = True
    tail: bool = True


def span_of(shown: ShownClip) -> Span:
    """Return the media range that a clip shows.

    Backwards, a clip plays its range from the last frame to the first.

    Raises:
        ValueError: Its range is none, or it plays as no shot can
            (`UnsupportedTimeError`).
    """
    trimmed = shown.clip.trimmed_range()
    start, length = seconds_of(trimmed.start_time), seconds_of(trimmed.duration)
    rate, speed = exact_rate(trimmed.start_time.rate), speed_of(shown.clip)
    begin, end = (Fraction(0), length) if shown.part is None else shown.part
    before = length - end if speed < 0 else begin
    return Span(
        start + before * abs(speed),
        (end - begin) / shown.speed,
        speed * shown.speed,
        rate,
        begin <= 0,
        end >= length,
    )


def speed_of(item: Any) -> Fraction:
    """Return the speed of an item relative to its content.

    Raises:
        ValueError: It is faster than anything, or its time runs unevenly.
    """
    speed = Fraction(1)
    for effect in item.effects:
        if not getattr(effect, "enabled", True):
            continue
        scalar = getattr(effect, "time_scalar", None)
        if scalar is None:
            if is_time_effect(effect):
                raise UnsupportedTimeError(f"{_effect_name(effect)} has no speed")
            continue
        if not isfinite(scalar):
            raise ValueError(f"it plays at {scalar:g} times its speed")
        speed *= Fraction(float(scalar)).limit_denominator(LARGEST_DENOMINATOR)
        if abs(speed) > FASTEST:
            raise ValueError(f"it plays at {scalar:g} times its speed")
    return speed


def is_time_effect(effect: Any) -> bool:
    """Return whether an effect changes times, by its kind or name."""
    import opentimelineio as otio

    if isinstance(effect, otio.schema.TimeEffect):
        return True
    return _OF_TIME.search(str(effect.effect_name or "")) is not None


def _effect_name(effect: Any) -> str:
    name = effect.effect_name or effect.name or type(effect).__name__
    return f"effect {excerpt(str(name))}"


def transition_sides(shown: ShownClip) -> tuple[Any, Any]:
    """Return how far transitions extend a clip; None without any."""
    import opentimelineio as otio

    kind = otio.schema.Transition
    track = shown.clip.parent()
    if not isinstance(track, otio.schema.Track):
        return None, None
    before, behind = track.neighbors_of(shown.clip)
    return (
        before.in_offset if isinstance(before, kind) else None,
        behind.out_offset if isinstance(behind, kind) else None,
    )


Noter: TypeAlias = Callable[[str, str, bool], None]


@dataclass(slots=True)
class Walk:
    """Visits the clips on video tracks and their visible parts."""

    note: Noter  # takes a code, a message, and whether it is a warning
    clips: list[ShownClip] = field(default_factory=list)  # in the order of the timeline
    gaps: int = 0
    # Why clips are no shots, by their names.
    skipped: dict[str, str] = field(default_factory=dict)

    def timeline(self, tracks: Any) -> None:
        """Visit the clips of a timeline's tracks."""
        if self._off(tracks, "the timeline's stack"):
            return
        try:
            window, speed = _inside(tracks, None)
        except UnsupportedTimeError as error:
            self.leave_out(tracks, "BAT044", f"the timeline's stack: {error}")
            return
        for number, track in enumerate(tracks, 1):
            name = track.name or f"track {number}"
            kind = getattr(track, "kind", "Video")
            if kind != "Video":
                self.note("BAT043", f"{name}, of type {kind}, is skipped", False)
            elif not self._off(track, name):
                self._item(track, name, name, window, Fraction(0), speed)

    def _off(self, item: Any, named: str) -> bool:
        if getattr(item, "enabled", True):
            return False
        self.leave_out(item, "BAT043", f"{named} is disabled", warn=False)
        return True

    def leave_out(self, item: Any, code: str, why: str, *, warn: bool = True) -> None:
        """Report why an item and its content give no shot."""
        for name in _clip_names(item):
            self.skipped.setdefault(name, why)
        self.note(code, f"{why}; it is skipped", warn)

    def _item(
        self,
        item: Any,
        named: str,
        where: str,
        window: Window,
        begin: Fraction,
        speed: Fraction,
    ) -> None:
        """Visit an item at a time of its parent, of which a part is visible.

        window: of what it is in; begin: of the item there [s]; speed: of what it is in.
        """
        part: Window = None
        if window is not None:
            end = begin + duration_of(item)
            if not max(begin, window[0]) < min(end, window[1]):
                self.leave_out(item, "BAT043", f"{named} is trimmed away", warn=False)
                return
            part = max(begin, window[0]) - begin, min(end, window[1]) - begin
        if not hasattr(item, "find_children"):
            self.clips.append(ShownClip(item, where, named, part, speed))
            return
        try:
            inner, inner_speed = _inside(item, part)
        except UnsupportedTimeError as error:
            self.leave_out(item, "BAT044", f"{named}: {error}")
            return
        self._children(item, where, inner, speed * inner_speed)

    def _children(
        self, parent: Any, where: str, window: Window, speed: Fraction
    ) -> None:
        import opentimelineio as otio

        schema, begin = otio.schema, Fraction(0)
        in_row = isinstance(parent, schema.Track)
        for child in parent:
            if isinstance(child, schema.Transition):
                continue
            begun = begin
            if in_row and window is not None:
                begin += duration_of(child)
            if isinstance(child, schema.Gap):
                self.gaps += 1
            elif isinstance(child, schema.Clip):
                named = f"clip {excerpt(child.name or '')} of {where}"
                if not self._off(child, named):
                    self._item(child, named, where, window, begun, speed)
            elif isinstance(child, otio.core.Composition):
                inner = f"{where}/{child.name}" if child.name else where
                kind = getattr(child, "kind", "Video")
                if kind != "Video":
                    self.note("BAT043", f"{inner}, of type {kind}, is skipped", False)
                elif not self._off(child, inner):
                    self.note(
                        "BAT043", f"{inner} is nested; its clips become shots", False
                    )
                    self._item(child, inner, inner, window, begun, speed)


def _inside(item: Any, part: Window) -> tuple[Window, Fraction]:
    """Return the content time that a track or stack shows, and its speed.

    part: time since its begin that is shown; None is all.
    """
    speed, trim = speed_of(item), item.source_range
    if speed <= 0:
        how = "plays backwards" if speed else "holds a frame"
        raise UnsupportedTimeError(f"it {how}, which only clips can")
    if trim is None and part is None and speed == 1:
        return None, speed
    first, length = Fraction(0), duration_of(item)
    if trim is not None:
        first = seconds_of(trim.start_time)
    begin, end = (Fraction(0), length) if part is None else part
    return (first + begin * speed, first + end * speed), speed


def duration_of(item: Any) -> Fraction:
    """Return the visible duration of an item [s].

    Transitions take no time of their own; at the ends of a track, what they show
    beyond it counts.
    """
    import opentimelineio as otio

    schema = otio.schema
    if isinstance(item, schema.Transition):
        return Fraction(0)
    if getattr(item, "source_range", None) is not None:
        return seconds_of(item.source_range.duration)
    if not isinstance(item, otio.core.Composition):
        return seconds_of(item.trimmed_range().duration)
    parts = [duration_of(child) for child in item]
    if not isinstance(item, schema.Track):
        return max(parts, default=Fraction(0))
    length = sum(parts, Fraction(0))
    ends = [(item[0], "in_offset"), (item[-1], "out_offset")] if len(item) else []
    for child, side in ends:
        if isinstance(child, schema.Transition):
            length += seconds_of(getattr(child, side))
    return length


def _clip_names(item: Any) -> list[str]:
    """Return the names of an item and of the clips in it."""
    if not hasattr(item, "find_children"):
        return [item.name or ""]
    names = []
    for child in item:
        names += _clip_names(child)
    return names
