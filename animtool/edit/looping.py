"""Seamless repetition of a take.

Two corrections are added towards the end, quintics of the time s from 0 to 1: one
removes the pose offset and ends without speed, the other corrects the speed and ends
without offset. Both start without offset, speed or acceleration, so that frames before
the blend stay unchanged (the idea of D. Bollo, Inertialization: high-performance
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
from animtool.core.errors import Fault, OptionError, Severity, refuse, warning
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.edit.combine import align_signs
from animtool.edit.cycle import (
    Cycle,
    empty_cycle_error,
    find_cycle,
    measure_cycle,
    range_end_indices,
)
from animtool.edit.frames import check_count, check_range
from animtool.edit.loop_options import LoopOptions
from animtool.edit.travel import CycleTravel, cycle_travel, frame_positions
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    RETIMED_PARTS,
    FrameScope,
    OptionChecks,
    Pass,
    PassContext,
    TakePart,
)
from animtool.motion.take import Take
from animtool.motion.transforms import Track, Transforms
from animtool.rig.skeleton import Joint, Rig

_Value = TypeVar("_Value", bound=np.generic)
NextCycle: TypeAlias = Callable[[FloatArray], FloatArray]

# If a cycle spans the full take, speeds at its ends are only approximate. A change of
# speed below this fraction of the largest change within the cycle is then considered
# natural: a seamless cycle stays unchanged if its fastest part takes nine frames or
# more (by Bernstein's inequality).
NATURAL_CHANGE_FRACTION = 0.25


@dataclass(frozen=True, slots=True)
class SeamBlend:
    """A cycle, the frames around it, and the blend weights at its seam."""

    cycle_length: int  # number of frames of the cycle, L
    frames_before: int  # 1 if there is a frame before the cycle, else 0
    frames_after: int  # 1 if a frame follows the repeated pose, else 0
    offset_weight: FloatArray  # weight of the offset at the end [1] ``(L, 1, 1)``
    speed_weight: FloatArray  # weight of the speed at the end [frame] ``(L, 1, 1)``

    @staticmethod
    def from_lengths(
        cycle_length: int, blend_frames: int, frames_before: int, frames_after: int
    ) -> SeamBlend:
        """Return the blend of the last frames of a cycle."""
        blend_length = min(blend_frames, cycle_length)
        frames_from_blend = np.arange(cycle_length) - (cycle_length - blend_length)
        s = np.clip(frames_from_blend / max(blend_length, 1), 0, 1)[:, None, None]
        offset_weight = s**3 * (10 - 15 * s + 6 * s**2)
        speed_weight = blend_length * s**3 * (-4 + 7 * s - 3 * s**2)
        return SeamBlend(
            cycle_length, frames_before, frames_after, offset_weight, speed_weight
        )

    @property
    def blended_frames(self) -> slice:
        """The blended frames at the end of the cycle."""
        (frames,) = np.nonzero(self.offset_weight[:, 0, 0])
        first = int(frames[0]) if len(frames) else self.cycle_length
        return slice(first, self.cycle_length)

    def cycle_and_next(self, values: npt.NDArray[_Value]) -> npt.NDArray[_Value]:
        """Return the frames of the cycle and the next frame ``(L + 1, ...)``."""
        return values[self.frames_before : self.frames_before + self.cycle_length + 1]

    def end_frames(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the frames from which start and end speeds are estimated.

        They are the frames on either side if both ends have them; else, if the cycle
        spans the full take, three frames at each end.
        """
        extra_frames = self.frames_before + self.frames_after
        if extra_frames:
            end_offsets = np.array([0, extra_frames])
            return values[end_offsets], values[end_offsets + self.cycle_length]
        return values[:3], values[-3:]


