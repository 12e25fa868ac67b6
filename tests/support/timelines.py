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
    shown: tuple[float, float],
    media: tuple[float, float] | None = (0, 100),
) -> Any:
    """Return a clip.

    Args:
        name: Its name.
        url: Of its media; None has none.
        shown: First frame of it and how many.
        media: First frame that there is of it and how many; None says nothing.
    """
    from opentimelineio.schema import Clip, ExternalReference

    reference = None
    if url is not None:
        available = None if media is None else span(*media)
        reference = ExternalReference(url, available)
    return Clip(name, reference, span(*shown))


def timeline(path: Path, *items: Any, more: tuple[Any, ...] = ()) -> Path:
    """Write a timeline of a video track, and other tracks."""
    import opentimelineio as otio

    made = otio.schema.Timeline("edit")
    track = otio.schema.Track("V1", kind="Video")
    track.extend(items)
    made.tracks.append(track)
    made.tracks.extend(more)
    otio.adapters.write_to_file(made, str(path))
    return path
