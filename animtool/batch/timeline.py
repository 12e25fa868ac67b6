"""Cut lists as editing systems write them, and what they say of media.

The parser of OpenTimelineIO has no bound on size, and ends the process where text
nests too deeply, or where it finds a mistake in the middle of an object.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from itertools import accumulate
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from zipfile import ZipFile

from animtool.documents.names import nearest
from animtool.errors import Fault, FormatError, OptionError, excerpt
from animtool.files import FileState, open_input
from animtool.rates import LARGEST_FRAME, parse_rate, rate_from_float

# A feature film with all its metadata takes a fifth [bytes].
MAX_BYTES = 100_000_000
# A stack in a stack takes three.
MAX_NESTING = 300
CONTENT = "content.otio"

_STRING = re.compile(rb'"(?:[^"\\]|\\.)*"', re.S)
_BRACKETS = b"[]{}"
_OTHERS = bytes(set(range(256)) - set(_BRACKETS))


def check_text(path: Path) -> None:
    """Refuse a timeline that is too large, nests too deeply, or is no file."""
    try:
        problem = _problem(path)
    except FormatError as error:
        raise FormatError(replace(error.faults[0], code="BAT041")) from error
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or excerpt(str(error), 200)
        problem = f"cannot be read as a timeline: {why}"
    if problem is not None:
        raise FormatError(Fault("BAT041", problem, str(path)))


def _problem(path: Path) -> str | None:
    kind = path.suffix.lower()
    if kind == ".otiod":
        path = path / CONTENT
    text = b"null"
    with open_input(path, None if kind == ".otioz" else MAX_BYTES) as file:
        if kind in {".otio", ".otiod"}:
            text = file.whole()
        elif kind == ".otioz":
            try:
                with ZipFile(file) as archive, archive.open(CONTENT) as content:
                    text = content.read(MAX_BYTES + 1)
            except MemoryError:
                raise
            except Exception as error:
                # Of archives that are damaged, the library raises almost anything.
                return f"cannot be read: {excerpt(str(error), 200)}"
        if len(text) > MAX_BYTES:
            return f"holds more than {MAX_BYTES // 1_000_000} MB"
    if nesting(text) > MAX_NESTING:
        return f"nests more than {MAX_NESTING} deep"
    json.loads(text.decode("utf-8"))
    return None


def nesting(text: bytes) -> int:
    """Return how deep JSON nests.

    >>> nesting(b'[{"a": "[[[", "b": [1]}, 2]')
    3
    """
    brackets = _STRING.sub(b"", text).translate(None, _OTHERS)
    return max(accumulate(1 if b in b"[{" else -1 for b in brackets), default=0)


@dataclass(frozen=True, slots=True)
class CutMetadata:
    """What is stated of shots; None is not stated."""

    start_frame: int | None = None  # first frame of the shot, that of its head handle
    handles: int | None = None  # shot frames before and after the cut
    fps: Fraction | None = None  # of a timeline: the rate of its shots


def cut_metadata(
    metadata: Mapping[str, Any], named: str, *, rate: bool = False
) -> tuple[CutMetadata, list[tuple[str, str]]]:
    """Return what metadata says, and what is wrong with it and what to do.

    >>> cut_metadata({"animtool": {"handles": 8.0}}, "clip 'a'")[0].handles
    8
    >>> cut_metadata({"animtool": {"handels": 8}}, "clip 'a'")[1]
    [("metadata.animtool of clip 'a' has no key 'handels'", "did you mean 'handles'?")]
    """
    given = metadata.get("animtool")
    if given is None:
        return CutMetadata(), []
    where = f"metadata.animtool of {named}"
    names = [f.name for f in fields(CutMetadata) if rate or f.name != "fps"]
    if not isinstance(given, Mapping):
        return CutMetadata(), [(f"{where} is not a table", f"keys: {', '.join(names)}")]
    values: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        if key not in names:
            faults.append((f"{where} has no key {excerpt(key)}", nearest(key, names)))
            continue
        try:
            values[key] = parse_rate(value) if key == "fps" else _whole(key, value)
        except (TypeError, ValueError) as error:
            hint = f"write a number such as {EXAMPLES[key]}"
            faults.append((f"{where}: {key}: {error}", hint))
    return CutMetadata(**values), faults


EXAMPLES = {"start_frame": "1001", "handles": "8", "fps": "24 or 24000/1001"}


def _whole(key: str, value: object) -> int:
    shown = excerpt(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{shown} is not a whole number")
    if abs(value) > LARGEST_FRAME or value != int(value):
        raise ValueError(f"{shown} is not a whole number up to {LARGEST_FRAME}")
    if key == "handles" and value < 0:
        raise ValueError(f"{shown} is below 0")
    return int(value)


# Times are floats in timelines: this near to a frame, it is meant [frame].
NEAR = Fraction(1, 1_000_000)
# Of parts of a frame; two rates that are used have a smaller one in common.
LARGEST_DENOMINATOR = 100_000
# What media has, with room: frames a second, and seconds since 1970.
LOWEST_RATE, HIGHEST_RATE = 0.001, 1e6
LONGEST = 10**12
FASTEST = 10**6
# Hosts of URLs that mean this one.
LOCAL = ("", "localhost")


def read_timeline(path: Path) -> Any:
    """Return a timeline as OpenTimelineIO has it."""
    try:
        import opentimelineio as otio
    except ModuleNotFoundError as error:
        message = "cut lists need the package OpenTimelineIO"
        hint = "pip install 'animtool[otio]'"
        raise OptionError(Fault("IO005", message, hint=hint)) from error
    check_text(path)
    try:
        timeline = otio.adapters.read_from_file(str(path))
    except MemoryError:
        raise
    except Exception as error:
        kind = type(error).__name__
        message = f"cannot be read as a timeline: {kind}: {excerpt(str(error), 200)}"
        known = sorted(otio.adapters.suffixes_with_defined_adapters(read=True))
        hint = f"there are adapters for {', '.join(known)}"
        raise FormatError(Fault("BAT041", message, str(path), (), hint)) from error
    if not isinstance(timeline, otio.schema.Timeline):
        message = f"is a {type(timeline).__name__}, and no timeline"
        raise FormatError(Fault("BAT041", message, str(path)))
    if timeline.tracks is None:
        raise FormatError(Fault("BAT041", "has no tracks", str(path)))
    return timeline


def media_path(url: str, folder: Path) -> Path:
    """Return the file of a URL, or of a path seen from a folder.

    Of an address of another machine it is a path of that name, which is not there.
    """
    # No system has it in a name.
    url = url.replace("\0", "%00")
    try:
        parts = urlsplit(url)
    except ValueError:
        return folder / url
    if parts.scheme == "file" and (parts.netloc in LOCAL or os.name == "nt"):
        # It imports much, and most timelines are not asked for.
        from urllib.request import url2pathname

        host = "" if parts.netloc in LOCAL else f"//{parts.netloc}"
        return Path(_named(url2pathname(host + parts.path)))
    if len(parts.scheme) > 1:
        return Path(url)
    there = FileState.of(folder / url) is not None
    return folder / (url if there else _named(unquote(url)))


def _named(path: str) -> str:
    return path.replace("\0", "%00")


def is_remote(clip: Any) -> bool:
    """Return whether the media of a clip has an address that is no path."""
    url = clip.media_reference.target_url
    return "://" in url.removeprefix("file:///")


def exact_rate(rate: float) -> Fraction:
    """Return the rate that a timeline states."""
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise ValueError(f"{rate!r} is no rate of frames")
    return rate_from_float(rate)


def seconds_of(time: Any) -> Fraction:
    """Return a time of a timeline, exact at its own rate [s]."""
    rate = exact_rate(time.rate)
    if not abs(time.value) <= LONGEST * rate:
        raise ValueError(f"{time.value!r} is no time at {float(rate):g} frames/s")
    exact = Fraction(time.value)
    whole = Fraction(round(exact))
    if abs(exact - whole) > NEAR:
        whole = exact.limit_denominator(LARGEST_DENOMINATOR)
    return whole / rate


def shown_span(clip: Any) -> tuple[Fraction, Fraction, Fraction]:
    """Return what a clip shows of its media.

    Returns time of its first frame, 0 at the media's first [s], how long it is shown
    [s], and frames a second of the media, as far as the timeline knows.
    """
    span = clip.trimmed_range()
    start, rate = seconds_of(span.start_time), span.start_time.rate
    if clip.media_reference.available_range is not None:
        there = clip.media_reference.available_range
        start -= seconds_of(there.start_time)
        rate = there.start_time.rate
    return start, seconds_of(span.duration), exact_rate(rate)


def picture_rates(composition: Any) -> Iterator[Fraction]:
    """Yield the rate of every clip and gap on tracks of pictures."""
    for child in composition:
        if hasattr(child, "find_children"):
            if getattr(child, "kind", "Video") == "Video":
                yield from picture_rates(child)
            continue
        span = getattr(child, "source_range", None)
        if span is not None and LOWEST_RATE <= span.start_time.rate <= HIGHEST_RATE:
            yield rate_from_float(span.start_time.rate)


def speed_of(clip: Any) -> Fraction:
    """Return how many times as fast as its media a clip plays."""
    speed = Fraction(1)
    for effect in clip.effects:
        scalar = float(getattr(effect, "time_scalar", 1.0))
        if not isfinite(scalar):
            return Fraction(0)
        speed *= Fraction(scalar).limit_denominator(LARGEST_DENOMINATOR)
        if abs(speed) > FASTEST:
            raise ValueError(f"it plays at {scalar:g} times its speed")
    return speed


def transition_sides(clip: Any) -> tuple[Any, Any]:
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
