"""Clip files as sources: the rig is opened, the frames are sampled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from animtool.clip.blocks import sample_blocks
from animtool.clip.channels import component_curves
from animtool.clip.clip import Clip
from animtool.clip.file import ClipFile, load_clip, load_clip_rig, open_clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.clip.sample import ClipNotice, SampledMotion, sample_channels
from animtool.clip.schema import ChannelModel, key_times
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, faults_in
from animtool.core.units import unit_name
from animtool.documents.document import Location, location_text
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig


def open_clip_source(
    path: Path, *, rig: Path | None = None, clamp: bool = False
) -> TakeStream:
    """Open a clip as a source that can be sampled at any time.

    ``rig`` is the rig file; None is the one that the clip names.
    """
    file = open_clip(path)
    loaded_rig = load_clip_rig(file, rig)
    rig_path = rig or file.required_rig_path()
    clip = load_clip(file, loaded_rig)
    stream = clip_stream(file, clip, loaded_rig, clamp=clamp)
    stream.notices += [*loaded_rig.notices, *clip.notices]
    stream.details = {
        "format": "clip",
        "name": clip.name,
        "rig": str(rig_path),
        "channels": len(clip.channels),
        "units": unit_name(loaded_rig.meters_per_unit),
    }
    stream.control_curves = {
        channel.target.removeprefix("control/"): component_curves([channel])
        for channel in clip.channels
        if channel.target.startswith("control/")
    }
    return stream


def clip_stream(
    file: ClipFile, clip: Clip, rig: Rig, *, clamp: bool = False
) -> TakeStream:
    """Return the frames of a clip, with notices located in its file."""
    path = file.document.path
    frame_count = _frame_count(file, clip)
    # Streams do not keep the text of their file: it is read again for the first notice.
    reopened_file = cache(lambda: _reopen(path))
    stream = TakeStream(rig, clip.fps, clip.first, Fraction(1), iter(()))

    reported_pairs: set[tuple[str, str]] = set()

    def to_motion(sampled_motion: SampledMotion) -> Motion:
        for clip_notice in sampled_motion.clip_notices:
            # A clip may be sampled again, at other times.
            if (clip_notice.fault.code, clip_notice.target) not in reported_pairs:
                reported_pairs.add((clip_notice.fault.code, clip_notice.target))
                stream.notices.append(
                    _located_fault(path, reopened_file(), rig, clip_notice)
                )
        return sampled_motion.motion

    def curve(times: FloatArray) -> Motion:
        with faults_in(path):
            sampled_motion = sample_channels(clip.channels, rig, times, clamp=clamp)
        return to_motion(sampled_motion)

    def blocks(times: FloatArray) -> Iterator[Motion]:
        with faults_in(path):
            for sampled_motion in sample_blocks(clip.channels, rig, times, clamp=clamp):
                yield to_motion(sampled_motion)

    frame_codes = float(clip.first) + np.arange(frame_count, dtype=np.float64)
    stream.blocks, stream.count = blocks(frame_codes), frame_count
    stream.curve = KeyedCurve(
        curve, lambda: None if clamp else clip, sample_blocks=blocks
    )
    return stream


def _reopen(path: Path) -> ClipFile | None:
    """Return a clip file that was read before; None if it cannot be read any more."""
    try:
        return open_clip(path)
    except FormatError:
        return None


def _located_fault(
    path: Path, file: ClipFile | None, rig: Rig, notice: ClipNotice
) -> Fault:
    """Return a notice as a fault, located at the key or channel that causes it."""
    if file is None:
        return replace(notice.fault, path=str(path))
    for i, channel in _causing_channels(file, rig, notice.target):
        key_path: Location = ("channels", i)
        if notice.frame is not None:
            (earlier_keys,) = np.nonzero(key_times(channel) <= notice.frame)
            key_index = int(earlier_keys[-1]) if len(earlier_keys) else 0
            key_path = (*key_path, "keys", key_index)
        return _locate(notice.fault, file, key_path)
    return replace(notice.fault, path=str(path))


def _locate(fault: Fault, file: ClipFile, key_path: Location) -> Fault:
    """Return a fault with the file, line and column of a key of a clip."""
    line, column = file.document.position(key_path)
    where = location_text(key_path)
    fault = replace(fault, lines=(line,), column=column, where=where)
    return replace(fault, path=str(file.document.path))


def _causing_channels(
    file: ClipFile, rig: Rig, target: str
) -> Iterator[tuple[int, ChannelModel]]:
    """Yield the channels of a target, then the channels of controls that drive it."""
    targets = [target]
    for driven_target in targets:
        prefix = f"{driven_target}."
        for i, channel in enumerate(file.model.channels):
            if f"{channel.target}.".startswith(prefix):
                yield i, channel
        for control in rig.controls:
            name = f"control/{control.name}"
            driven_targets = (d.target for d in control.drives)
            is_driver = any(
                f"{driven}.".startswith(prefix) for driven in driven_targets
            )
            if is_driver and name not in targets:
                targets.append(name)


def _frame_count(file: ClipFile, clip: Clip) -> int:
    """Return the number of frames of a clip; faults are located in its file."""
    try:
        return clip.frame_count()
    except FormatError as error:
        key = ("channels" if file.model.range is None else "range",)
        faults = [_locate(fault, file, key) for fault in error.faults]
        raise FormatError(faults) from error
