"""Joins several sources into one take with the rig, rate and frames of the first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import time_codes
from animtool.core.errors import Fault, OptionError, Severity, excerpt, listed
from animtool.core.names import name_hint
from animtool.core.quantities import plain_number
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.timecode import has_drop_frame, seconds_between
from animtool.edit.combine import sample_other_take
from animtool.edit.travel import frame_positions
from animtool.maths.curves import Curves
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.scene.file.entries import SceneSource
from animtool.scene.file.tracks import (
    Tracks,
    moving_tracks,
    rest_motion,
    select_tracks,
    with_tracks,
)
from animtool.scene.sources.onto_rig import map_to_rig

MAX_LISTED_NAMES = 6


@dataclass(frozen=True, slots=True)
class JoinedSource:
    """An open source to join, and its entry with its tracks and time code."""

    stream: TakeStream
    entry: SceneSource


def join_sources(
    first_source: JoinedSource, other_sources: Sequence[JoinedSource]
) -> TakeStream:
    """Return the first source, with tracks replaced by those of the other sources.

    The result has the rig, rate and frames of the first source. The other sources are
    mapped to that rig by name. They start with the first source or at their time codes,
    and hold their first and last frame. Notices report held frames, unmapped tracks and
    duplicate tracks; notices about frames may appear only while blocks are read.
    """
    layers: list[_Layer] = []
    faults: list[Fault] = []
    for source in other_sources:
        try:
            layers.append(_map_source(first_source, source))
        except OptionError as error:
            faults += error.faults
    if faults:
        # Faults of the first source are collected with those of the others.
        raise OptionError(list(dict.fromkeys(faults)))
    for i, layer in enumerate(layers):
        first_source.stream.notices += layer.notices
        first_source.stream.notices += _duplicate_tracks(layer, layers[:i])
    return _JoinedTake(first_source.stream, layers).stream()


@dataclass(frozen=True, slots=True)
class _Layer:
    """A source mapped to the rig of the first, with the tracks that it replaces."""

    source: JoinedSource
    take: Take  # its frames
    tracks: Tracks  # the tracks that it sets
    # Time from the first frame of the first source to its own [s].
    delay: Fraction
    notices: list[Fault]  # notices of its file

    def motion_at_frames(self, rate: Fraction, first: int, count: int) -> Motion:
        """Return the motion at frames of the first source, clamped to the layer."""
        clock = self.take.clock
        if self.source.stream.curve is None:
            return sample_other_take(self.take, rate, first, count, self.delay * rate)
        start_code = clock.start + (first / rate - self.delay) * clock.fps
        return self._sample_curve(time_codes(start_code, clock.fps / rate, count))

    def sample(self, seconds: FloatArray) -> Motion:
        """Return the motion at times after the first frame of the first source [s]."""
        clock, layer_seconds = self.take.clock, seconds - float(self.delay)
        if self.source.stream.curve is not None:
            codes = float(clock.start) + layer_seconds * float(clock.fps)
            return self._sample_curve(codes)
        samples = frame_positions(layer_seconds * float(clock.rate), clock.count)
        return self.take.motion.map(samples.interpolate)

    def _sample_curve(self, codes: FloatArray) -> Motion:
        curve, clock = self.source.stream.curve, self.take.clock
        assert curve is not None
        codes = np.clip(codes, float(clock.start), float(clock.last))
        return _with_animated_entries_of(curve(codes), self.take.motion)


def _with_animated_entries_of(motion: Motion, template: Motion) -> Motion:
    """Return a motion whose channels animate the same entries as another motion's."""

    def convert(name: str) -> Any:
        channel: Channel | None = getattr(motion, name)
        template_channel: Channel | None = getattr(template, name)
        if channel is None or template_channel is None:
            return None
        return Channel(
            template_channel.rest,
            template_channel.animated,
            channel.gather(template_channel.animated),
        )

    names = ("translations", "rotations", "scales", "weights", "controls")
    return Motion(*map(convert, names))


