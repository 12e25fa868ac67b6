"""The media range of each clip of a timeline: nesting, trims and speeds."""

from __future__ import annotations

import re
from dataclasses import field
from fractions import Fraction
from math import isfinite
from pathlib import Path
from typing import Any, TypeAlias

from animtool.batch.timeline import MAX_DENOMINATOR, MAX_SPEED, exact_rate, seconds_of
from animtool.core.errors import Fault, Severity, excerpt
from animtool.core.record import dataclass

# Names of effects that change times although they are not a `TimeEffect`.
_TIME_EFFECT_NAME = re.compile(
    r"time\W*_?(warp|remap|ramp|curve)|retime|speed", re.IGNORECASE
)
# Begin and end [s]; None for the full range.
TimeWindow: TypeAlias = tuple[Fraction, Fraction] | None


class UnsupportedTimeError(ValueError):
    """The time effect of an item cannot be represented in a shot."""


@dataclass(frozen=True, slots=True)
class ShownClip:
    """A clip on a track and the part of it that is visible.

    Attributes:
        clip: The clip.
        track: Path of its track.
        clip_text: Name of the clip in messages.
        visible_range: Visible range since the clip's first frame [s]; None for all.
        speed: Playback speed of the surrounding tracks and stacks.
        name: Name of its shot.
    """

    clip: Any
    track: str
    clip_text: str
    visible_range: TimeWindow = None
    speed: Fraction = Fraction(1)
    name: str = ""


@dataclass(frozen=True, slots=True)
class Span:
    """The range of its media that a clip shows, and the speed.

    Attributes:
        begin: Earliest shown media time, in the clip's time codes [s].
        seconds: Duration in the timeline [s].
        speed: Playback speed of the media; negative for backwards.
        rate: Frame rate of the clip.
        shows_begin: Whether the clip's begin is visible.
        shows_end: Whether its end is visible.
    """

    begin: Fraction
    seconds: Fraction
    speed: Fraction
    rate: Fraction
    shows_begin: bool = True
    shows_end: bool = True


def shown_span(shown_clip: ShownClip) -> Span:
    """Return the media range of the visible part of a clip.

    Backwards, a clip plays its range from the last frame to the first.
    """
    trimmed_range = shown_clip.clip.trimmed_range()
    trimmed_start = seconds_of(trimmed_range.start_time)
    trimmed_duration = seconds_of(trimmed_range.duration)
    rate = exact_rate(trimmed_range.start_time.rate)
    speed = playback_speed(shown_clip.clip)
    visible_begin, visible_end = shown_clip.visible_range or (
        Fraction(0),
        trimmed_duration,
    )
    hidden_before = trimmed_duration - visible_end if speed < 0 else visible_begin
    return Span(
        trimmed_start + hidden_before * abs(speed),
        (visible_end - visible_begin) / shown_clip.speed,
        speed * shown_clip.speed,
        rate,
        visible_begin <= 0,
        visible_end >= trimmed_duration,
    )


def playback_speed(item: Any) -> Fraction:
    """Return the speed of an item relative to its content."""
    speed = Fraction(1)
    for effect in item.effects:
        if not getattr(effect, "enabled", True):
            continue
        time_scalar = getattr(effect, "time_scalar", None)
        if time_scalar is None:
            if is_time_effect(effect):
                name = effect.effect_name or effect.name or type(effect).__name__
                message = f"effect {excerpt(str(name))} has no speed"
                raise UnsupportedTimeError(message)
            continue
        if isfinite(time_scalar):
            speed *= Fraction(float(time_scalar)).limit_denominator(MAX_DENOMINATOR)
        if not isfinite(time_scalar) or abs(speed) > MAX_SPEED:
            raise ValueError(f"it plays at {time_scalar:g} times its speed")
    return speed


def is_time_effect(effect: Any) -> bool:
    """Return whether an effect changes times, by its kind or name."""
    import opentimelineio as otio

    name = str(effect.effect_name or "")
    has_effect_type = isinstance(effect, otio.schema.TimeEffect)
    return has_effect_type or _TIME_EFFECT_NAME.search(name) is not None


def transition_offsets(shown_clip: ShownClip) -> tuple[Any, Any]:
    """Return how far transitions extend a clip before and after it, or None."""
    import opentimelineio as otio

    transition_type = otio.schema.Transition
    track = shown_clip.clip.parent()
    if not isinstance(track, otio.schema.Track):
        return None, None
    in_transition, out_transition = track.neighbors_of(shown_clip.clip)
    return (
        in_transition.in_offset if isinstance(in_transition, transition_type) else None,
        out_transition.out_offset
        if isinstance(out_transition, transition_type)
        else None,
    )


