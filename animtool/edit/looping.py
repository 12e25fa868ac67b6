"""Seamless repetition of a take.

Towards the end two corrections are added, quintics of the time s from 0 to 1: one
removes the pose offset and arrives without speed, the other corrects the speed and
arrives without offset. Both start with no offset, speed or acceleration, so that frames
before the blend stay unchanged (the idea of D. Bollo, Inertialization: high-performance
animation transitions in Gears of War, 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.edit.combine import continuous
from animtool.edit.cycle import Cycle, find_cycle, measure_cycle
from animtool.edit.frames import check_count, check_range, frame_index
from animtool.edit.loop_options import LoopOptions
from animtool.edit.travel import CycleTravel, cycle_travel, nearby_positions
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    RETIMED_PARTS,
    OptionChecks,
    Pass,
    PassContext,
    Scope,
    TakePart,
)
from animtool.motion.take import Take
from animtool.motion.transforms import Track, Transforms
from animtool.rig.skeleton import Joint, Rig

_Value = TypeVar("_Value", bound=np.generic)
Onward: TypeAlias = Callable[[FloatArray], FloatArray]

# If a cycle spans the full take, speeds at its ends are only approximate. A
# change of speed below this fraction of the largest within is then taken as
# natural: an even cycle stays unchanged if its fastest part takes nine
# frames or more (by Bernstein's inequality).
NATURAL_CHANGE = 0.25


@dataclass(frozen=True, slots=True)
class SeamBlend:
    """A cycle within some frames, and the blend weights of its corrections."""

    length: int  # frames of the cycle, L
    before: int  # whether there is a frame before the cycle (1) or none (0)
    behind: int  # whether there is one after the frame that shows the first pose again
    pose: FloatArray  # how much of the offset at the end [1] ``(L, 1, 1)``
    speed: FloatArray  # how much of the missing speed [frame] ``(L, 1, 1)``

    @staticmethod
    def over(length: int, frames: int, before: int, behind: int) -> SeamBlend:
        """Return the blend of the last frames of a cycle."""
        span = min(frames, length)
        s = np.clip((np.arange(length) - (length - span)) / max(span, 1), 0, 1)
        pose = s**3 * (10 - 15 * s + 6 * s**2)
        speed = span * s**3 * (-4 + 7 * s - 3 * s**2)
        pose, speed = pose[:, None, None], speed[:, None, None]
        return SeamBlend(length, before, behind, pose, speed)

    @property
    def late(self) -> slice:
        """The blended frames: the last of the cycle."""
        (frames,) = np.nonzero(self.pose[:, 0, 0])
        return slice(int(frames[0]) if len(frames) else self.length, self.length)

    def cycle(self, values: npt.NDArray[_Value]) -> npt.NDArray[_Value]:
        """Return the frames of the cycle and the one after it ``(L + 1, ...)``."""
        return values[self.before : self.before + self.length + 1]

    def ends(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the frames that determine speed at the start and at the end.

        They are the frames on either side if both ends have them; else, if the cycle
        spans the full take, three frames at each end.
        """
        around = self.before + self.behind
        if around:
            pair = np.array([0, around])
            return values[pair], values[pair + self.length]
        return values[:3], values[-3:]


def closed_lines(values: FloatArray, blend: SeamBlend, onward: Onward) -> FloatArray:
    """Return a cycle of vectors that continues into its successor ``(L, A, K)``."""
    cycle = blend.cycle(values)
    start, end = blend.ends(values)
    missing = _missing_speed(
        np.diff(onward(start), axis=0),
        np.diff(end, axis=0),
        lambda: np.diff(cycle, axis=0),
        blend,
    )
    gap = onward(cycle[:1])[0] - cycle[-1]
    closed, late = cycle[:-1].copy(), blend.late
    closed[late] += blend.pose[late] * gap + blend.speed[late] * missing
    return closed


