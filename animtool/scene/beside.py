"""What a scene carries beside its character, on the frames of its sources."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.errors import AnimtoolError, Fault, FormatError, Severity, listed
from animtool.rates import rate_label
from animtool.scene.scene import SceneThing
from animtool.scene.stats import Meter, StageCost
from animtool.take import Channel, Motion, TakeStream, time_codes
from animtool.transforms import Track, Transforms
from animtool.units import UpAxis
from animtool.usd.things import ThingSource, Wanted, open_thing

__all__ = ["open_things", "with_things"]

# A frame this near to a whole one [frame] is that, with the rounding of time codes.
ON_FRAME = 1e-9
# Between keys a transform may shear by this share, which nobody sees, and not say so.
SEEN_SHEAR = 1e-9


def open_things(entries: Sequence[SceneThing], up: UpAxis) -> list[ThingSource]:
    """Return the things that a scene names, open, in a world of an up axis.

    Raises:
        FormatError: With every fault of every entry.
    """
    found: list[ThingSource] = []
    faults: list[Fault] = []
    for entry in entries:
        wanted = Wanted(
            entry.file, entry.prim, entry.path, entry.attributes, entry.reference
        )
        try:
            found.append(open_thing(wanted, up))
        except AnimtoolError as error:
            faults += map(entry.place.put, error.faults)
    if faults:
        raise FormatError(faults)
    return found


def with_things(
    stream: TakeStream,
    entries: Sequence[SceneThing],
    first: Fraction | None,
    fps: Fraction | None,
    meter: Meter,
) -> TakeStream:
    """Return a take with things beside its rig, read at each of its frames.

    Args:
        stream: The take.
        entries: The things, at least one.
        first: Number of its first frame; None is what it says itself, or 1.
        fps: Frames a second of the output; None is the take's time codes.
        meter: Counts what reading them costs.

    Raises:
        FormatError: One cannot be read; the blocks may raise it too.
    """
    start = Fraction(1) if stream.start is None else stream.start
    stages = [meter.stage(entry.file.name, entry.place.where) for entry in entries]
    sources = open_things(entries, stream.rig.up)
    things = [
        _Thing(
            entry,
            source,
            entry.frame if entry.frame is not None else first or start,
            source.fps * stream.step / stream.fps,
        )
        for entry, source in zip(entries, sources, strict=True)
    ]
    beside = _Beside(stream, things)
    for thing in things:
        stream.notices += thing.notes(fps or stream.fps)
    tracks = [
        _counted(thing, stage, meter, stream.notices)
        for thing, stage in zip(things, stages, strict=True)
    ]
    made = replace(stream, blocks=beside.blocks(), tracks=tuple(tracks))
    curve = stream.curve
    if curve is not None:
        made.curve = lambda times: replace(
            curve(times), track_times=beside.times_at(times)
        )
        beside.say_frames(stream.count)
    return made


def _counted(
    thing: _Thing, stage: StageCost, meter: Meter, notices: list[Fault]
) -> Track:
    """Return a track whose reading is counted, and shear of it said."""
    track, said = thing.source.track, False

    def sample(times: FloatArray) -> Transforms:
        nonlocal said
        with meter.running(stage), thing.entry.place.blamed():
            found = track.sample(times)
        shear = thing.source.shear()
        if shear > SEEN_SHEAR and not said:
            said = True
            message = f"{thing.entry.prim} is sheared between its keys, by up to "
            message += f"{shear:.2g} of its size, which is left out"
            note = thing.entry.place.fault
            notices.append(note("SCN113", message, None, Severity.NOTE))
        return found

    return replace(track, sample=sample)


@dataclass(frozen=True, slots=True)
class _Thing:
    """A thing on the frames of a take.

    Attributes:
        entry: What the scene says of it.
        source: It, open.
        begin: Time code of its file at the first frame.
        step: Time codes of its file from frame to frame.
    """

    entry: SceneThing
    source: ThingSource
    begin: Fraction
    step: Fraction

    def times(self, first: int, count: int) -> FloatArray:
        """Return its time codes at frames of the take ``(count,)``."""
        return time_codes(self.begin + first * self.step, self.step, count)

    def notes(self, fps: Fraction) -> Iterator[Fault]:
        """Yield what there is to say of it, whatever the frames are."""
        source, note = self.source, self.entry.place.fault
        if source.unstated:
            message = f"{self.entry.prim} does not state {listed(source.unstated)}"
            hint = "what USD takes for it is written"
            yield note("SCN108", message, hint, Severity.WARNING)
        if source.span is None:
            message = f"{self.entry.prim} does not move: it is written once"
            yield note("SCN109", message, None, Severity.NOTE)
        elif (fps / source.fps).denominator > 1:
            mine, theirs = rate_label(source.fps), rate_label(fps)
            message = f"{self.entry.prim} has {mine}, and the output {theirs}"
            hint = "what it is between its own frames is written"
            yield note("SCN110", message, hint, Severity.NOTE)
        if source.sheared:
            message = f"{self.entry.prim} is sheared: its place is written as a matrix"
            hint = "a scale that is not even stands above a rotation"
            yield note("SCN111", message, hint, Severity.NOTE)

    def held(self, count: int) -> BoolArray | None:
        """Return which of a take's frames it has not; None where it never moves."""
        if self.source.span is None:
            return None
        codes = self.times(0, count)
        low, high = map(float, self.source.span)
        slack = ON_FRAME * float(self.step)
        return (codes < low - slack) | (codes > high + slack)


@dataclass(frozen=True, slots=True)
class _Beside:
    """A take, and what comes beside it."""

    stream: TakeStream
    things: Sequence[_Thing]

    @property
    def _start(self) -> Fraction:
        return Fraction(1) if self.stream.start is None else self.stream.start

    def blocks(self) -> Iterator[Motion]:
        first = 0
        for block in self.stream.blocks:
            times = [thing.times(first, block.frames) for thing in self.things]
            yield replace(block, track_times=_channel(np.stack(times, axis=1)))
            first += block.frames
        if self.stream.curve is None:
            self.say_frames(first)

    def times_at(self, times: FloatArray) -> Channel:
        """Return the times of the tracks at time codes of the take."""
        frames = (times - float(self._start)) / float(self.stream.step)
        begins = np.array([float(thing.begin) for thing in self.things])
        steps = np.array([float(thing.step) for thing in self.things])
        return _channel(begins + frames[:, None] * steps)

    def say_frames(self, count: int) -> None:
        """Name the frames at which things are held, as their files have none."""
        for thing in self.things:
            held = thing.held(count)
            if held is None or not held.any():
                continue
            low, high = map(float, thing.source.span or (0, 0))
            names = time_codes(self._start, self.stream.step, count)
            shown = f"{thing.entry.prim} has frames {low:g} to {high:g}"
            message = f"{shown}: it is held at {_spans(names, held)} of the take"
            hint = None
            if held.all():
                hint = "frame: says which of its frames comes with the first"
            note = thing.entry.place.fault
            self.stream.notices.append(note("SCN107", message, hint, Severity.WARNING))


def _channel(times: FloatArray) -> Channel:
    """Return times ``(F, N)`` as a channel in which all move, as blocks have to."""
    count = times.shape[1]
    return Channel(np.zeros((count, 1)), np.arange(count), times[..., None])


def _spans(names: FloatArray, held: BoolArray) -> str:
    """Return the frames that are held as people read them."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]])))
    ends = zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
    spans = [
        " to ".join(dict.fromkeys(f"{names[i]:.10g}" for i in pair)) for pair in ends
    ]
    return ", ".join(spans)
