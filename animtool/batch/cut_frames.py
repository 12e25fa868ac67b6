"""The frames of a cut: its start, its media, and values for output patterns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from fractions import Fraction
from math import floor
from typing import Any

from animtool.batch.spans import Span
from animtool.batch.timeline import FRAME_TOLERANCE
from animtool.core.arguments import argument
from animtool.core.config import Config
from animtool.core.errors import Severity, excerpt
from animtool.core.names import name_hint
from animtool.core.rates import MAX_FRAME_NUMBER, parse_rate
from animtool.core.record import dataclass
from animtool.core.shot import SHOT_START, MediaTimecode, Shot, frames_within
from animtool.core.timecode import is_timecode, parse_timecode


@dataclass(frozen=True, slots=True)
class CutOptions:
    """Shot settings from options or from metadata of a timeline or clip; None if unset.

    Metadata are the keys of ``metadata.animtool``. Options take precedence over those
    of a clip, which do over those of the timeline.

    Attributes:
        start_frame: First frame of each shot, including the head handle. Default: the
            project's, else 1001.
        cut_start: First frame of each cut, after the head handle, instead of
            ``start_frame``.
        handles: Shot frames before and after each cut. Default: 0.
        first_timecode: Time code of the media's first frame, such as 01:00:00:00,
            instead of the timeline's.
        fps: Rate of the shots. Options apply if the timeline states none.
    """

    start_frame: int | None = None
    cut_start: int | None = None
    handles: int | None = None
    first_timecode: str | None = None
    fps: Fraction | None = None


def cut_metadata(
    metadata: Mapping[str, Any], owner_label: str, *, allows_fps: bool = False
) -> tuple[CutOptions, list[tuple[str, str]]]:
    """Return the shot settings in metadata, and a message and hint for each fault.

    >>> cut_metadata({"animtool": {"handles": 8.0}}, "clip 'a'")[0].handles
    8
    >>> cut_metadata({"animtool": {"handels": 8}}, "clip 'a'")[1]
    [("metadata.animtool of clip 'a' has no key 'handels'", "did you mean 'handles'?")]
    """
    stated_values = metadata.get("animtool")
    if stated_values is None:
        return CutOptions(), []
    location = f"metadata.animtool of {owner_label}"
    setting_names = [entry.name for entry in fields(CutOptions)]
    if not allows_fps:
        setting_names.remove("fps")
    if not isinstance(stated_values, Mapping):
        hint = f"keys: {', '.join(setting_names)}"
        return CutOptions(), [(f"{location} is not a table", hint)]
    settings: dict[str, Any] = {}
    faults = []
    for key, value in stated_values.items():
        if key not in setting_names:
            message = f"{location} has no key {excerpt(key)}"
            faults.append((message, name_hint(key, setting_names)))
            continue
        try:
            settings[key] = _PARSERS.get(key, _parse_integer)(key, value)
        except (TypeError, ValueError) as error:
            hint = f"write a value such as {EXAMPLE_VALUES[key]}"
            faults.append((f"{location}: {key}: {error}", hint))
    return CutOptions(**settings), faults


EXAMPLE_VALUES = {
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
    if abs(value) > MAX_FRAME_NUMBER or value != int(value):
        raise ValueError(f"{value_text} is not a whole number up to {MAX_FRAME_NUMBER}")
    if key == "handles" and value < 0:
        raise ValueError(f"{value_text} is below 0")
    return int(value)


def _parse_timecode(_key: str, value: object) -> str:
    if not is_timecode(value):
        examples = "01:00:00:00 or 01:00:00;02"
        raise ValueError(f"{excerpt(str(value))} is not a time code such as {examples}")
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
class CutConflict:
    """Settings that begin a cut at different frames."""

    message: str
    is_general: bool  # whether it is the same for every clip


@dataclass(frozen=True, slots=True)
class CutContext:
    """Settings of a shot by precedence: options, clip, timeline, project."""

    options: CutOptions
    clip_options: CutOptions
    timeline_options: CutOptions
    project: Config

    def _first_setting(self, name: str) -> Any:
        """Return a setting from the options, else clip, else timeline; else None."""
        values = (
            getattr(o, name)
            for o in (self.options, self.clip_options, self.timeline_options)
        )
        return next((value for value in values if value is not None), None)

    @property
    def handles(self) -> int:
        """Number of frames before and after the cut that the shot includes."""
        return self._first_setting("handles") or 0

    def first_timecode(
        self,
        stated_time: Fraction | None,
        rate: Fraction,
        *,
        is_drop_frame: bool = False,
    ) -> Fraction:
        """Return the time of the media's first frame on its time code clock [s].

        Args:
            stated_time: Time stated by the timeline [s]; None if it states none.
            rate: Frames per second counted by the time codes.
            is_drop_frame: Whether they are drop-frame.
        """
        text: str | None = self._first_setting("first_timecode")
        if text is None and stated_time is None:
            text = self.project.timeline.first_timecode
        if text is None:
            return Fraction(0) if stated_time is None else stated_time
        if is_drop_frame and ";" not in text:
            text = ";".join(text.rsplit(":", 1))
        return parse_timecode(text, rate) / rate

    def cut_in(self) -> tuple[int, CutConflict | None]:
        """Return the first frame of the cut, and a conflict of settings if any.

        A start includes the head handle. The project's default is 1001.
        """
        project = self.project
        options_by_level = {
            "": self.options,
            "its metadata": self.clip_options,
            "the timeline's": self.timeline_options,
            "settings": CutOptions(cut_start=project.timeline.cut_start),
        }
        for level_name, level in options_by_level.items():
            start_frame, cut_start = level.start_frame, level.cut_start
            cut_begin = None if start_frame is None else start_frame + self.handles
            if cut_start is not None:
                has_conflict = cut_begin not in {None, cut_start}
                conflict = self._conflict(level_name, level) if has_conflict else None
                return cut_start, conflict
            if cut_begin is not None:
                return cut_begin, None
        start_frame = SHOT_START if project.start is None else int(project.start)
        return start_frame + self.handles, None

    def _conflict(self, level_name: str, level: CutOptions) -> CutConflict:
        """Return the conflict of a level's start and cut_start; "" is the options."""
        start_frame, cut_start, handles = (
            level.start_frame,
            level.cut_start,
            self.handles,
        )
        assert start_frame is not None
        texts = f"start_frame {start_frame}", f"cut_start is {cut_start}"
        handles_text = f"handles of {handles}"
        if not level_name:
            texts = (
                argument("start", start_frame),
                f"{argument('cut_start')} is {cut_start}",
            )
            if level.handles is not None:
                handles_text = argument("handles", handles)
        message = (
            f"{texts[0]} with {handles_text} begins the cut at {start_frame + handles}"
        )
        message = f"{message}, but {texts[1]}"
        is_general = not level_name and level.handles is not None
        return CutConflict(
            f"{level_name}: {message}" if level_name else message, is_general
        )