def closed_rotations(
    values: FloatArray, blend: SeamBlend, onward: Onward
) -> FloatArray:
    """Return a cycle of rotations that continues into its successor ``(L, A, 4)``."""
    cycle = blend.cycle(values)
    start, end = blend.ends(values)
    gap = so3.multiply(so3.conjugate(cycle[-1]), onward(cycle[:1])[0])
    # Speeds are about the joint's own axes, which the gap turns.
    ending = so3.rotate(so3.conjugate(gap), so3.steps(end))
    missing = _missing_speed(
        so3.steps(onward(start)), ending, lambda: so3.steps(cycle), blend
    )
    closed, late = cycle[:-1].copy(), blend.late
    part = so3.slerp(so3.IDENTITY, gap, blend.pose[late, :, 0])
    turned = so3.multiply(closed[late], part)
    closed[late] = so3.multiply(turned, so3.exp(blend.speed[late] * missing))
    return closed


def _missing_speed(
    starting: FloatArray,
    ending: FloatArray,
    measure: Callable[[], FloatArray],
    blend: SeamBlend,
) -> FloatArray:
    """Return the speed ``(A, K)`` [a frame] missing at the end of a cycle.

    ``measure`` returns the steps from frame to frame ``(L, A, K)``.
    """
    around = blend.before + blend.behind
    if around:
        return np.asarray((starting[0] - ending[0]) / around)
    steps = measure()
    if len(steps) < 2:
        return np.zeros(steps.shape[1:])
    mean_rate = (ending[1] - ending[0] + starting[1] - starting[0]) / 2
    missing = starting[0] - ending[1] - mean_rate
    size = np.linalg.norm(missing, axis=-1, keepdims=True)
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=0)
    beyond = np.maximum(size - NATURAL_CHANGE * changes[:, None], 0)
    return np.asarray(missing * (beyond / np.where(size > 0, size, 1)))


def mapped_numbers(
    track: Track, known: Transforms, function: Callable[[FloatArray], FloatArray]
) -> Transforms:
    """Return transforms with a function applied to all numeric attributes.

    ``function`` ``(F, A, K)``.
    """

    def numbers(values: FloatArray) -> FloatArray:
        columns = values.reshape(len(values), -1, 1)
        mapped = function(columns)
        return mapped.reshape(len(mapped), *values.shape[1:])

    return Transforms(
        numbers(known.translations),
        function(known.rotations[:, None])[:, 0],
        numbers(known.scales),
        None if known.matrices is None else numbers(known.matrices),
        tuple(
            numbers(values) if attribute.width else values
            for attribute, values in zip(track.attributes, known.values, strict=True)
        ),
        known.clamped,
    )


def gridded(track: Track, known: Transforms) -> Track:
    """Return a track sampled at times 0, 1, 2 ..., clamped at its ends.

    Between samples rotations follow the shortest arc, numbers are linear and tokens are
    held.
    """
    count = len(known)

    def sample(times: FloatArray) -> Transforms:
        positions = nearby_positions(times, count)

        def between(values: FloatArray) -> FloatArray:
            every = np.arange(values.shape[1])
            return positions.blend(Channel(values[0], every, values)).values

        mapped = mapped_numbers(track, known, between)
        values = tuple(
            mapped.values[i] if attribute.width else known.values[i][positions.frames]
            for i, attribute in enumerate(track.attributes)
        )
        static = None if known.clamped is None else known.clamped[positions.frames]
        return replace(mapped, values=values, clamped=static)

    return replace(track, sample=sample)


# Ends that differ by more than this fraction of the cycle's extent visibly slide.
POOR_SEAM = 0.2


_DEFAULTS = LoopOptions()


