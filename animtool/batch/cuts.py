"""Shots of an edit: the clips of an OpenTimelineIO timeline, and their media."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, floor
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from animtool.errors import Fault, FormatError, OptionError, Severity, excerpt
from animtool.files import FoundFile
from animtool.rates import rate_from_float
from animtool.scene.sources import source_stem

__all__ = ["SHOT_NAMES", "CutList", "Shot", "read_cuts"]

SHOT_NAMES = (
    "shot",
    "clip",
    "track",
    "first",
    "last",
    "head",
    "tail",
    "begin",
    "end",
    "handles",
    "fps",
    "speed",
)
# What names of files and of variables' users may hold everywhere.
_LEGAL = re.compile(r"[^A-Za-z0-9_-]+")
# Times are floats in timelines: this near to a frame, it is meant [frame].
_NEAR = 1e-4


@dataclass(frozen=True, slots=True)
class Shot:
    """A clip of a timeline.

    Attributes:
        found: Its media.
        names: What names stand for in its scene and its output, `SHOT_NAMES`.
    """

    found: FoundFile
    names: Mapping[str, str]


@dataclass(slots=True)
class CutList:
    """The shots of a timeline.

    Attributes:
        shots: In its order.
        notices: What was left out of it, or changed.
    """

    shots: list[Shot] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)


def read_cuts(
    path: Path,
    media: Sequence[FoundFile] = (),
    handles: int = 0,
    left_out: Callable[[Path], bool] = lambda _: False,
) -> CutList:
    """Return the shots of a timeline: the clips of its video tracks.

    A clip's media is the file that it refers to; one that refers to none, or to one
    that is not there, has that of ``media`` that is called like it, or like that file.

    Args:
        path: A file that OpenTimelineIO, or an adapter of it, reads.
        media: Where media is looked for that a clip does not lead to.
        handles: Frames wanted before and behind each cut.
        left_out: Whether media is not wanted.

    Raises:
        FormatError: It cannot be read (BAT041), or media is missing (BAT042).
        OptionError: OpenTimelineIO is missing (BAT040).
    """
    return _Reader(path, media, handles, left_out).read()


class _Reader:
    """Reads a timeline."""

    def __init__(
        self,
        path: Path,
        media: Sequence[FoundFile],
        handles: int,
        left_out: Callable[[Path], bool],
    ) -> None:
        self.path, self.handles, self.left_out = path, handles, left_out
        self.found = CutList()
        self.faults: list[Fault] = []
        self.taken: set[str] = set()
        self.gaps = 0
        self.media: dict[str, FoundFile] = {}
        for file in media:
            self.media.setdefault(source_stem(file.path).casefold(), file)

    def read(self) -> CutList:
        """Return its shots."""
        tracks = list(_opened(self.path).tracks)
        for number, track in enumerate(tracks, 1):
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
        if self.faults:
            raise FormatError(self.faults)
        return self.found

    def note(self, code: str, message: str, severity: Severity = Severity.NOTE) -> None:
        """Say something about the timeline."""
        fault = Fault(code, message, str(self.path), severity=severity)
        self.found.notices.append(fault)

    def track(self, track: Any, name: str) -> None:
        """Take the clips of a track, those of stacks and tracks in it too."""
        import opentimelineio as otio

        for child in track:
            if isinstance(child, otio.schema.Gap):
                self.gaps += 1
            elif isinstance(child, otio.schema.Clip):
                self.clip(child, name)
            elif isinstance(child, otio.core.Composition):
                where = f"{name}/{child.name}" if child.name else name
                self.note("BAT043", f"{where} is nested; its clips are shots, as whole")
                self.track(child, where)

    def clip(self, clip: Any, track: str) -> None:
        """Take a clip."""
        named = f"clip {excerpt(clip.name or '')} of {track}"
        found = self.medium(clip, named)
        if found is None:
            return
        try:
            start, count, length, rate = _span(clip)
        except Exception as error:
            message = f"{named} has no range: {excerpt(str(error), 120)}"
            self.faults.append(Fault("BAT041", message, str(self.path)))
            return
        speed = _speed(clip)
        if speed != 1:
            message = f"{named} plays at {speed:g} times its speed, which scenes can do"
            self.note("BAT044", message, Severity.WARNING)
        before, behind = self.overlaps(clip, named, rate)
        first = floor(start + _NEAR) + 1 - before
        last = max(first, ceil(start + count * abs(speed) - _NEAR) + behind)
        head, tail = self.reach(first, last, length, named)
        names = {
            "shot": self.name(clip.name or source_stem(found.path), named),
            "clip": clip.name or "",
            "track": track,
            "first": str(first),
            "last": str(last),
            "head": str(head),
            "tail": str(tail),
            "begin": str(first - head),
            "end": str(last + tail),
            "handles": str(self.handles),
            "fps": str(rate_from_float(rate)),
            "speed": f"{speed:g}",
        }
        self.found.shots.append(Shot(found, names))

    def reach(
        self, first: int, last: int, length: int | None, named: str
    ) -> tuple[int, int]:
        """Return how many frames of the handles there are on both sides."""
        if length is None:
            return self.handles, self.handles
        if not 1 <= first <= last <= length:
            message = f"{named} shows frames {first} to {last} of 1 to {length}"
            self.note("BAT045", message, Severity.WARNING)
        head = max(0, min(self.handles, first - 1))
        tail = max(0, min(self.handles, length - last))
        if head + tail < 2 * self.handles:
            message = f"{named} has handles of {head} and {tail} frames only"
            self.note("BAT045", message, Severity.WARNING)
        return head, tail

    def medium(self, clip: Any, named: str) -> FoundFile | None:
        """Return the media of a clip; None where it has none, or it is missing."""
        url = getattr(clip.media_reference, "target_url", None)
        path = None if not url else _path(str(url), self.path.parent)
        if path is not None and self.left_out(path):
            self.note("BAT043", f"{named} is left out, as asked: {path}")
            return None
        if path is not None and path.exists():
            return FoundFile(path, path.parent)
        for stem in (clip.name, None if path is None else source_stem(path)):
            if stem and stem.casefold() in self.media:
                return self.media[stem.casefold()]
        if path is not None:
            hint = "give the folder that has it, or one of the clip's name, as INPUT"
            message = f"the media of {named} is not there: {path}"
            self.faults.append(Fault("BAT042", message, str(self.path), hint=hint))
        elif self.media:
            message = f"no media is called like {named}"
            self.faults.append(Fault("BAT042", message, str(self.path)))
        else:
            message = f"{named} is left out: it refers to no media"
            self.note("BAT043", message, Severity.WARNING)
        return None

    def overlaps(self, clip: Any, named: str, rate: float) -> tuple[int, int]:
        """Return the frames that transitions show before and behind a clip's cut."""
        spent = [
            0 if side is None else ceil(side.rescaled_to(rate).value - _NEAR)
            for side in _sides(clip)
        ]
        if any(spent):
            more = f"{spent[0]} frames before its cut and {spent[1]} behind it"
            self.note("BAT043", f"{named} is in transitions: {more} are taken too")
        return spent[0], spent[1]

    def name(self, wanted: str, named: str) -> str:
        """Return a name that is legal, and of no shot before."""
        legal = _LEGAL.sub("_", wanted).strip("_-") or "shot"
        name, number = legal, 1
        while name.casefold() in self.taken:
            number += 1
            name = f"{legal}_{number}"
        self.taken.add(name.casefold())
        if name != wanted:
            self.note("BAT046", f"{named} is the shot {name}")
        return name


