"""Cut lists of editing systems, checked and read as timelines.

The parser of OpenTimelineIO has no size limit, and crashes the process on deeply nested
text or on errors inside an object.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from zipfile import ZipFile

from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.files.reading import FileState, open_input
from animtool.core.json_problems import json_problem
from animtool.core.rates import rate_from_float

# Maximum size; a feature film with all metadata has a fifth [bytes].
MAX_TIMELINE_BYTES = 100_000_000
# Nested stacks use three levels each.
MAX_NESTING_DEPTH = 300
TIMELINE_IN_BUNDLE = "content.otio"

_JSON_STRING = re.compile(rb'"(?:[^"\\]|\\.)*"', re.S)
# Non-finite numbers, which the library writes and reads.
_NON_FINITE_NUMBER = re.compile(_JSON_STRING.pattern + rb"|-?\bInf\b|-NaN\b", re.S)
_BRACKET_BYTES = b"[]{}"
_NO_BRACKETS = bytes(set(range(256)) - set(_BRACKET_BYTES))


def check_timeline_file(path: Path) -> None:
    """Raise an error for a timeline that is too large, deeply nested or not a file."""
    try:
        problem = _text_problem(path)
    except FormatError as error:
        raise FormatError(replace(error.faults[0], code="BAT041")) from error
    except json.JSONDecodeError as error:
        syntax = json_problem(error)
        hint = syntax.repair or "copy or export the timeline again"
        fault = Fault("BAT041", syntax.message, str(path), hint=hint)
        if path.suffix.lower() == ".otioz":
            fault = replace(fault, hint="export the timeline again")
        else:
            fault = replace(fault, lines=(syntax.line,), column=syntax.column)
        raise FormatError(fault) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or excerpt(str(error), 200)
        problem = f"cannot be read as a timeline: {reason}"
    if problem is not None:
        raise FormatError(Fault("BAT041", problem, str(path)))


def _text_problem(path: Path) -> str | None:
    suffix = path.suffix.lower()
    if suffix == ".otiod":
        path = path / TIMELINE_IN_BUNDLE
    text = b"null"
    with open_input(path, None if suffix == ".otioz" else MAX_TIMELINE_BYTES) as file:
        if suffix in {".otio", ".otiod"}:
            text = file.read_all()
        elif suffix == ".otioz":
            try:
                with (
                    ZipFile(file) as archive,
                    archive.open(TIMELINE_IN_BUNDLE) as content,
                ):
                    text = content.read(MAX_TIMELINE_BYTES + 1)
            except MemoryError:
                raise
            except Exception as error:
                # For damaged archives, the library raises almost anything.
                return f"cannot be read: {excerpt(str(error), 200)}"
        if len(text) > MAX_TIMELINE_BYTES:
            return f"is larger than {MAX_TIMELINE_BYTES // 1_000_000} MB"
    if nesting_depth(text) > MAX_NESTING_DEPTH:
        return f"is nested more than {MAX_NESTING_DEPTH} levels deep"
    if b"Inf" in text or b"-NaN" in text:
        text = _NON_FINITE_NUMBER.sub(
            lambda match: match[0] if match[0].startswith(b'"') else b"0", text
        )
    json.loads(text.decode("utf-8"))
    return None


def nesting_depth(text: bytes) -> int:
    """Return how deep brackets are nested in JSON text, without parsing it.

    >>> nesting_depth(b'[{"a": "[[[", "b": [1]}, 2]')
    3
    """
    brackets = _JSON_STRING.sub(b"", text).translate(None, _NO_BRACKETS)
    return max(
        accumulate(1 if bracket in b"[{" else -1 for bracket in brackets), default=0
    )


# Times in timelines are floats: a time this near to a frame is that frame [frame].
FRAME_TOLERANCE = Fraction(1, 1_000_000)
# Largest denominator of frame fractions; common rates share a smaller one.
MAX_DENOMINATOR = 100_000
# Generous limits of media: frames per second, and seconds since 1970.
MIN_MEDIA_RATE, MAX_MEDIA_RATE = 0.001, 1e6
MAX_MEDIA_SECONDS = 10**12
MAX_SPEED = 10**6
# Hosts of URLs that mean this machine.
LOCAL_HOSTS = ("", "localhost")


def import_otio() -> Any:
    """Import and return OpenTimelineIO (IO005 if it is not installed)."""
    try:
        import opentimelineio as otio
    except ModuleNotFoundError as error:
        message = "cut lists need the package OpenTimelineIO"
        hint = "pip install 'animtool[otio]'"
        raise OptionError(Fault("IO005", message, hint=hint)) from error
    return otio


def is_edl(path: Path) -> bool:
    """Return whether a file is an edit decision list, by its suffix."""
    return path.suffix.lower() == ".edl"


def read_timeline(path: Path) -> Any:
    """Return an OpenTimelineIO timeline; an EDL is read by `read_edl`."""
    otio = import_otio()
    check_timeline_file(path)
    try:
        timeline = otio.adapters.read_from_file(str(path))
    except MemoryError:
        raise
    except Exception as error:
        suffixes = sorted(otio.adapters.suffixes_with_defined_adapters(read=True))
        message = f"is not a timeline: {excerpt(str(error), 200)}"
        if path.suffix.lower().removeprefix(".") not in suffixes:
            message = "is not a timeline"
        hint = f"timelines end in {', '.join(f'.{suffix}' for suffix in suffixes)}"
        raise FormatError(Fault("BAT041", message, str(path), (), hint)) from error
    if not isinstance(timeline, otio.schema.Timeline):
        message = f"is a {type(timeline).__name__}, not a timeline"
        raise FormatError(Fault("BAT041", message, str(path)))
    if timeline.tracks is None:
        raise FormatError(Fault("BAT041", "has no tracks", str(path)))
    return timeline


def media_path(url: str, folder: Path) -> Path:
    """Return the file of a URL or of a path relative to a folder.

    An address of another machine becomes a missing path of that name.
    """
    # No system allows it in a name.
    url = url.replace("\0", "%00")
    try:
        url_parts = urlsplit(url)
    except ValueError:
        return folder / url
    if url_parts.scheme == "file" and (
        url_parts.netloc in LOCAL_HOSTS or os.name == "nt"
    ):
        # Imported here since it is slow, and most timelines do not need it.
        from urllib.request import url2pathname

        host = "" if url_parts.netloc in LOCAL_HOSTS else f"//{url_parts.netloc}"
        return Path(_escape_null(url2pathname(host + url_parts.path)))
    if len(url_parts.scheme) > 1:
        return Path(url)
    is_existing = FileState.of(folder / url) is not None
    return folder / (url if is_existing else _escape_null(unquote(url)))


def _escape_null(path: str) -> str:
    return path.replace("\0", "%00")


def exact_rate(rate: float) -> Fraction:
    """Return the exact frame rate of a float in a timeline."""
    if not MIN_MEDIA_RATE <= rate <= MAX_MEDIA_RATE:
        raise ValueError(f"{rate!r} is not a frame rate")
    return rate_from_float(rate)


def seconds_of(rational_time: Any) -> Fraction:
    """Return the time of a timeline object in seconds, exact at the object's rate."""
    rate = exact_rate(rational_time.rate)
    if not abs(rational_time.value) <= MAX_MEDIA_SECONDS * rate:
        raise ValueError(
            f"{rational_time.value!r} is not a time at {float(rate):g} frames/s"
        )
    exact_value = Fraction(rational_time.value)
    frames = Fraction(round(exact_value))
    if abs(exact_value - frames) > FRAME_TOLERANCE:
        frames = exact_value.limit_denominator(MAX_DENOMINATOR)
    return frames / rate