def _map_source(first_source: JoinedSource, source: JoinedSource) -> _Layer:
    """Return a source mapped to the rig and the clock of the first."""
    rig = first_source.stream.rig
    stream, name_map = map_to_rig(source.stream, rig, source.entry.location.fault)
    mapped_source, take = replace(source, stream=stream), stream.collect()
    notices = [
        note
        if note.path
        else source.entry.location.fault(
            note.code, note.message, note.hint, note.severity
        )
        for note in mapped_source.stream.notices
    ]
    if source.entry.tracks is None:
        source_rig = reorient(replace(source.stream, blocks=iter(())), rig.up).rig
        tracks = moving_tracks(take.motion, name_map, source_rig)
    else:
        tracks, unmatched_patterns = select_tracks(source.entry.tracks, name_map)
        faults = []
        for kind, pattern, valid_names in unmatched_patterns:
            message = f"tracks.{kind}: nothing in it and {rig.name!r} matches "
            message += excerpt(pattern)
            faults.append(
                source.entry.location.fault(
                    "SCN037", message, name_hint(pattern, valid_names)
                )
            )
        if faults:
            raise OptionError(faults)
    if not tracks:
        message = f"has no tracks of {rig.name!r}"
        hint = "list its tracks under tracks:"
        raise OptionError(source.entry.location.fault("SCN036", message, hint))
    return _Layer(mapped_source, take, tracks, _delay(first_source, source), notices)


def _delay(first_source: JoinedSource, other_source: JoinedSource) -> Fraction:
    """Return the delay of a source after the first, by their time codes [s]."""
    if first_source.entry.timecode is None and other_source.entry.timecode is None:
        return Fraction(0)
    for source in (first_source, other_source):
        if source.entry.timecode is None:
            message = "it has no time code, but another source has one"
            hint = "write the timecode of its first frame for all sources or for none"
            raise OptionError(source.entry.location.fault("SCN034", message, hint))
    starts: list[tuple[str, Fraction]] = []
    for source in (first_source, other_source):
        rate = source.entry.timecode_fps or source.stream.fps / source.stream.step
        starts.append((str(source.entry.timecode), rate))
        try:
            seconds_between(*starts[-1], *starts[-1])
        except ValueError as error:
            hint = f"the rate is {rate_label(rate)}; set another with timecode_fps"
            if ";" in starts[-1][0] and not has_drop_frame(rate):
                hint = f"write {starts[-1][0].replace(';', ':')}, or the drop-frame "
                hint += "rate that the time code counts, such as timecode_fps: 29.97"
            raise OptionError(
                source.entry.location.fault("SCN033", str(error), hint)
            ) from error
    return seconds_between(*starts[0], *starts[1])


def _duplicate_tracks(layer: _Layer, lower_layers: Sequence[_Layer]) -> list[Fault]:
    """Warn if a source without a track list sets tracks of an earlier source."""
    if layer.source.entry.tracks is not None:
        return []
    rig = layer.take.rig
    common_names: dict[str, None] = {}
    for lower_layer in lower_layers:
        common_tracks = layer.tracks.intersection(lower_layer.tracks)
        common_names |= dict.fromkeys(common_tracks.names(rig))
    if not common_names:
        return []
    names_text = listed(list(common_names), MAX_LISTED_NAMES)
    message = f"moves {names_text}, as a source above it does"
    hint = "its own are used; list the tracks of each under tracks:"
    return [
        layer.source.entry.location.fault("SCN105", message, hint, Severity.WARNING)
    ]


