"""Shots of an edit: the clips of an OpenTimelineIO timeline, and their media."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, floor
from pathlib import Path
from typing import Any

from animtool.batch.timeline import (
    NEAR,
    CutMetadata,
    cut_metadata,
    exact_rate,
    is_remote,
    media_path,
    picture_rates,
    read_timeline,
    seconds_of,
    shown_span,
    speed_of,
    transition_sides,
)
from animtool.config import find_config
from animtool.documents.names import nearest
from animtool.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    excerpt,
    listed,
)
from animtool.files import MatchedFile
from animtool.rates import rate_label
from animtool.scene.sources import source_stem
from animtool.shot import SHOT_START, Shot, frames_within

SHOT_NAMES = (
    *("shot", "clip", "track", "first", "last", "begin", "end", "head", "tail"),
    *("handles", "fps", "speed", "media_in", "media_out", "media_first"),
    *("media_last", "media_fps"),
)
# What names of files and of variables' users may hold everywhere.
# What a person reads of a timeline of thousands of clips.
MAX_FAULTS, MAX_NAMED = 100, 100
# With what else a file's name has, within what disks allow.
MAX_NAME = 120
_LEGAL = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class CutOptions:
    """What a timeline's shots have that its metadata need not say.

    Attributes:
        handles: Shot frames before and after each cut; None is as clips and timeline
            say, else 0.
        start: First frame of each shot; None is as clips and timeline say, else the
            project's, else 1001.
        fps: Rate of the shots where the timeline states none.
    """

    handles: int | None = None
    start: int | None = None
    fps: Fraction | None = None


@dataclass(frozen=True, slots=True)
class Cut:
    """What an item is made of: a clip of a timeline, or a file."""

    media: MatchedFile  # the media
    # What names stand for in its scene and its output, `SHOT_NAMES`.
    names: Mapping[str, str] = field(default_factory=dict)
    # The clip's frames; None for a file that no timeline shows.
    shot: Shot | None = None


@dataclass(slots=True)
class CutList:
    """The shots of a timeline."""

    shots: list[Cut] = field(default_factory=list)  # in its order
    # What was left out of it, or changed.
    notices: list[Fault] = field(default_factory=list)


def read_cuts(
    path: Path,
    media: Sequence[MatchedFile] = (),
    options: CutOptions | None = None,
    left_out: Callable[[Path], bool] = lambda _: False,
) -> CutList:
    """Return the shots of a timeline: the clips of its video tracks.

    A clip's media is the file that it refers to; one that refers to none, or to one
    that is not there, has that of ``media`` that is called like it, or like that file.
    Its times are seconds of the media; a shot counts frames at the timeline's rate.
    """
    return _Reader(path, media, options or CutOptions(), left_out).read()


def read_cut(path: Path, name: str | None, options: CutOptions) -> CutList:
    """Return the shot of a name, or the only one (else BAT048); see `read_cuts`."""
    return _Reader(path, (), options).read(lambda found: _named(found, name, path))


def _named(entries: Sequence[_Entry], name: str | None, path: Path) -> list[_Entry]:
    """Return the clip that is the shot of a name; without one the only clip."""
    names = [entry.name for entry in entries]
    if not names:
        message = "has no clip, so there is no shot to bake"
        raise OptionError(Fault("BAT048", message, str(path)))
    shots = f"the shots are {listed(names, MAX_NAMED)}"
    if name is None:
        if len(names) == 1:
            return list(entries)
        message = f"has {counted(len(names), 'shot')}: name one with --shot"
        raise OptionError(Fault("BAT048", message, str(path), (), shots))
    if name not in names:
        near = nearest(name, names)
        hint = f"{near} {shots}" if near.startswith("did") else shots
        message = f"has no shot {excerpt(name)}"
        raise OptionError(Fault("BAT048", message, str(path), (), hint))
    return [entry for entry in entries if entry.name == name]


@dataclass(frozen=True, slots=True)
class _Entry:
    """A clip on a track."""

    clip: Any
    track: str  # name of the track
    named: str  # what the clip is called in messages
    name: str  # of its shot


class _Reader:
    """Reads a timeline."""

    def __init__(
        self,
        path: Path,
        media: Sequence[MatchedFile],
        options: CutOptions,
        left_out: Callable[[Path], bool] = lambda _: False,
    ) -> None:
        self.path, self.options, self.left_out = path, options, left_out
        self.cuts = CutList()
        self.entries: list[_Entry] = []
        self.faults: list[Fault] = []
        # Names of shots, and up to which number each has others behind it.
        self.taken: dict[str, int] = {}
        self.gaps = 0
        self.own = CutMetadata()
        self.fps = Fraction(24)
        self.media: dict[str, MatchedFile] = {}
        for file in media:
            self.media.setdefault(source_stem(file.path).casefold(), file)

    def read(
        self, choose: Callable[[Sequence[_Entry]], Sequence[_Entry]] = list
    ) -> CutList:
        """Return its shots, or those of the clips that are chosen."""
        timeline = read_timeline(self.path)
        self.own = self.metadata(timeline, "the timeline", rate=True)
        self.fps = self.rate(timeline)
        for number, track in enumerate(timeline.tracks, 1):
            name, kind = (
                track.name or f"track {number}",
                getattr(track, "kind", "Video"),
            )
            if kind == "Video":
                self.track(track, name)
            else:
                self.note("BAT043", f"{name}, of {kind}, is left out")
        if self.gaps:
            self.note("BAT043", f"left out gaps: {self.gaps}")
        for entry in choose(self.entries):
            self.clip(entry)
        if len(self.faults) > MAX_FAULTS:
            rest = f"{len(self.faults) - MAX_FAULTS} more faults are not shown"
            rest_fault = Fault("DOC011", rest, str(self.path))
            self.faults[MAX_FAULTS:] = [rest_fault]
        if self.faults:
            raise FormatError(self.faults)
        return self.cuts

    def note(self, code: str, message: str, severity: Severity = Severity.NOTE) -> None:
        """Say something about the timeline."""
        fault = Fault(code, message, str(self.path), severity=severity)
        self.cuts.notices.append(fault)

    def fault(self, code: str, message: str, hint: str | None = None) -> None:
        """Say what makes the timeline unusable."""
        self.faults.append(Fault(code, message, str(self.path), (), hint))

    def metadata(self, schema: Any, named: str, *, rate: bool = False) -> CutMetadata:
        """Return what ``metadata.animtool`` of a clip or the timeline says."""
        metadata, faults = cut_metadata(schema.metadata, named, rate=rate)
        for message, hint in faults:
            self.fault("BAT047", message, hint)
        return metadata

    def rate(self, timeline: Any) -> Fraction:
        """Return the rate of its shots: stated, asked for, or that of most clips."""
        stated = self.own.fps
        begin = timeline.global_start_time
        if stated is None and begin is not None and begin.rate > 0:
            try:
                stated = exact_rate(begin.rate)
            except ValueError as error:
                self.fault("BAT041", f"its global start time: {error}")
                return self.fps
        asked = self.options.fps
        if stated is not None:
            if asked not in {None, stated}:
                assert asked is not None
                message = f"has {rate_label(stated)}, and {rate_label(asked)} is asked"
                hint = "shots are written at the rate of their timeline"
                raise OptionError(Fault("BAT051", message, str(self.path), (), hint))
            return stated
        if asked is not None:
            return asked
        rates = Counter(picture_rates(timeline.tracks))
        if not rates:
            return self.fps
        chosen = rates.most_common(1)[0][0]
        if len(rates) > 1:
            message = "states no rate, and its clips have several: "
            message += f"{rate_label(chosen)}, that of most, is taken"
            self.note("BAT049", message)
        return chosen

    def track(self, track: Any, name: str) -> None:
        """Take the clips of a track, those of stacks and tracks in it too."""
        import opentimelineio as otio

        for child in track:
            if isinstance(child, otio.schema.Gap):
                self.gaps += 1
            elif isinstance(child, otio.schema.Clip):
                self.entries.append(self.entry(child, name))
            elif isinstance(child, otio.core.Composition):
                where = f"{name}/{child.name}" if child.name else name
                self.note("BAT043", f"{where} is nested; its clips are shots, as whole")
                self.track(child, where)

    def entry(self, clip: Any, track: str) -> _Entry:
        """Return a clip with the name of its shot."""
        named = f"clip {excerpt(clip.name or '')} of {track}"
        path = self.referred(clip)
        name = clip.name or ("" if path is None else source_stem(path))
        return _Entry(clip, track, named, self.name(name, named))

    def clip(self, entry: _Entry) -> None:
        """Take a clip."""
        # It imports numpy, and a batch of files is planned without.
        from animtool.clock import MAX_FRAMES

        clip, named = entry.clip, entry.named
        medium = self.medium(clip, named)
        if medium is None:
            return
        try:
            start, seconds, media_fps = shown_span(clip)
            transitions = self.overlaps(clip, named)
            speed = speed_of(clip)
        except Exception as error:
            message = f"the range of {named} cannot be used: {excerpt(str(error), 120)}"
            self.fault("BAT041", message)
            return
        if seconds <= 0:
            self.fault("BAT041", f"{named} shows no frame of its media")
            return
        shot = self.shot(entry, start, seconds, transitions, speed)
        if shot.speed <= 0:
            message = f"{named} plays at {float(shot.speed):g} times its speed"
            hint = "only forward motion is baked: render the clip's media as it plays, "
            hint += f"or leave it out with --exclude {medium.path}"
            self.fault("BAT044", message, hint)
            return
        if shot.end - shot.start >= MAX_FRAMES:
            message = f"{named} has too many frames: {shot.end - shot.start + 1}"
            self.fault("BAT041", message, f"a shot has up to {MAX_FRAMES}")
            return
        names = {
            "shot": shot.name,
            "clip": clip.name or "",
            "track": entry.track,
            **shot.names(),
            **_media_names(shot, media_fps),
        }
        self.cuts.shots.append(Cut(medium, names, shot))

    def shot(
        self,
        entry: _Entry,
        start: Fraction,
        seconds: Fraction,
        transitions: tuple[int, int],
        speed: Fraction,
    ) -> Shot:
        """Return the frames of a clip: ``start`` [s], ``seconds`` [s]."""
        own, given = self.metadata(entry.clip, entry.named), self.options
        handles = _first(given.handles, own.handles, self.own.handles, 0)
        begin = _first(given.start, own.start_frame, self.own.start_frame, self.project)
        before, after = transitions
        count = frames_within(seconds, self.fps) + before + after
        return Shot(
            begin + handles,
            begin + handles + count - 1,
            handles,
            handles,
            entry.name,
            self.fps,
            start - before * speed / self.fps,
            speed,
        )

    @property
    def project(self) -> int:
        """First frame of a shot where the timeline states none."""
        start = find_config(self.path).start
        return SHOT_START if start is None else int(start)

    def referred(self, clip: Any) -> Path | None:
        """Return the file that a clip refers to, which may be missing."""
        url = getattr(clip.media_reference, "target_url", None)
        return None if not url else media_path(str(url), self.path.parent)

    def medium(self, clip: Any, named: str) -> MatchedFile | None:
        """Return the media of a clip; None where it has none, or it is missing."""
        path = self.referred(clip)
        if path is not None and self.left_out(path):
            self.note("BAT043", f"{named} is left out, as asked: {path}")
            return None
        if path is not None and _is_file(path):
            return MatchedFile(path, path.parent)
        for stem in (clip.name, None if path is None else source_stem(path)):
            if stem and stem.casefold() in self.media:
                return self.media[stem.casefold()]
        if path is not None:
            hint = "give the folder that has it, or one of the clip's name, as INPUT"
            problem = "a folder" if _is_file(path) is False else "not there"
            shown = clip.media_reference.target_url if is_remote(clip) else path
            self.fault("BAT042", f"the media of {named} is {problem}: {shown}", hint)
        elif self.media:
            self.fault("BAT042", f"no media is called like {named}")
        else:
            message = f"{named} is left out: it refers to no media"
            self.note("BAT043", message, Severity.WARNING)
        return None

    def overlaps(self, clip: Any, named: str) -> tuple[int, int]:
        """Return the frames that transitions show before and after a clip's cut."""
        before, after = (
            0 if side is None else ceil(seconds_of(side) * self.fps - NEAR)
            for side in transition_sides(clip)
        )
        if before or after:
            more = f"{before} frames before its cut and {after} after it"
            self.note("BAT043", f"{named} is in transitions: {more} are taken too")
        return before, after

    def name(self, shot: str, named: str) -> str:
        """Return a name that is legal, and of no shot before."""
        legal = _LEGAL.sub("_", shot).strip("_-")[:MAX_NAME] or "shot"
        name, number = legal, self.taken.get(legal.casefold(), 1)
        while name.casefold() in self.taken:
            number += 1
            name = f"{legal}_{number}"
        self.taken[name.casefold()] = 1
        self.taken[legal.casefold()] = number
        if name != shot:
            self.note("BAT046", f"{named} is the shot {name}")
        return name


def _is_file(path: Path) -> bool | None:
    """Return whether a path is that of a file; None where nothing is there."""
    try:
        return path.is_file() or (False if path.exists() else None)
    except (OSError, ValueError):
        # A name that no disk can have.
        return None


def _first(*start: int | None) -> int:
    """Return the first that is stated."""
    return next(value for value in start if value is not None)


def _media_names(shot: Shot, media_fps: Fraction) -> dict[str, str]:
    """Return the frames of its media that a cut shows, from 1 at the first."""
    shown = (shot.seconds_at(frame) for frame in (shot.cut_in, shot.cut_out))
    first, last = (floor(seconds * media_fps + NEAR) + 1 for seconds in shown)
    return {
        "media_first": str(first),
        "media_last": str(last),
        "media_fps": str(media_fps),
    }