def loop(
    take: Take,
    first: float | None = None,
    last: float | None = None,
    *,
    repeats: int = _DEFAULTS.repeats,
    blend: int = _DEFAULTS.blend,
) -> Take:
    """Return a cycle of the take, repeated; `find_cycle` searches for one.

    The frame ``last`` is the first of the next cycle and is not shown itself. Over the
    ``blend`` frames before it, the missing offset and speed are added, so that neither
    jumps; speeds are most accurate if the take has frames on either side of the cycle.
    The joint that carries the character keeps its travel: each cycle continues, on the
    ground and about the up axis, from the end of the previous one. That is a root, or
    the topmost moving joint below a static root. Tracks keep their travel likewise. A
    take of one frame stays unchanged.

    Args:
        take: F frames.
        first: First time code of the cycle; None is that of the take.
        last: Time code that shows the first pose again; None is the last of the
            take.
        repeats: How often the cycle is shown, at least 1.
        blend: Frames before the seam that change, at least 0.

    Raises:
        OptionError: A frame is outside the take (SCN013), there is no cycle or
            repeat (SCN018), or there would be too many frames (SCN021).
    """
    clock = take.clock
    if clock.count == 1:
        return take
    i = 0 if first is None else frame_index(clock, first, "first")
    j = clock.count - 1 if last is None else frame_index(clock, last, "last")
    if j <= i:
        message = f"{j - i} frames are too few for a cycle"
        raise OptionError(Fault("SCN018", message))
    _check_least(repeats, 1, "repeats")
    _check_least(blend, 0, "blend")
    length = j - i
    check_count(length * repeats)
    before, behind = int(i > 0), int(j < clock.count - 1)
    seam = SeamBlend.over(length, blend, before, behind)
    within, around = slice(i, j + 1), slice(i - before, j + behind + 1)
    cycle = _Cycling(cycle_travel(take.rig, take.motion.select(within)), seam, repeats)
    motion = cycle.motion(take.motion.select(around))
    tracks = take.tracks
    if tracks:
        motion, tracks = _looped_tracks(take, motion, around, seam, repeats)
    start = clock.start + i * clock.step
    return replace(
        take,
        clock=replace(clock, start=start, count=length * repeats),
        motion=continuous(motion).map(Channel.compact),
        tracks=tracks,
    )


def _looped_tracks(
    take: Take, motion: Motion, around: slice, seam: SeamBlend, repeats: int
) -> tuple[Motion, tuple[Track, ...]]:
    """Return the looped motion with the times of looped tracks, and the tracks.

    Each continues as a root does, and is sampled at the loop's frames.
    """
    times = take.motion.track_times
    assert times is not None
    shown = times.select(around).dense()[..., 0]
    tracks = tuple(
        _looped_track(track, track.at(shown[:, i]), take.rig.up, seam, repeats)
        if track.moves
        else track
        for i, track in enumerate(take.tracks)
    )
    frames = np.arange(seam.length * repeats, dtype=np.float64)
    every = np.repeat(frames[:, None, None], len(tracks), axis=1)
    return replace(motion, track_times=Channel.from_dense(every)), tracks


def _looped_track(
    track: Track, known: Transforms, up: UpAxis, seam: SeamBlend, repeats: int
) -> Track:
    root = Rig("track", (Joint("root", -1),), up=up)
    motion = Motion(
        Channel.from_dense(known.translations[:, None]),
        Channel.from_dense(known.rotations[:, None]),
    )
    ends = slice(seam.before, seam.before + seam.length + 1)
    cycle = _Cycling(cycle_travel(root, motion.select(ends)), seam, repeats)
    looped_motion = cycle.motion(motion)

    def closed(values: FloatArray) -> FloatArray:
        cycle_values = closed_lines(values, seam, lambda same: same)
        return np.concatenate([cycle_values] * repeats)

    mapped = mapped_numbers(track, known, closed)
    looped_values = tuple(
        values if attribute.width else np.tile(seam.cycle(values)[:-1], repeats)
        for attribute, values in zip(track.attributes, mapped.values, strict=True)
    )
    looped = replace(
        mapped,
        translations=looped_motion.translations.dense()[:, 0],
        rotations=looped_motion.rotations.dense()[:, 0],
        values=looped_values,
        clamped=None
        if known.clamped is None
        else np.tile(seam.cycle(known.clamped)[:-1], repeats),
    )
    return gridded(track, looped)