def close_vectors(
    values: FloatArray, blend: SeamBlend, to_next_cycle: NextCycle
) -> FloatArray:
    """Return a cycle of vectors ``(L, A, K)`` whose end blends into the next cycle."""
    cycle = blend.cycle_and_next(values)
    start_frames, end_frames = blend.end_frames(values)
    missing_velocity = _missing_speed(
        np.diff(to_next_cycle(start_frames), axis=0),
        np.diff(end_frames, axis=0),
        lambda: np.diff(cycle, axis=0),
        blend,
    )
    offset = to_next_cycle(cycle[:1])[0] - cycle[-1]
    corrected_values, blend_frames = cycle[:-1].copy(), blend.blended_frames
    corrected_values[blend_frames] += (
        blend.offset_weight[blend_frames] * offset
        + blend.speed_weight[blend_frames] * missing_velocity
    )
    return corrected_values


def close_rotations(
    values: FloatArray, blend: SeamBlend, to_next_cycle: NextCycle
) -> FloatArray:
    """Return a cycle of rotations ``(L, A, 4)`` that blends into the next cycle."""
    cycle = blend.cycle_and_next(values)
    start_frames, end_frames = blend.end_frames(values)
    offset = so3.multiply(so3.conjugate(cycle[-1]), to_next_cycle(cycle[:1])[0])
    # Speeds are about the joint's own axes, which the offset rotates.
    end_speeds = so3.rotate(so3.conjugate(offset), so3.steps(end_frames))
    missing_velocity = _missing_speed(
        so3.steps(to_next_cycle(start_frames)),
        end_speeds,
        lambda: so3.steps(cycle),
        blend,
    )
    corrected_values, blend_frames = cycle[:-1].copy(), blend.blended_frames
    weights = blend.offset_weight[blend_frames, :, 0]
    correction = so3.slerp(so3.IDENTITY, offset, weights)
    offset_rotations = so3.multiply(corrected_values[blend_frames], correction)
    speed_correction = so3.exp(blend.speed_weight[blend_frames] * missing_velocity)
    corrected_values[blend_frames] = so3.multiply(offset_rotations, speed_correction)
    return corrected_values


def _missing_speed(
    start_speeds: FloatArray,
    end_speeds: FloatArray,
    measure_steps: Callable[[], FloatArray],
    blend: SeamBlend,
) -> FloatArray:
    """Return the speed that a cycle's end lacks to match its start ``(A, K)``.

    The speed is in units per frame. ``measure_steps`` returns the steps between frames
    ``(L, A, K)``.
    """
    extra_frames = blend.frames_before + blend.frames_after
    if extra_frames:
        return np.asarray((start_speeds[0] - end_speeds[0]) / extra_frames)
    steps = measure_steps()
    if len(steps) < 2:
        return np.zeros(steps.shape[1:])
    mean_rate = (end_speeds[1] - end_speeds[0] + start_speeds[1] - start_speeds[0]) / 2
    missing_speed = start_speeds[0] - end_speeds[1] - mean_rate
    magnitude = np.linalg.norm(missing_speed, axis=-1, keepdims=True)
    largest_changes = np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=0)
    excess = np.maximum(
        magnitude - NATURAL_CHANGE_FRACTION * largest_changes[:, None], 0
    )
    divisor = np.where(magnitude > 0, magnitude, 1)
    return np.asarray(missing_speed * (excess / divisor))


def map_attributes(
    track: Track, transforms: Transforms, function: Callable[[FloatArray], FloatArray]
) -> Transforms:
    """Return transforms with a function applied to them and their numeric attributes.

    ``function`` maps values ``(F, A, K)``.
    """

    def map_numbers(values: FloatArray) -> FloatArray:
        """Return the values of an attribute mapped column by column."""
        columns = values.reshape(len(values), -1, 1)
        mapped_columns = function(columns)
        return mapped_columns.reshape(len(mapped_columns), *values.shape[1:])

    attributes = zip(track.attributes, transforms.values, strict=True)
    return Transforms(
        map_numbers(transforms.translations),
        function(transforms.rotations[:, None])[:, 0],
        map_numbers(transforms.scales),
        None if transforms.matrices is None else map_numbers(transforms.matrices),
        tuple(map_numbers(values) if a.width else values for a, values in attributes),
        transforms.is_clamped,
    )


