"""Props of a scene, sampled at the frames of its sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import time_codes
from animtool.core.errors import AnimtoolError, Fault, FormatError, Severity, listed
from animtool.core.files.output import same_file
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.motion.transforms import Track, Transforms, apply_animated_placement
from animtool.rig.placement import Placement
from animtool.scene.bake.progress import Meter, StageCost
from animtool.scene.file.entries import SceneProp
from animtool.usd.props.reader import PropSource, open_prop

# Shear of a transform between keys up to this is invisible and not reported [1].
VISIBLE_SHEAR = 1e-9


@dataclass(frozen=True, slots=True)
class OpenProp:
    """A prop of a scene whose file is open, with its track."""

    entry: SceneProp
    source: PropSource
    track: Track  # its reads are charged to the scene's meter


def open_props(
    entries: Sequence[SceneProp],
    source: Path,
    up: UpAxis,
    meter: Meter,
    notices: list[Fault],
) -> list[OpenProp]:
    """Open the props of a scene, in a world with an up axis.

    ``source`` is the file of the take, whose prims follow its placement.
    """
    opened_props: list[OpenProp] = []
    faults: list[Fault] = []
    for entry in entries:
        cost = meter.stage(entry.file.name, entry.location.where)
        try:
            with meter.running(cost):
                prop = open_prop(entry, up)
        except AnimtoolError as error:
            faults += map(entry.location.locate, error.faults)
            continue
        track = _metered_track(entry, prop, cost, meter, notices)
        follows_placement = same_file(entry.file.resolve(), source)
        follows_placement = follows_placement or not entry.path.startswith("/")
        track = replace(track, follows_placement=follows_placement)
        opened_props.append(OpenProp(entry, prop, track))
    if faults:
        raise FormatError(faults)
    return opened_props


def with_props(
    stream: TakeStream,
    added_props: Sequence[OpenProp],
    first_frame: Fraction | None,
    fps: Fraction | None,
    dropped_placement: Callable[[FloatArray], Placement] | None = None,
) -> TakeStream:
    """Return a take with props added, sampled at the frames of the take.

    ``first`` is the number of the first frame; None is the take's own, or 1. ``fps`` is
    the output's rate; None is the take's. ``dropped`` is as in `TakeStream`.
    """
    start = stream.first_frame
    props = []
    for prop in added_props:
        begin = first_frame or start if prop.entry.frame is None else prop.entry.frame
        step = prop.source.fps * stream.step / stream.fps
        props.append(_TimedProp(prop, begin, step))
    props_stream = _PropStream(stream, props)
    for timed_prop in props:
        stream.notices += timed_prop.notices(fps or stream.fps)
    tracks = (
        *stream.tracks,
        *(prop.track(stream, dropped_placement) for prop in props),
    )
    stream_with_props = replace(stream, blocks=props_stream.blocks(), tracks=tracks)
    curve = stream.curve
    if curve is not None:
        stream_with_props.curve = lambda times: props_stream.with_prop_times(
            curve(times), props_stream.prop_times(times)
        )
    return stream_with_props


def _metered_track(
    entry: SceneProp,
    source: PropSource,
    cost: StageCost,
    meter: Meter,
    notices: list[Fault],
) -> Track:
    """Return a track whose reads are timed and whose shear is reported."""
    is_shear_reported = False

    def sample(times: FloatArray) -> Transforms:
        nonlocal is_shear_reported
        with meter.running(cost), entry.location.located():
            samples = source.track.sample(times)
        shear = source.max_shear()
        if shear > VISIBLE_SHEAR and not is_shear_reported:
            is_shear_reported = True
            message = f"{entry.prim} is sheared between its keys, by up to "
            message += f"{shear:.2g} of its size, which is ignored"
            notices.append(entry.location.fault("SCN113", message, None, Severity.NOTE))
        return samples

    return replace(source.track, sample=sample, note=entry.location.fault)


@dataclass(frozen=True, slots=True)
class _TimedProp:
    """A prop sampled at the frames of a take."""

    open_prop: OpenProp
    start_code: Fraction  # time code of its file at the first frame
    step: Fraction  # time codes of its file per frame

    def times(self, first: int, count: int) -> FloatArray:
        """Return the time codes of the prop at frames of the take ``(count,)``."""
        return time_codes(self.start_code + first * self.step, self.step, count)

    def track(
        self,
        stream: TakeStream,
        dropped_placement: Callable[[FloatArray], Placement] | None,
    ) -> Track:
        """Return the prop's track, relative to the take if the placement is dropped."""
        track = self.open_prop.track
        if dropped_placement is None or not track.follows_placement:
            return track
        start = stream.first_frame
        rate = stream.step / self.step

        def inverse_placement(times: FloatArray) -> Placement:
            codes = float(start) + (times - float(self.start_code)) * float(rate)
            return dropped_placement(codes).inverse()

        return apply_animated_placement(track, inverse_placement)

    def notices(self, fps: Fraction) -> Iterator[Fault]:
        """Yield notices about the prop that do not depend on frames."""
        source, entry = self.open_prop.source, self.open_prop.entry
        note = entry.location.fault
        if names := source.fallback_attributes:
            message = f"{entry.prim} does not state {listed(names)}"
            hint = "the default of USD is written"
            yield note("SCN108", message, hint, Severity.WARNING)
        if source.span is None:
            message = f"{entry.prim} does not move: it is written once"
            yield note("SCN109", message, None, Severity.NOTE)
        elif (fps / source.fps).denominator > 1:
            prop_rate, output_rate = rate_label(source.fps), rate_label(fps)
            message = f"{entry.prim} has {prop_rate}, but the output {output_rate}"
            hint = "values interpolated between its own frames are written"
            yield note("SCN110", message, hint, Severity.NOTE)
        if source.has_shear:
            message = f"{entry.prim} is sheared: its transform is written as a matrix"
            hint = "a non-uniform scale is above a rotation"
            yield note("SCN111", message, hint, Severity.NOTE)


@dataclass(frozen=True, slots=True)
class _PropStream:
    """A take to whose blocks the sample times of props are added."""

    stream: TakeStream
    props: Sequence[_TimedProp]

    def blocks(self) -> Iterator[Motion]:
        frames_read = 0
        for block in self.stream.blocks:
            times = [prop.times(frames_read, block.frames) for prop in self.props]
            yield self.with_prop_times(block, np.stack(times, axis=1))
            frames_read += block.frames

    def with_prop_times(self, motion: Motion, times: FloatArray) -> Motion:
        """Return a motion with the times ``(F, N)`` of props appended."""
        if motion.track_times is not None:
            times = np.concatenate([motion.track_times.dense()[..., 0], times], axis=1)
        return replace(motion, track_times=_times_channel(times))

    def prop_times(self, times: FloatArray) -> FloatArray:
        """Return the time codes of every prop ``(F, N)`` at time codes of the take."""
        frames = (times - float(self.stream.first_frame)) / float(self.stream.step)
        start_codes = np.array([float(prop.start_code) for prop in self.props])
        steps = np.array([float(prop.step) for prop in self.props])
        return np.asarray(start_codes + frames[:, None] * steps)


def _times_channel(times: FloatArray) -> Channel:
    """Return times ``(F, N)`` as a channel with every entry animated."""
    count = times.shape[1]
    return Channel(np.zeros((count, 1)), np.arange(count), times[..., None])