@dataclass(frozen=True, slots=True)
class _JoinedTake:
    """The first source, and the sources layered over it."""

    base: TakeStream
    layers: list[_Layer]

    def stream(self) -> TakeStream:
        """Return the joined take as a stream, with a curve if any source has one."""
        joined_stream = replace(
            self.base, blocks=self._blocks(), control_curves=self._control_curves()
        )
        if self.base.curve is not None:
            joined_stream.curve = self._curve
            self._report_frames(self.base.count)
        elif any(layer.source.stream.curve is not None for layer in self.layers):
            # Layers keep their curves even if the first source has samples.
            joined_stream.curve, joined_stream.is_altered = self._curve, True
        return joined_stream

    @property
    def _rate(self) -> Fraction:
        return self.base.fps / self.base.step

    def _blocks(self) -> Iterator[Motion]:
        frames_read = 0
        for block in self.base.blocks:
            joined_block = block
            for layer in self.layers:
                replacement = layer.motion_at_frames(
                    self._rate, frames_read, block.frames
                )
                motions = joined_block, replacement
                joined_block = with_tracks(self.base.rig, *motions, layer.tracks)
            yield joined_block
            frames_read += block.frames
        if self.base.curve is None:
            self._report_frames(frames_read)

    def _curve(self, times: FloatArray) -> Motion:
        motion = self._sample_base(times)
        seconds = (times - float(self.base.first_frame)) / float(self.base.fps)
        for layer in self.layers:
            motions = motion, layer.sample(seconds)
            motion = with_tracks(self.base.rig, *motions, layer.tracks)
        return motion

    def _sample_base(self, times: FloatArray) -> Motion:
        """Return the first source at times; the rest pose if it cannot be evaluated."""
        if self.base.curve is not None:
            return self.base.curve(times)
        return rest_motion(self.base.rig).select(np.zeros(len(times), np.int64))

    def _control_curves(self) -> dict[str, Curves]:
        """Return the curve of each control from the source that sets the control."""
        merged_curves = dict(self.base.control_curves)
        for layer in self.layers:
            clock, curves = layer.take.clock, layer.source.stream.control_curves
            ratio = float(self.base.fps / clock.fps)
            begin = float(self.base.first_frame + layer.delay * self.base.fps)
            for i in layer.tracks.controls.tolist():
                name = self.base.rig.controls[i].name
                merged_curves.pop(name, None)
                if name in curves:
                    merged_curves[name] = curves[name].retimed(
                        float(clock.start), ratio, begin
                    )
        return merged_curves

    def _report_frames(self, count: int) -> None:
        """Add notices about missing and unused frames of each source."""
        for layer in self.layers:
            self.base.notices.extend(self._frame_notices(layer, count))

    def _frame_notices(self, layer: _Layer, count: int) -> Iterator[Fault]:
        """Yield notices about missing and unused frames of a source."""
        clock, note = layer.take.clock, layer.source.entry.location.fault
        # In frames of the first source, from its first.
        begin, last = layer.delay * self._rate, Fraction(count - 1)
        layer_step = self._rate / clock.rate
        end = begin + (clock.count - 1) * layer_step
        if end < 0 or begin > last:
            message = "overlaps no frame of the first source: "
            message += f"{self._range_text(begin, end)} is not in "
            message += self._range_text(Fraction(0), last)
            hint = "compare their time codes and timecode_fps"
            raise OptionError(note("SCN035", message, hint))
        missing_ranges = []
        if begin > 0:
            missing_ranges.append(
                self._range_text(Fraction(0), Fraction(-(-begin // 1) - 1))
            )
        # The last frame of a source with a lower rate lasts until its next would begin.
        if end + max(layer_step, Fraction(1)) <= last:
            missing_ranges.append(self._range_text(Fraction(end // 1 + 1), last))
        if missing_ranges:
            message = f"does not have frame {' and '.join(missing_ranges)}: its "
            message += "nearest is held there"
            yield note("SCN103", message, None, Severity.WARNING)
        outside_frame_count = max(-begin, Fraction(0)) + max(end - last, Fraction(0))
        if outside_frame_count:
            message = plain_number(float(outside_frame_count / self._rate))
            message += " s before and after the first source are ignored"
            yield note("SCN104", message, None, Severity.NOTE)

    def _range_text(self, first: Fraction, last: Fraction) -> str:
        labels = [
            f"{float(self.base.first_frame + frame * self.base.step):.10g}"
            for frame in (first, last)
        ]
        return " to ".join(dict.fromkeys(labels))