def resample_track(track: Track, transforms: Transforms) -> Track:
    """Return a track sampled at times 0, 1, 2 ..., clamped at its ends.

    Between samples, rotations follow the shortest arc, numbers are linear and tokens
    are held.
    """
    count = len(transforms)

    def sample(times: FloatArray) -> Transforms:
        """Return the transforms at times."""
        positions = frame_positions(times, count)

        def interpolate(values: FloatArray) -> FloatArray:
            """Return values interpolated at the positions."""
            all_rows = np.arange(values.shape[1])
            return positions.interpolate(Channel(values[0], all_rows, values)).values

        mapped_transforms = map_attributes(track, transforms, interpolate)
        resampled_values = tuple(
            mapped_transforms.values[i]
            if attribute.width
            else transforms.values[i][positions.frames]
            for i, attribute in enumerate(track.attributes)
        )
        is_clamped = transforms.is_clamped
        if is_clamped is not None:
            is_clamped = is_clamped[positions.frames]
        return replace(
            mapped_transforms, values=resampled_values, is_clamped=is_clamped
        )

    return replace(track, sample=sample)


# Ends that differ by more than this fraction of the cycle's extent visibly slide.
MAX_GOOD_SEAM = 0.2


_DEFAULT_OPTIONS = LoopOptions()


def loop(
    take: Take,
    first: float | None = None,
    last: float | None = None,
    *,
    repeats: int = _DEFAULT_OPTIONS.repeats,
    blend: int = _DEFAULT_OPTIONS.blend,
) -> Take:
    """Repeat a cycle of a take seamlessly; `find_cycle` searches for a cycle.

    The frame ``last`` is the first of the next cycle and is not shown itself. Over the
    ``blend`` frames before it, the missing offset and speed are added, so that neither
    jumps; speeds are most accurate if the take has frames on either side of the cycle.

    The joint that carries the character keeps its travel: each cycle continues, on the
    ground and about the up axis, from the end of the previous one. This joint is a
    root, or the topmost moving joint below a static root. Tracks keep their travel,
    too. A take of one frame stays unchanged.

    Args:
        take: A take of F frames.
        first: First time code of the cycle; None uses the take's first.
        last: Time code that shows the first pose again; None uses the take's last.
        repeats: Number of cycles shown, at least 1.
        blend: Number of changed frames before the seam, at least 0.

    Raises:
        OptionError: A frame is outside the take (SCN013), there is no cycle or
            repeat (SCN018), or there would be too many frames (SCN021).
    """
    check_loaded(take, Take, "take")
    clock = take.clock
    if clock.count == 1:
        return take
    first_index, last_index = range_end_indices(clock, first, last)
    if last_index <= first_index:
        raise empty_cycle_error(clock, first_index, last_index)
    _check_minimum(repeats, 1, "repeats")
    _check_minimum(blend, 0, "blend")
    cycle_length = last_index - first_index
    check_count(cycle_length * repeats)
    has_frame_before = int(first_index > 0)
    has_frame_after = int(last_index < clock.count - 1)
    seam = SeamBlend.from_lengths(
        cycle_length, blend, has_frame_before, has_frame_after
    )
    travel = cycle_travel(
        take.rig, take.motion.select(slice(first_index, last_index + 1))
    )
    frames_around = slice(
        first_index - has_frame_before, last_index + has_frame_after + 1
    )
    looper = _CycleLooper(travel, seam, repeats)
    motion = looper.loop_motion(take.motion.select(frames_around))
    tracks = take.tracks
    if tracks:
        motion, tracks = _loop_tracks(take, motion, frames_around, seam, repeats)
    first_code = clock.start + first_index * clock.step
    return replace(
        take,
        clock=replace(clock, start=first_code, count=cycle_length * repeats),
        motion=align_signs(motion).map(Channel.compact),
        tracks=tracks,
    )


