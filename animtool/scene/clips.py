"""A clip file as a source: its rig opened, its frames sampled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.clip.clip import Clip
from animtool.clip.file import ClipFile, load_clip, load_rig_of, open_clip
from animtool.clip.sample import sample_channels
from animtool.clip.segments import curves_of
from animtool.errors import FormatError
from animtool.take import Motion, TakeStream
from animtool.units import unit_name

__all__ = ["open_clip_source"]


def open_clip_source(
    path: Path, *, rig: Path | None = None, clamp: bool = False
) -> TakeStream:
    """Open a clip as a source that can be sampled at any time.

    Args:
        path: The clip.
        rig: Its rig file; None is the one that the clip names.
        clamp: Bring controls into their ranges, and joints into their limits.

    Raises:
        FormatError: The clip or its rig is malformed, with every fault.
        OptionError: No rig is named.
    """
    file = open_clip(path)
    loaded = load_rig_of(file, rig)
    named = rig or file.needed_rig()
    clip = load_clip(file, loaded)
    count = _frame_count(file, clip)
    stream = TakeStream(loaded, clip.fps, clip.first, Fraction(1), iter(()))
    stream.notices += [*loaded.notices, *clip.notices]
    stream.details = {
        "format": "clip",
        "rig": str(named),
        "channels": len(clip.channels),
        "units": unit_name(loaded.meters_per_unit),
    }

    def curve(times: FloatArray) -> Motion:
        with _named(path):
            sampled = sample_channels(clip.channels, loaded, times, clamp=clamp)
        stream.notices += [replace(note, path=str(path)) for note in sampled.notices]
        return sampled.motion

    def blocks() -> Iterator[Motion]:
        yield curve(float(clip.first) + np.arange(count, dtype=np.float64))

    stream.blocks, stream.curve, stream.count = blocks(), curve, count
    stream.control_curves = {
        channel.target.removeprefix("control/"): curves_of([channel])
        for channel in clip.channels
        if channel.target.startswith("control/")
    }
    return stream


def _frame_count(file: ClipFile, clip: Clip) -> int:
    """Return how many frames a clip has; faults have their place in its file."""
    try:
        return clip.frame_count()
    except FormatError as error:
        at = ("channels",) if file.model.range is None else ("range",)
        line, column = file.document.place(at)
        path = str(file.document.path)
        faults = [
            replace(fault, path=path, lines=(line,), column=column, where=at[0])
            for fault in error.faults
        ]
        raise FormatError(faults) from error


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Give the faults of a clip the name of its file."""
    try:
        yield
    except FormatError as error:
        faults = [replace(fault, path=str(path)) for fault in error.faults]
        raise FormatError(faults) from error