def build_shot(
    name: str,
    span: Span,
    fps: Fraction,
    context: CutContext,
    media_start: Fraction,
    transitions: tuple[int, int] = (0, 0),
    *,
    is_drop_frame: bool = False,
) -> Shot:
    """Return the shot of a clip: its cut, handles, and time in the media.

    Args:
        name: Name of the shot.
        span: Media range of the clip.
        fps: Rate of the shot.
        context: Settings of the shot.
        media_start: Time of the media's first frame, in the clip's time codes [s].
        transitions: Frames shown by transitions before and after the cut.
        is_drop_frame: Whether time codes of the media are drop-frame.
    """
    handles, (cut_in, _) = context.handles, context.cut_in()
    frames_before, frames_after = transitions
    frame_count = frames_within(span.seconds, fps)
    media_in = span.begin - media_start
    if span.speed < 0:
        media_in -= (frame_count - 1) * span.speed / fps
    frame_count += frames_before + frames_after
    return Shot(
        cut_in,
        cut_in + frame_count - 1,
        handles,
        handles,
        name,
        fps,
        media_in - frames_before * span.speed / fps,
        span.speed,
        MediaTimecode(span.rate, media_start, is_drop_frame),
    )


def shot_notices(
    shot: Shot, span: Span, fps: Fraction, clip_text: str
) -> Iterator[tuple[str, str, Severity]]:
    """Yield notices about a shot: code, message and severity."""
    cut_frames = (shot.cut_in, shot.cut_out)
    begin_text, end_text = (
        f"{float(shot.seconds_at(frame)):.6g} s" for frame in cut_frames
    )
    if shot.speed == 0:
        message = f"{clip_text} freezes its media at {begin_text}; so does the shot"
        yield "BAT044", message, Severity.NOTE
    elif shot.speed < 0:
        range_text = f"from {begin_text} of its media to {end_text}"
        message = f"{clip_text} plays in reverse, {range_text}; so does the shot"
        yield "BAT044", message, Severity.WARNING
    shown_frames = float(span.seconds * fps)
    if span.seconds * fps < 1 - FRAME_TOLERANCE:
        message = (
            f"{clip_text} shows {shown_frames:.3g} of a frame; the shot has one frame"
        )
        yield "BAT043", message, Severity.WARNING


def media_values(shot: Shot, media_fps: Fraction) -> dict[str, str]:
    """Return the media frames that a cut shows, counted from 1, for use in patterns."""
    values = {"media_fps": str(media_fps)}
    for name, frame in (("media_first", shot.cut_in), ("media_last", shot.cut_out)):
        media_frame = shot.seconds_at(frame) * media_fps
        values[name] = str(floor(media_frame + FRAME_TOLERANCE) + 1)
    return values