def _loop_tracks(
    take: Take, motion: Motion, frames_around: slice, seam: SeamBlend, repeats: int
) -> tuple[Motion, tuple[Track, ...]]:
    """Return the looped motion with the times of looped tracks, and the tracks.

    Each track continues as a root does, and is sampled at the loop's frames.
    """
    track_times = take.motion.track_times
    assert track_times is not None
    cycle_times = track_times.select(frames_around).dense()[..., 0]
    tracks = tuple(
        _loop_track(track, track.at(cycle_times[:, i]), take.rig.up, seam, repeats)
        if track.is_animated
        else track
        for i, track in enumerate(take.tracks)
    )
    frames = np.arange(seam.cycle_length * repeats, dtype=np.float64)
    frame_columns = np.repeat(frames[:, None, None], len(tracks), axis=1)
    return replace(motion, track_times=Channel.from_dense(frame_columns)), tracks


def _loop_track(
    track: Track, transforms: Transforms, up: UpAxis, seam: SeamBlend, repeats: int
) -> Track:
    """Return a track looped like a root joint; its numbers repeat without travel."""
    root = Rig("track", (Joint("root", -1),), up=up)
    motion = Motion(
        Channel.from_dense(transforms.translations[:, None]),
        Channel.from_dense(transforms.rotations[:, None]),
    )
    cycle_frames = seam.cycle_and_next(np.arange(len(transforms)))
    looper = _CycleLooper(
        cycle_travel(root, motion.select(cycle_frames)), seam, repeats
    )
    looped_motion = looper.loop_motion(motion)

    def close_numbers(values: FloatArray) -> FloatArray:
        """Return the values of an attribute, closed and repeated."""
        cycle_values = close_vectors(values, seam, lambda frame_values: frame_values)
        return np.concatenate([cycle_values] * repeats)

    def repeat(values: npt.NDArray[_Value]) -> npt.NDArray[_Value]:
        """Return repeated values of the cycle."""
        return np.tile(seam.cycle_and_next(values)[:-1], repeats)

    mapped_transforms = map_attributes(track, transforms, close_numbers)
    columns = zip(track.attributes, mapped_transforms.values, strict=True)
    is_clamped = transforms.is_clamped
    looped_transforms = replace(
        mapped_transforms,
        translations=looped_motion.translations.dense()[:, 0],
        rotations=looped_motion.rotations.dense()[:, 0],
        values=tuple(v if attribute.width else repeat(v) for attribute, v in columns),
        is_clamped=None if is_clamped is None else repeat(is_clamped),
    )
    return resample_track(track, looped_transforms)


@dataclass(frozen=True, slots=True)
class _CycleLooper:
    """Closes the channels of a cycle and repeats them with the cycle's travel."""

    cycle_travel: CycleTravel
    blend: SeamBlend
    repeats: int

    def loop_motion(self, motion: Motion) -> Motion:
        """Return the motion of all repeats."""
        return replace(
            motion.map(self.loop_numbers),
            translations=self.loop_translations(motion.translations),
            rotations=self.loop_rotations(motion.rotations),
        )

    def loop_numbers(self, channel: Channel) -> Channel:
        """Return a channel closed and repeated, without travel."""
        cycle = close_vectors(channel.values, self.blend, lambda values: values)
        return replace(channel, values=np.concatenate([cycle] * self.repeats))

    def loop_translations(self, channel: Channel) -> Channel:
        """Return translations closed and repeated, with the travel of each joint."""
        linear = self.cycle_travel.linear[channel.animated]
        shifts = self.cycle_travel.shifts[channel.animated]

        def to_next_cycle(values: FloatArray) -> FloatArray:
            """Return translations moved to the next cycle."""
            return np.asarray(np.einsum("aij,faj->fai", linear, values) + shifts)

        cycle = close_vectors(channel.values, self.blend, to_next_cycle)
        return replace(channel, values=self.repeat_cycle(cycle, to_next_cycle))

    def loop_rotations(self, channel: Channel) -> Channel:
        """Return rotations closed and repeated, with the travel of each joint."""
        travel = self.cycle_travel.rotations[channel.animated]

        def to_next_cycle(values: FloatArray) -> FloatArray:
            """Return rotations moved to the next cycle."""
            return so3.multiply(travel, values)

        cycle = close_rotations(channel.values, self.blend, to_next_cycle)
        return replace(channel, values=self.repeat_cycle(cycle, to_next_cycle))

    def repeat_cycle(self, cycle: FloatArray, to_next_cycle: NextCycle) -> FloatArray:
        """Repeat a cycle; each repetition continues where the previous one ended."""
        cycles = [cycle]
        # One step per repeat: each adds the travel to the previous one.
        for _ in range(self.repeats - 1):
            cycles.append(to_next_cycle(cycles[-1]))
        return np.concatenate(cycles)


