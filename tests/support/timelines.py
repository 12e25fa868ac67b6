"""Small timelines of OpenTimelineIO."""

from __future__ import annotations

from pathlib import Path
from typing import Any

RATE = 24


def span(start: float, count: float, rate: float = RATE) -> Any:
    """Return a range of frames."""
    from opentimelineio.opentime import RationalTime, TimeRange

    return TimeRange(RationalTime(start, rate), RationalTime(count, rate))


def clip(
    name: str,
    url: str | None,
    shown: Any,
    media: Any = (0, 100),
) -> Any:
    """Return a clip.

    Args:
        name: Its name.
        url: Of its media; None has none.
        shown: First frame of it and how many, or a range at another rate.
        media: First frame that there is of it and how many, or a range at another
            rate; None says nothing.
    """
    from opentimelineio.schema import Clip, ExternalReference

    reference = None
    if url is not None:
        available = None if media is None else _range(media)
        reference = ExternalReference(url, available)
    return Clip(name, reference, _range(shown))


def _range(given: Any) -> Any:
    return span(*given) if isinstance(given, tuple) else given


def timeline(
    path: Path,
    *items: Any,
    more: tuple[Any, ...] = (),
    rate: float | None = None,
    metadata: Any = None,
) -> Path:
    """Write a timeline of a video track, and other tracks.

    Args:
        path: The file.
        items: Clips and gaps of the track.
        more: Other tracks.
        rate: Of its global start time, an hour; None states none.
        metadata: What ``metadata.animtool`` has; None is no such key.
    """
    import opentimelineio as otio

    made = otio.schema.Timeline("edit")
    if rate is not None:
        made.global_start_time = otio.opentime.RationalTime(3600 * round(rate), rate)
    if metadata is not None:
        made.metadata["animtool"] = metadata
    track = otio.schema.Track("V1", kind="Video")
    track.extend(items)
    made.tracks.append(track)
    made.tracks.extend(more)
    otio.adapters.write_to_file(made, str(path))
    return path