@dataclass(frozen=True, slots=True)
class _Cycling:
    travel: CycleTravel
    blend: SeamBlend
    repeats: int

    def motion(self, motion: Motion) -> Motion:
        return replace(
            motion.map(self.numbers),
            translations=self.translations(motion.translations),
            rotations=self.rotations(motion.rotations),
        )

    def numbers(self, channel: Channel) -> Channel:
        cycle = closed_lines(channel.values, self.blend, lambda values: values)
        return replace(channel, values=np.concatenate([cycle] * self.repeats))

    def translations(self, channel: Channel) -> Channel:
        linear = self.travel.linear[channel.animated]
        shifts = self.travel.shifts[channel.animated]

        def onward(values: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("aij,faj->fai", linear, values) + shifts)

        cycle = closed_lines(channel.values, self.blend, onward)
        return replace(channel, values=self.repeated(cycle, onward))

    def rotations(self, channel: Channel) -> Channel:
        travel = self.travel.rotations[channel.animated]

        def onward(values: FloatArray) -> FloatArray:
            return so3.multiply(travel, values)

        cycle = closed_rotations(channel.values, self.blend, onward)
        return replace(channel, values=self.repeated(cycle, onward))

    def repeated(self, cycle: FloatArray, onward: Onward) -> FloatArray:
        parts = [cycle]
        # One step per repeat: each adds the travel to the previous one.
        for _ in range(self.repeats - 1):
            parts.append(onward(parts[-1]))
        return np.concatenate(parts)


def _check_least(number: int, least: int, name: str) -> None:
    if not number >= least:  # NaN too
        message = f"{name} is {number}; it must be at least {least}"
        raise OptionError(Fault("SCN018", message))


def _checks(options: LoopOptions) -> OptionChecks:
    return {
        "last": lambda: check_range(options.first, options.last),
        "repeats": lambda: _check_least(options.repeats, 1, "repeats"),
        "blend": lambda: _check_least(options.blend, 0, "blend"),
    }


def _run(take: Take, options: LoopOptions, context: PassContext) -> Take:
    first, last = options.first, options.last
    if options.find:
        lengths = {"shortest": options.shortest, "longest": options.longest}
        cycle = find_cycle(take, first, last, **lengths)
        first, last = cycle.first, cycle.last
    elif take.clock.count > 1:
        cycle = measure_cycle(take, first, last)
    else:
        message = "the take has one frame: there is nothing to repeat"
        hint = "choose a take that moves"
        context.notices.append(
            Fault("SCN114", message, hint=hint, severity=Severity.WARNING)
        )
        return take
    result = loop(take, first, last, repeats=options.repeats, blend=options.blend)
    context.notices.extend(cycle_notices(cycle, searched=options.find))
    return result


def cycle_notices(cycle: Cycle, *, searched: bool) -> list[Fault]:
    """Return the notices about a cycle."""
    ends = (
        f"frames {cycle.first:g} and {cycle.last:g} differ by "
        f"{1000 * cycle.apart:.2f} mm, {100 * cycle.share:.0f}% of the motion "
        "between them"
    )
    notices = []
    if searched:
        message = f"the best cycle: {ends}"
        notices.append(Fault("SCN102", message, severity=Severity.NOTE))
    if cycle.share > POOR_SEAM:
        hint = (
            f"choose other frames with {argument('first')} and {argument('last')}, or "
            f"a longer {argument('blend')}"
        )
        message = f"the loop has a visible seam: {ends}"
        notices.append(Fault("SCN101", message, hint=hint, severity=Severity.WARNING))
    return notices


PASS = Pass(
    "loop",
    "Find a cycle and repeat it",
    LoopOptions,
    Scope.CLIP,
    _run,
    _checks,
    changes=RETIMED_PARTS - {TakePart.POINTS},
)
