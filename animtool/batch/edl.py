"""Edit decision lists (CMX 3600), converted to timelines with a frame rate.

References:
    CMX 3600 edit decision lists; the channels, effects and comments that Avid, Premiere
    and Resolve write into them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import field
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from typing import Any

from animtool.batch.timeline import check_timeline_file
from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, excerpt
from animtool.core.files.reading import read_input
from animtool.core.rates import parse_rate, rate_label
from animtool.core.record import dataclass
from animtool.core.timecode import nominal_rate, parse_timecode

# Maximum size [bytes]; a feature film with all comments has a hundredth of it.
MAX_EDL_BYTES = 100_000_000
MAX_FAULTS = 100
MAX_FRAME_NUMBER = 10**9
# Reel names that mean black and bars.
BLACK_REELS = {"BL", "BLACK", "BARS"}
UNKNOWN_REEL = "AX"
_TIME_PATTERN = r"\d{1,2}:\d\d:\d\d[:;,.]\d\d+|\d+"
_EVENT_LINE = re.compile(
    r"(?P<number>\d+)\w?\s+(?P<reel>\S+)\s+(?P<channel>\S+)\s+(?P<edit>[A-Z]+\d*)\s+"
    rf"(?:(?P<length>\d+)\s+)?(?P<times>(?:(?:{_TIME_PATTERN})\s+){{3}}(?:{_TIME_PATTERN}))\s*",
    re.IGNORECASE,
)
_SPEED_LINE = re.compile(
    r"M2\s+.*?\s*(?P<speed>[-+]?\d+(?:\.\d+)?)\s+\d\d:\d\d:\d\d\S*\s*"
)
_RATE_LINE = re.compile(r"\*?\s*(?:FPS|FRAME\s?RATE)\s*[:=]?\s*(?P<rate>[\d./]+)", re.I)
_COMMENT_PATTERNS = {
    name: re.compile(rf"\*?\s*{text}\s*:\s*(?P<value>.*\S)", re.I)
    for name, text in (
        ("name", "FROM CLIP NAME"),
        ("to", "TO CLIP NAME"),
        ("file", "(?:FROM CLIP|FROM FILE|SOURCE FILE)"),
    )
}
_FREEZE_COMMENT = re.compile(r"\*\s*\*?\s*FREEZE FRAME", re.I)


@dataclass(slots=True)
class Event:
    """An event of an EDL, as unparsed text."""

    line: int
    number: str
    reel: str
    channel: str
    edit_type: str  # C for a cut, D a dissolve, W a wipe, K a key
    length: int  # length of a transition [frame]
    times: tuple[str, str, str, str]  # source in and out, record in and out
    speed: str | None = None  # of M2: source frames per second
    is_freeze_frame: bool = False
    comments: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class Edl:
    """The events of an EDL; the rate may be unknown."""

    path: Path
    title: str = ""
    events: list[Event] = field(default_factory=list)
    fps: Fraction | None = None  # stated by comments

    @property
    def has_drop_frame(self) -> bool:
        """Whether any time code is a drop-frame time code."""
        return any(";" in time for event in self.events for time in event.times)

    @property
    def is_all_drop_frame(self) -> bool:
        """Whether all time codes are drop-frame."""
        times = (time for event in self.events for time in event.times)
        return self.has_drop_frame and all(";" in time for time in times)

    @property
    def max_frame_label(self) -> int:
        """The highest frame number within a second among all time codes."""
        times = (time for event in self.events for time in event.times if ":" in time)
        return max((int(re.split("[:;]", time)[3]) for time in times), default=0)


def read_edl(path: Path) -> Edl:
    """Read the events of an EDL; drop-frame time codes get semicolons."""
    check_timeline_file(path)
    text = read_input(path, MAX_EDL_BYTES).decode("utf-8-sig", "replace")
    edl, is_drop_frame, is_edl = Edl(path), False, not text.strip()
    faults = []
    for line_number, raw_line in enumerate(text.splitlines(), 1):
        line = raw_line.strip()
        if line.startswith("TITLE:"):
            edl.title, is_edl = line[6:].strip(), True
        elif line.startswith("FCM"):
            is_drop_frame = "NON" not in line.upper() and "DROP" in line.upper()
            is_edl = True
        elif line[:1].isdigit():
            event_match = _EVENT_LINE.fullmatch(line)
            if event_match is None:
                message = f"{excerpt(line)} is not an EDL event"
                faults.append(Fault("BAT041", message, str(path), (line_number,)))
            else:
                edl.events.append(
                    _parse_event(event_match, line_number, is_drop_frame=is_drop_frame)
                )
        elif (
            stated_rate := _RATE_LINE.fullmatch(line)
        ) is not None and edl.fps is None:
            with suppress(ValueError):
                edl.fps = parse_rate(stated_rate["rate"])
        elif edl.events:
            _apply_comment(edl.events[-1], line)
    if not is_edl and not edl.events and not faults:
        faults.append(Fault("BAT041", "contains no EDL event", str(path), (1,)))
    if faults:
        raise FormatError(faults[:MAX_FAULTS])
    return edl


def _parse_event(match: re.Match[str], line: int, *, is_drop_frame: bool) -> Event:
    times = [re.sub("[,.]", ";", time) for time in match["times"].split()]
    if is_drop_frame:
        times = [re.sub(r":(\d+)$", r";\1", time) for time in times]
    source_in, source_out, record_in, record_out = (
        f"0{t}" if t[1:2] == ":" else t for t in times
    )
    return Event(
        line,
        match["number"].lstrip("0"),
        match["reel"],
        match["channel"].upper(),
        match["edit"].upper(),
        min(int(match["length"] or 0), MAX_FRAME_NUMBER),
        (source_in, source_out, record_in, record_out),
    )


def _apply_comment(event: Event, line: str) -> None:
    """Set the speed, the freeze frame or a name of an event from a comment line."""
    if (speed := _SPEED_LINE.fullmatch(line)) is not None:
        event.speed = speed["speed"]
    elif _FREEZE_COMMENT.match(line) is not None:
        event.is_freeze_frame = True
    for name, pattern in _COMMENT_PATTERNS.items():
        if (match := pattern.fullmatch(line)) is not None:
            event.comments.setdefault(name, match["value"])
            return


@dataclass(frozen=True, slots=True)
class _EventTimes:
    """Source and record times of an event [frame]."""

    source_start: int
    source_count: int
    record_start: int
    record_count: int


class TimelineBuilder:
    """Builds an OpenTimelineIO timeline of an EDL at a frame rate."""

    def __init__(self, edl: Edl, fps: Fraction) -> None:
        import opentimelineio as otio

        self.otio, self.edl, self.fps = otio, edl, fps
        self.tracks: dict[str, Any] = {}
        self.end_by_track: dict[str, int] = {}  # ends of tracks, in record frames
        self.notices: list[Fault] = []
        self.faults: list[Fault] = []

    def build(self) -> tuple[Any, list[Fault]]:
        """Return the timeline of all events, and notices; raise all faults together."""
        timeline = self.otio.schema.Timeline(self.edl.title)
        for event, belongs_to_next in _with_continuation(self.edl.events):
            times = self.event_times(event)
            if times is not None:
                self.add_event(timeline, event, times, belongs_to_next)
        if self.faults:
            raise FormatError(self.faults[:MAX_FAULTS])
        return timeline, self.notices

    def event_times(self, event: Event) -> _EventTimes | None:
        """Return the times of an event, or None after recording a fault."""
        try:
            frames = [self.parse_frame(text) for text in event.times]
        except ValueError as error:
            message = f"{error}, at {rate_label(self.fps)}"
            hint = "set the rate that its time codes count, such as "
            hint += argument("fps", "30000/1001")
            location = str(self.edl.path), (event.line,)
            self.faults.append(Fault("BAT041", message, *location, hint))
            return None
        # For backward motion some systems write the last frame first.
        source_start, source_end = (
            sorted(frames[:2]) if _event_speed(event) < 0 else frames[:2]
        )
        return _EventTimes(
            source_start, source_end - source_start, frames[2], frames[3] - frames[2]
        )

    def parse_frame(self, text: str) -> int:
        """Return the frame number of a time code, or of a text that is one."""
        if ":" not in text:
            if len(text) > len(str(MAX_FRAME_NUMBER)):
                raise ValueError(f"{excerpt(text)} is not a frame")
            return int(text)
        return int(parse_timecode(text, self.fps))

    def add_event(
        self, timeline: Any, event: Event, times: _EventTimes, belongs_to_next: bool
    ) -> None:
        """Add the clip of an event to all its tracks."""
        schema = self.otio.schema
        for name in TRACKS_OF_CHANNEL.get(event.channel, (event.channel,)):
            if name not in self.tracks:
                kind = "Audio" if name.startswith("A") else "Video"
                self.tracks[name] = schema.Track(name, kind=kind)
                timeline.tracks.append(self.tracks[name])
            track = self.tracks[name]
            gap_frames = times.record_start - self.end_by_track.get(
                name, times.record_start
            )
            if gap_frames > 0 and len(track):
                track.append(schema.Gap(source_range=self.time_range(0, gap_frames)))
            shown_frames = max(times.record_count, 0) or times.source_count
            self.end_by_track[name] = times.record_start + shown_frames
            if event.edit_type != "C" and event.length and len(track):
                track.append(self.make_transition(event))
            if event.reel.upper() in BLACK_REELS:
                if shown_frames:
                    track.append(
                        schema.Gap(source_range=self.time_range(0, shown_frames))
                    )
            elif not (belongs_to_next and times.source_count <= 0):
                track.append(self.make_clip(event, times))

    def make_transition(self, event: Event) -> Any:
        """Return the dissolve of an event, which begins with the incoming clip."""
        offsets = self.time_range(0, event.length)
        return self.otio.schema.Transition(
            event.edit_type, "SMPTE_Dissolve", offsets.start_time, offsets.duration
        )

    def make_clip(self, event: Event, times: _EventTimes) -> Any:
        """Return the clip of an event with its speed."""
        schema, comments = self.otio.schema, event.comments
        url = comments.get("file")
        name = comments.get("name")
        if event.edit_type != "C":
            name = comments.get("to") or name
        if name is None:
            reel = "" if event.reel.upper() == UNKNOWN_REEL else event.reel
            stem = None if url is None else PurePosixPath(url.replace("\\", "/")).stem
            name = stem or reel or event.number
        reference = None if url is None else schema.ExternalReference(url)
        speed, frame_count = self.speed_and_length(event, times, name)
        clip = schema.Clip(
            name, reference, self.time_range(times.source_start, frame_count)
        )
        if speed != 1:
            clip.effects.append(schema.LinearTimeWarp(time_scalar=float(speed)))
        return clip

    def speed_and_length(
        self, event: Event, times: _EventTimes, name: str
    ) -> tuple[Fraction, int]:
        """Return the speed of an event and its number of frames."""
        source_frames = max(times.source_count, 0)
        record_frames = max(times.record_count, 0)
        if event.is_freeze_frame:
            return Fraction(0), record_frames or source_frames
        if event.speed is not None:
            playback_speed = _event_speed(event) / nominal_rate(self.fps)
            if not record_frames or not source_frames:
                return playback_speed, record_frames or source_frames
            # The printed speed has a tenth of a frame; source and record are exact.
            exact_speed = Fraction(source_frames, record_frames)
            rounding_error = abs(exact_speed - abs(playback_speed)) * nominal_rate(
                self.fps
            )
            if playback_speed and rounding_error <= Fraction(1, 10):
                playback_speed = exact_speed if playback_speed > 0 else -exact_speed
            return playback_speed, record_frames
        if record_frames and source_frames and record_frames != source_frames:
            message = f"clip {excerpt(name)}: its source has {source_frames} frames, "
            message += f"its record {record_frames}, and no speed (M2) is stated: the "
            message += (
                f"{source_frames} frames of its source are used, at their own speed"
            )
            location = str(self.edl.path), (event.line,)
            self.notices.append(
                Fault("BAT056", message, *location, severity=Severity.WARNING)
            )
        return Fraction(1), source_frames

    def time_range(self, first_frame: int, frame_count: int) -> Any:
        """Return an OpenTimelineIO range of frames at the rate of the EDL."""
        rational_time, rate = self.otio.opentime.RationalTime, float(self.fps)
        return self.otio.opentime.TimeRange(
            rational_time(first_frame, rate), rational_time(frame_count, rate)
        )


def _event_speed(event: Event) -> Fraction:
    return Fraction(1) if event.speed is None else Fraction(event.speed)


def _with_continuation(events: Sequence[Event]) -> Iterator[tuple[Event, bool]]:
    """Yield events, and whether the next one belongs to the same edit.

    Comments follow the second event and belong to both.
    """
    for event, next_event in zip_longest(events, events[1:]):
        next_edit = (
            None if next_event is None else (next_event.number, next_event.channel)
        )
        is_continued = next_edit == (event.number, event.channel)
        if is_continued:
            event.comments = {**next_event.comments, **event.comments}
        yield event, is_continued


# Channels that mean several tracks.
TRACKS_OF_CHANNEL = {
    "B": ("V", "A1"),
    "AA": ("A1", "A2"),
    "A": ("A1",),
    "A2/V": ("V", "A2"),
    "AA/V": ("V", "A1", "A2"),
}