def _check_minimum(number: int, minimum: int, name: str) -> None:
    """Raise if a number is less than its minimum."""
    if not number >= minimum:  # NaN too
        refuse("SCN018", f"{name} is {number}; it must be at least {minimum}")


def _option_checks(options: LoopOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    return {
        "last": lambda: check_range(options.first, options.last),
        "repeats": lambda: _check_minimum(options.repeats, 1, "repeats"),
        "blend": lambda: _check_minimum(options.blend, 0, "blend"),
    }


def _run(take: Take, options: LoopOptions, context: PassContext) -> Take:
    """Run the pass: find the cycle, if requested, and repeat it."""
    first, last = options.first, options.last
    if options.find:
        length_options = {"shortest": options.shortest, "longest": options.longest}
        cycle = find_cycle(take, first, last, **length_options)
        first, last = cycle.first, cycle.last
    elif take.clock.count > 1:
        cycle = measure_cycle(take, first, last)
    else:
        message = "the take has one frame: there is nothing to repeat"
        context.notices.append(warning("SCN114", message, "choose a take that moves"))
        return take
    result = loop(take, first, last, repeats=options.repeats, blend=options.blend)
    context.notices.extend(cycle_notices(cycle, take, options))
    return result


def _better_cycle(cycle: Cycle, take: Take) -> Cycle | None:
    """Return the take's best cycle if its relative error is below half of a cycle's."""
    try:
        best_cycle = find_cycle(take)
    except OptionError:
        return None
    return best_cycle if best_cycle.share < cycle.share / 2 else None


def cycle_notices(cycle: Cycle, take: Take, options: LoopOptions) -> list[Fault]:
    """Return the notices about a cycle of a take."""
    ends_text = (
        f"frames {cycle.first:g} and {cycle.last:g} differ by {1000 * cycle.apart:.2f} "
        f"mm, {100 * cycle.share:.0f}% of the motion between them"
    )
    notices = []
    if options.find:
        message = f"the best cycle: {ends_text}"
        notices.append(Fault("SCN102", message, severity=Severity.NOTE))
    if cycle.share > MAX_GOOD_SEAM:
        better_cycle = None if options.find else _better_cycle(cycle, take)
        hint = f"choose other frames with {argument('first')} and {argument('last')}, "
        hint += f"or a longer {argument('blend')}"
        if better_cycle is not None:
            first = argument("first", f"{better_cycle.first:g}")
            last = argument("last", f"{better_cycle.last:g}")
            hint = f"the best cycle of the take is {first} {last}: its ends differ by "
            hint += f"{100 * better_cycle.share:.0f}%"
        message = f"the loop has a visible seam: {ends_text}"
        notices.append(warning("SCN101", message, hint))
    cycle_length = round((cycle.last - cycle.first) / float(take.clock.step))
    # The default is not a request of the user: it blends short cycles completely.
    if options.blend > max(cycle_length, _DEFAULT_OPTIONS.blend):
        message = f"{argument('blend', options.blend)} is longer than the cycle of "
        message += f"{cycle_length} frames: every frame is changed"
        hint = (
            f"use {cycle_length // 2} or fewer; {_DEFAULT_OPTIONS.blend} is the default"
        )
        notices.append(warning("SCN115", message, hint))
    return notices


PASS = Pass(
    "loop",
    "Find a cycle and repeat it",
    LoopOptions,
    FrameScope.CLIP,
    _run,
    _option_checks,
    changes=RETIMED_PARTS - {TakePart.POINTS},
)
