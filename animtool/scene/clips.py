"""A clip file as a source: its rig opened, its frames sampled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_clip
from animtool.clip.segments import curves_of
from animtool.edit.frames import MOST_FRAMES
from animtool.errors import Fault, FormatError, OptionError
from animtool.scene.rigs import open_rig
from animtool.take import Motion, TakeStream
from animtool.units import unit_name

__all__ = ["open_clip_source"]


def open_clip_source(
    path: Path, rig_path: Path | None = None, *, clamp: bool = False
) -> TakeStream:
    """Open a clip as a source that can be sampled at any time.

    Args:
        path: The clip.
        rig_path: Its rig; None is the one that the clip names.
        clamp: Bring controls into their ranges, and joints into their limits.

    Raises:
        FormatError: The clip or its rig is malformed, with every fault.
        OptionError: No rig is named.
    """
    file = open_clip(path)
    named = rig_path or file.rig
    if named is None:
        hint = "write 'rig: hero.rig.yaml' into it, or give --rig"
        raise OptionError(Fault("CLIP011", "names no rig", str(path), (), hint))
    rig = open_rig(named)
    clip = load_clip(file, rig)
    count = int(clip.last - clip.first) + 1
    if count > MOST_FRAMES:
        message = f"the range has {count} frames"
        raise FormatError(Fault("CLIP006", message, str(path)))
    stream = TakeStream(rig, clip.fps, clip.first, Fraction(1), iter(()))
    stream.details = {
        "format": "clip",
        "rig": str(named),
        "channels": len(clip.channels),
        "units": unit_name(rig.meters_per_unit),
    }

    def curve(times: FloatArray) -> Motion:
        try:
            sampled = sample_clip(clip, rig, times, clamp=clamp)
        except FormatError as error:
            faults = [replace(fault, path=str(path)) for fault in error.faults]
            raise FormatError(faults) from error
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