@dataclass(slots=True)
class ClipVisitor:
    """Visits the clips on video tracks with the part of each that is visible."""

    path: Path  # the timeline
    clips: list[ShownClip] = field(default_factory=list)  # in the order of the timeline
    gap_count: int = 0
    # Why clips are not shots, by their names.
    skip_reasons: dict[str, str] = field(default_factory=dict)
    notices: list[Fault] = field(default_factory=list)

    def visit_timeline(self, tracks: Any) -> None:
        """Collect the visible clips of the enabled video tracks of a timeline."""
        if self._is_disabled(tracks, "the timeline's stack"):
            return
        try:
            window, tracks_speed = _content_window(tracks, None)
        except UnsupportedTimeError as error:
            self.skip_item(tracks, "BAT044", f"the timeline's stack: {error}")
            return
        for number, track in enumerate(tracks, 1):
            name = track.name or f"track {number}"
            if self._is_video(track, name) and not self._is_disabled(track, name):
                self._visit_item(track, name, name, window, Fraction(0), tracks_speed)

    def _is_video(self, item: Any, item_text: str) -> bool:
        """Return whether a track or stack is a video track; record it if not."""
        kind = getattr(item, "kind", "Video")
        if kind != "Video":
            self._note("BAT043", f"{item_text}, of type {kind}, is skipped")
        return bool(kind == "Video")

    def _is_disabled(self, item: Any, item_text: str) -> bool:
        if getattr(item, "enabled", True):
            return False
        self.skip_item(item, "BAT043", f"{item_text} is disabled", Severity.NOTE)
        return True

    def skip_item(
        self, item: Any, code: str, reason: str, severity: Severity = Severity.WARNING
    ) -> None:
        """Record why an item, and each clip in it, does not become a shot."""
        for name in _clip_names(item):
            self.skip_reasons.setdefault(name, reason)
        self._note(code, f"{reason}; it is skipped", severity)

    def _note(
        self, code: str, message: str, severity: Severity = Severity.NOTE
    ) -> None:
        self.notices.append(Fault(code, message, str(self.path), severity=severity))

    def _visit_item(
        self,
        item: Any,
        item_text: str,
        track: str,
        window: TimeWindow,
        begin: Fraction,
        speed: Fraction,
    ) -> None:
        """Visit an item that begins at a time in its parent [s].

        ``window`` is the visible part of the parent, ``speed`` that of the parent.
        """
        visible_part: TimeWindow = None
        if window is not None:
            item_end = begin + duration_of(item)
            if not max(begin, window[0]) < min(item_end, window[1]):
                reason = f"{item_text} is trimmed away"
                self.skip_item(item, "BAT043", reason, Severity.NOTE)
                return
            visible_end = min(item_end, window[1])
            visible_part = (max(begin, window[0]) - begin, visible_end - begin)
        if not hasattr(item, "find_children"):
            self.clips.append(ShownClip(item, track, item_text, visible_part, speed))
            return
        try:
            inner_window, inner_speed = _content_window(item, visible_part)
        except UnsupportedTimeError as error:
            self.skip_item(item, "BAT044", f"{item_text}: {error}")
            return
        self._visit_children(item, track, inner_window, speed * inner_speed)

    def _visit_children(
        self, parent: Any, parent_path: str, window: TimeWindow, speed: Fraction
    ) -> None:
        import opentimelineio as otio

        schema, begin = otio.schema, Fraction(0)
        is_track = isinstance(parent, schema.Track)
        for child in parent:
            if isinstance(child, schema.Transition):
                continue
            child_begin = begin
            if is_track and window is not None:
                begin += duration_of(child)
            if isinstance(child, schema.Gap):
                self.gap_count += 1
            elif isinstance(child, schema.Clip):
                child_text = f"clip {excerpt(child.name or '')} of {parent_path}"
                if not self._is_disabled(child, child_text):
                    self._visit_item(
                        child, child_text, parent_path, window, child_begin, speed
                    )
            elif isinstance(child, otio.core.Composition):
                child_track = (
                    f"{parent_path}/{child.name}" if child.name else parent_path
                )
                if self._is_video(child, child_track) and not self._is_disabled(
                    child, child_track
                ):
                    message = f"{child_track} is nested; its clips become shots"
                    self._note("BAT043", message)
                    self._visit_item(
                        child, child_track, child_track, window, child_begin, speed
                    )


def _content_window(
    item: Any, visible_range: TimeWindow
) -> tuple[TimeWindow, Fraction]:
    """Return the content range that a track or stack shows, and its speed.

    ``visible_range`` is relative to the begin of the item [s]; None for all.
    """
    speed, source_range = playback_speed(item), item.source_range
    if speed <= 0:
        problem = "plays backwards" if speed else "holds a frame"
        raise UnsupportedTimeError(f"it {problem}, which only clips can")
    if source_range is None and visible_range is None and speed == 1:
        return None, speed
    first_time, duration = Fraction(0), duration_of(item)
    if source_range is not None:
        first_time = seconds_of(source_range.start_time)
    visible_begin, visible_end = visible_range or (Fraction(0), duration)
    return (first_time + visible_begin * speed, first_time + visible_end * speed), speed


def duration_of(item: Any) -> Fraction:
    """Return the visible duration of an item [s].

    Transitions have no duration; at the ends of a track, the parts that they show
    beyond it are added.
    """
    import opentimelineio as otio

    schema = otio.schema
    if isinstance(item, schema.Transition):
        return Fraction(0)
    if getattr(item, "source_range", None) is not None:
        return seconds_of(item.source_range.duration)
    if not isinstance(item, otio.core.Composition):
        return seconds_of(item.trimmed_range().duration)
    durations = [duration_of(child) for child in item]
    if not isinstance(item, schema.Track):
        return max(durations, default=Fraction(0))
    duration = sum(durations, Fraction(0))
    if len(item) and isinstance(item[0], schema.Transition):
        duration += seconds_of(item[0].in_offset)
    if len(item) and isinstance(item[-1], schema.Transition):
        duration += seconds_of(item[-1].out_offset)
    return duration


def _clip_names(item: Any) -> list[str]:
    """Return the name of an item and the names of the clips in it."""
    if not hasattr(item, "find_children"):
        return [item.name or ""]
    return [name for child in item for name in _clip_names(child)]