def _opened(path: Path) -> Any:
    try:
        import opentimelineio as otio
    except ModuleNotFoundError as error:
        message = "cut lists need the package OpenTimelineIO"
        hint = "pip install 'animtool[otio]'"
        raise OptionError(Fault("BAT040", message, hint=hint)) from error
    from animtool.inputs import note_input

    note_input(path)
    try:
        found = otio.adapters.read_from_file(str(path))
    except Exception as error:
        kind = type(error).__name__
        message = f"cannot be read as a timeline: {kind}: {excerpt(str(error), 200)}"
        known = ", ".join(otio.adapters.suffixes_with_defined_adapters(read=True))
        hint = f"there are adapters for {known}"
        raise FormatError(Fault("BAT041", message, str(path), (), hint)) from error
    if not isinstance(found, otio.schema.Timeline):
        message = f"is a {type(found).__name__}, and no timeline"
        raise FormatError(Fault("BAT041", message, str(path)))
    return found


def _path(url: str, folder: Path) -> Path:
    """Return the file of a URL, or of a path seen from a folder."""
    parts = urlsplit(url)
    if parts.scheme == "file":
        # It imports much, and most timelines are not asked for.
        from urllib.request import url2pathname

        return Path(url2pathname(parts.path))
    if len(parts.scheme) > 1:
        return Path(url)
    return folder / (url if (folder / url).exists() else unquote(url))


def _span(clip: Any) -> tuple[float, float, int | None, float]:
    """Return what a clip shows of its media.

    Returns:
        First frame, from 0 at the first of the media, frames, frames of the media,
        None where it does not say, and their rate [1/s].
    """
    span = clip.trimmed_range()
    rate, start, length = span.start_time.rate, span.start_time, None
    if clip.media_reference.available_range is not None:
        there = clip.media_reference.available_range
        start -= there.start_time
        length = floor(there.duration.rescaled_to(rate).value + _NEAR)
    return start.rescaled_to(rate).value, span.duration.value, length, rate


def _speed(clip: Any) -> float:
    """Return how many times as fast as its media a clip plays."""
    speed = 1.0
    for effect in clip.effects:
        speed *= float(getattr(effect, "time_scalar", 1.0))
    return speed


def _sides(clip: Any) -> tuple[Any, Any]:
    """Return how far transitions reach beyond the cuts of a clip; None for none."""
    import opentimelineio as otio

    kind = otio.schema.Transition
    track = clip.parent()
    if not isinstance(track, otio.schema.Track):
        return None, None
    before, behind = track.neighbors_of(clip)
    return (
        before.in_offset if isinstance(before, kind) else None,
        behind.out_offset if isinstance(behind, kind) else None,
    )
