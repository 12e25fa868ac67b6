"""The frames of a cut: start, media, and names for patterns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from fractions import Fraction
from math import floor
from typing import Any

from animtool.batch.spans import Span
from animtool.batch.timeline import FRAME_TOLERANCE
from animtool.core.config import Config
from animtool.core.errors import Severity, excerpt
from animtool.core.names import nearest
from animtool.core.rates import MAX_FRAME, parse_rate
from animtool.core.record import dataclass
from animtool.core.shot import SHOT_START, MediaTimecode, Shot, frames_within
from animtool.core.timecode import is_timecode, parse_timecode


@dataclass(frozen=True, slots=True)
class CutMetadata:
    """The ``metadata.animtool`` of a timeline or clip; unstated values are None."""

    start_frame: int | None = None  # first frame of the shot, including the head handle
    cut_start: int | None = None  # first frame of the cut, after the head handle
    handles: int | None = None  # shot frames before and after the cut
    first_timecode: str | None = None  # of the media, such as 01:00:00:00
    fps: Fraction | None = None  # of a timeline: the rate of its shots


def cut_metadata(
    metadata: Mapping[str, Any], owner_text: str, *, allows_fps: bool = False
) -> tuple[CutMetadata, list[tuple[str, str]]]:
    """Return the metadata of a cut, and its faults with hints.

    >>> cut_metadata({"animtool": {"handles": 8.0}}, "clip 'a'")[0].handles
    8
    >>> cut_metadata({"animtool": {"handels": 8}}, "clip 'a'")[1]
    [("metadata.animtool of clip 'a' has no key 'handels'", "did you mean 'handles'?")]
    """
    stated_values = metadata.get("animtool")
    if stated_values is None:
        return CutMetadata(), []
    location = f"metadata.animtool of {owner_text}"
    names = [
        metadata_field.name
        for metadata_field in fields(CutMetadata)
        if allows_fps or metadata_field.name != "fps"
    ]
    if not isinstance(stated_values, Mapping):
        return CutMetadata(), [
            (f"{location} is not a table", f"keys: {', '.join(names)}")
        ]
    values: dict[str, Any] = {}
    faults = []
    for key, value in stated_values.items():
        if key not in names:
            faults.append(
                (f"{location} has no key {excerpt(key)}", nearest(key, names))
            )
            continue
        try:
            values[key] = _PARSERS.get(key, _parse_integer)(key, value)
        except (TypeError, ValueError) as error:
            hint = f"write a value such as {EXAMPLES[key]}"
            faults.append((f"{location}: {key}: {error}", hint))
    return CutMetadata(**values), faults


EXAMPLES = {
    "start_frame": "1001",
    "cut_start": "1009",
    "handles": "8",
    "first_timecode": '"01:00:00:00"',
    "fps": "24 or 24000/1001",
}


def _parse_integer(key: str, value: object) -> int:
    value_text = excerpt(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value_text} is not a whole number")
    if abs(value) > MAX_FRAME or value != int(value):
        raise ValueError(f"{value_text} is not a whole number up to {MAX_FRAME}")
    if key == "handles" and value < 0:
        raise ValueError(f"{value_text} is below 0")
    return int(value)


def _parse_timecode(_key: str, value: object) -> str:
    if not is_timecode(value):
        value_text = excerpt(str(value))
        raise ValueError(
            f"{value_text} is not a time code such as 01:00:00:00 or 01:00:00;02"
        )
    return str(value).strip()


_PARSERS: dict[str, Callable[[str, Any], Any]] = {
    "fps": lambda _, value: parse_rate(value),
    "first_timecode": _parse_timecode,
}


SHOT_NAMES = (
    *("shot", "clip", "track", "first", "last", "begin", "end", "head", "tail"),
    *("handles", "fps", "speed", "media_in", "media_out", "media_first"),
    *("media_last", "media_fps"),
)


@dataclass(frozen=True, slots=True)
class CutOptions:
    """Shot options that a timeline's metadata may leave open.

    Attributes:
        handles: Shot frames before and after each cut; None uses clip and timeline
            metadata, else 0.
        start: First frame of each shot; None uses clip and timeline metadata, else the
            project's, else 1001.
        fps: Rate of the shots if the timeline states none.
        cut_start: First frame of each cut, instead of ``start``.
        first_timecode: Time code of the media's first frame, instead of the timeline's.
    """

    handles: int | None = None
    start: int | None = None
    fps: Fraction | None = None
    cut_start: int | None = None
    first_timecode: str | None = None


@dataclass(frozen=True, slots=True)
class CutContext:
    """Settings of a shot by precedence: options, clip, timeline, project."""

    options: CutOptions
    clip: CutMetadata
    timeline: CutMetadata
    project: Config

    @property
    def handles(self) -> int:
        """Number of frames before and after the cut that the shot includes."""
        candidates = (self.options.handles, self.clip.handles, self.timeline.handles)
        return next((count for count in candidates if count is not None), 0)

    def first_timecode(
        self, default: Fraction | None, rate: Fraction, *, drop: bool = False
    ) -> Fraction:
        """Return the time of the media's first frame on its time code clock [s].

        Args:
            default: Time stated by the timeline [s]; None if it states none.
            rate: Frames per second counted by the time codes.
            drop: Whether they are drop-frame.
        """
        texts = [
            level.first_timecode for level in (self.options, self.clip, self.timeline)
        ]
        if default is None:
            texts.append(self.project.timeline.first_timecode)
        text = next((text for text in texts if text is not None), None)
        if text is None:
            return Fraction(0) if default is None else default
        if drop and ";" not in text:
            text = ";".join(text.rsplit(":", 1))
        return parse_timecode(text, rate) / rate

    def cut_in(self) -> tuple[int, list[str]]:
        """Return the first frame of the cut, and messages about conflicting settings.

        A start includes the head handle. The project's default is 1001.
        """
        faults, settings = list[str](), self.project
        levels = [
            (self.options.start, self.options.cut_start, "options"),
            (self.clip.start_frame, self.clip.cut_start, "its metadata"),
            (self.timeline.start_frame, self.timeline.cut_start, "the timeline's"),
            (None, settings.timeline.cut_start, "settings"),
        ]
        for start_frame, cut_start, level_name in levels:
            if start_frame is not None and cut_start not in {
                None,
                start_frame + self.handles,
            }:
                message = f"{level_name}: start_frame {start_frame} with handles of "
                message += (
                    f"{self.handles} puts the start of the cut at "
                    f"{start_frame + self.handles}, "
                )
                faults.append(f"{message}but cut_start is {cut_start}")
            if cut_start is not None:
                return cut_start, faults
            if start_frame is not None:
                return start_frame + self.handles, faults
        start = SHOT_START if settings.start is None else int(settings.start)
        return start + self.handles, faults


def shot_of(
    name: str,
    span: Span,
    fps: Fraction,
    context: CutContext,
    first: Fraction,
    transitions: tuple[int, int] = (0, 0),
    *,
    drop: bool = False,
) -> Shot:
    """Return the shot of a clip: its cut, handles and media times.

    Args:
        name: Name of the shot.
        span: Media range of the clip.
        fps: Rate of the shot.
        context: Settings of the shot.
        first: Time of the media's first frame, in the clip's time codes [s].
        transitions: Frames shown by transitions before and after the cut.
        drop: Whether time codes of the media are drop-frame.
    """
    handles, (cut_in, _) = context.handles, context.cut_in()
    frames_before, frames_after = transitions
    count = frames_within(span.seconds, fps)
    media_in = span.begin - first
    if span.speed < 0:
        media_in -= (count - 1) * span.speed / fps
    count += frames_before + frames_after
    return Shot(
        cut_in,
        cut_in + count - 1,
        handles,
        handles,
        name,
        fps,
        media_in - frames_before * span.speed / fps,
        span.speed,
        MediaTimecode(span.rate, first, drop),
    )


def shot_notices(
    shot: Shot, span: Span, fps: Fraction, clip_text: str
) -> Iterator[tuple[str, str, Severity]]:
    """Yield notices about a shot: code, message and severity."""
    first_time, last_time = (
        f"{float(shot.seconds_at(frame)):.6g} s"
        for frame in (shot.cut_in, shot.cut_out)
    )
    if shot.speed == 0:
        message = f"{clip_text} freezes its media at {first_time}; so does the shot"
        yield "BAT044", message, Severity.NOTE
    elif shot.speed < 0:
        range_text = f"from {first_time} of its media to {last_time}"
        message = f"{clip_text} plays in reverse, {range_text}; so does the shot"
        yield "BAT044", message, Severity.WARNING
    frames = span.seconds * fps
    if frames < 1 - FRAME_TOLERANCE:
        message = (
            f"{clip_text} shows {float(frames):.3g} of a frame; the shot has one frame"
        )
        yield "BAT043", message, Severity.WARNING


def media_names(shot: Shot, media_fps: Fraction) -> dict[str, str]:
    """Return the media frames that a cut shows, counted from 1, for use in patterns."""
    media_seconds = (shot.seconds_at(frame) for frame in (shot.cut_in, shot.cut_out))
    first_frame, last_frame = (
        floor(seconds * media_fps + FRAME_TOLERANCE) + 1 for seconds in media_seconds
    )
    return {
        "media_first": str(first_frame),
        "media_last": str(last_frame),
        "media_fps": str(media_fps),
    }
