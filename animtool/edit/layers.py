"""Layering of takes: layers, blends and differences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock, time_codes
from animtool.core.errors import Fault, counted, refuse, warning
from animtool.core.loaded import check_loaded
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.edit.between import TakeSampler
from animtool.edit.combine import (
    BlendStrength,
    add_delta,
    align_signs,
    interpolate_motions,
    match_rig,
    sample_other_take,
    subtract_base,
)
from animtool.edit.frames import check_count, exact_fraction, frame_index
from animtool.edit.tree import match_joints
from animtool.motion.key_times import weight_warnings
from animtool.motion.keyed import (
    KeyInterpolation,
    WeightOption,
    parse_choice,
    weights_at,
)
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    MOTION_PARTS,
    FrameScope,
    OptionChecks,
    Pass,
    PassContext,
    PlacedJoint,
    required_take_path,
)
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig

# Displacement of a joint from its target that is visible, relative to the rig's size.
MIN_DISPLACEMENT = 0.01


@dataclass(frozen=True, slots=True)
class BlendOptions:
    """The second take of a blend, its weight and timing.

    Attributes:
        take: File of the other take.
        weight: Weight of the other take [1]: a number, or pairs ``[frame, weight]``.
        interpolation: Interpolation between the pairs of a weight curve.
        delay: Delay of the other take relative to this one [time code].
    """

    take: Path | None = None
    weight: float | tuple[tuple[float, float], ...] = 0.5
    interpolation: KeyInterpolation = KeyInterpolation.LINEAR
    delay: float = 0.0


def blend(
    take: Take,
    other: Take,
    *,
    weight: WeightOption = 0.5,
    interpolation: KeyInterpolation | str = KeyInterpolation.LINEAR,
    delay: float = 0.0,
) -> Take:
    """Return the weighted mean of two takes, on the clock of the first.

    The result runs from the first frame of ``take`` to the end of the later one; each
    is clamped at its ends. The other starts ``delay`` later.

    Args:
        take: A take of F frames, whose clock the result has.
        other: A take of K frames of the same rig, at any rate.
        weight: Weight of the other take, 0 to 1 [1]: a number, or pairs of a time code
            and a weight.
        interpolation: Interpolation between the pairs of a weight curve.
        delay: Delay of the other take [time codes].

    Raises:
        OptionError: The delay is not finite (SCN013), a weight is not finite or not
            from 0 to 1 (SCN014), its curve malformed (SCN015), the rigs differ
            (SCN017), there would be too many frames (SCN021), or there is no such
            interpolation (SCN025).
    """
    check_loaded(take, Take, "take")
    check_loaded(other, Take, "other")
    other = match_rig(take.rig, other)
    clock = take.clock
    delay_frames = exact_fraction(delay, "delay") / clock.step
    other_length = (other.clock.count - 1) * clock.rate / other.clock.rate
    frame_count = max(clock.count, 1 + math.floor(delay_frames + other_length))
    check_count(frame_count)
    full_clock = replace(clock, count=frame_count)
    weights = weights_at(weight, full_clock.times, interpolation)
    strength = BlendStrength(weights, isinstance(weight, (int, float)))
    first_motion = sample_other_take(take, clock.rate, 0, frame_count)
    second_motion = sample_other_take(other, clock.rate, 0, frame_count, delay_frames)
    motion = align_signs(interpolate_motions(first_motion, second_motion, strength))
    return replace(take, clock=full_clock, motion=motion.map(Channel.compact))


def _run_blend(take: Take, options: BlendOptions, context: PassContext) -> Take:
    """Run the pass: blend with another take."""
    warnings = weight_warnings(options.weight, take.clock, in_shot=context.in_shot)
    context.notices.extend(warnings)
    other_take = context.take(options.take)
    blended_take = blend(
        take,
        other_take,
        weight=options.weight,
        interpolation=options.interpolation,
        delay=options.delay,
    )
    context.notices.extend(
        _distance_warning(take, other_take, blended_take.clock, options)
    )
    return blended_take


# Takes this many sizes of the rig apart are not blended without a visible slide [1].
MAX_BLEND_DISTANCE = 2.0


def _distance_warning(
    take: Take, other_take: Take, clock: Clock, options: BlendOptions
) -> list[Fault]:
    """Return a warning if roots are far apart while a weight changes (SCN122)."""
    if isinstance(options.weight, (int, float)) or not take.rig.joints:
        return []
    weights = weights_at(options.weight, clock.times, options.interpolation)
    (changing_frames,) = np.nonzero(np.diff(weights))
    if not len(changing_frames):
        return []
    delay_frames = exact_fraction(options.delay, "delay") / clock.step
    other_take = match_rig(take.rig, other_take)
    root, positions = int(take.rig.roots[0]), []
    for each, delay in ((take, Fraction(0)), (other_take, delay_frames)):
        motion = sample_other_take(each, clock.rate, 0, clock.count, delay)
        frames = motion.translations.gather(np.array([root]))[:, 0]
        positions.append(np.broadcast_to(frames, (clock.count, 3))[changing_frames])
    distances = np.linalg.norm(positions[0] - positions[1], axis=1)
    worst_index = int(distances.argmax())
    if distances[worst_index] <= MAX_BLEND_DISTANCE * rest_size(take.rig):
        return []
    time_code = float(clock.times[changing_frames[worst_index]])
    message = (
        f"the takes are {length_text(float(distances[worst_index]))} apart at frame "
    )
    message += f"{time_code:g}, where the weight changes: the body slides from one to "
    message += "the other"
    hint = "bring one of them to where the other is, or blend where they meet"
    return [warning("SCN122", message, hint)]


def _check_blend(options: BlendOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    return {
        "take": lambda: required_take_path(options.take),
        "weight": lambda: weights_at(options.weight, np.zeros(0)),
        "delay": lambda: exact_fraction(options.delay, "delay"),
    }


BLEND = Pass(
    "blend",
    "Blend with another take",
    BlendOptions,
    FrameScope.CLIP,
    _run_blend,
    _check_blend,
    changes=MOTION_PARTS,
)


@dataclass(frozen=True, slots=True)
class DifferenceOptions:
    """The base take of a difference.

    Attributes:
        base: File of the base take; None uses the rest pose of the rig.
        frame: Time code of the base whose pose is subtracted; None compares frame by
            frame, with the first frames aligned.
    """

    base: Path | None = None
    frame: float | None = None


def difference(
    take: Take, base: Take | None = None, frame: float | None = None
) -> Take:
    """Return the additive take that turns ``base`` into ``take``.

    The layer pass adds it back, with the convention of `animtool.maths.additive`.

    Args:
        take: A take of F frames.
        base: Base take, resampled to the take's rate and clamped at its ends; None uses
            the rest pose.
        frame: Time code of the base whose pose is subtracted; None compares frame by
            frame.

    Raises:
        OptionError: The base has no such frame (SCN013), is of another rig
            (SCN017), or a scale of it is 0 (SCN023).
    """
    check_loaded(take, Take, "take")
    if base is not None:
        check_loaded(base, Take, "base")
    base_take = rest_take(take.rig, take.clock) if base is None else base
    return _subtract_stream(TakeStream.of(take), _base_take(base_take, frame)).collect()


def rest_take(rig: Rig, clock: Clock) -> Take:
    """Return a one-frame take of a rig at rest, on the rate of a clock."""
    static = Channel.static
    motion = Motion(static(rig.rest_translations), static(rig.rest_rotations))
    return Take(rig, replace(clock, count=1), motion)


def _base_take(base: Take, frame: float | None) -> Take:
    """Return the base take, or one frame of it; raise if a scale is 0."""
    if frame is not None:
        index = frame_index(base.clock, frame, "frame")
        motion = base.motion.select(slice(index, index + 1)).map(Channel.compact)
        base = replace(base, clock=replace(base.clock, count=1), motion=motion)
    scales = base.motion.scales
    if scales is not None:
        is_zero = (scales.dense() == 0).any(axis=(0, 2))
        if is_zero.any():
            name = base.rig.names[int(np.argmax(is_zero))]
            refuse("SCN023", f"joint {name!r} has a scale of 0 in the base")
    return base


def _subtract_stream(stream: TakeStream, base: Take) -> TakeStream:
    """Return a stream of deltas from a base."""
    base = match_rig(stream.rig, base)
    return replace(stream, blocks=_difference_blocks(stream, base))


def _difference_blocks(stream: TakeStream, base: Take) -> Iterator[Motion]:
    """Yield the deltas from the base, with continuous quaternion signs."""
    first, last_rotations = 0, None
    rate, sampler = stream.fps / stream.step, TakeSampler.from_take(base)
    for block in stream.blocks:
        base_motion = sample_other_take(sampler, rate, first, block.frames)
        motion = align_signs(subtract_base(block, base_motion), last_rotations)
        yield motion
        first, last_rotations = first + block.frames, motion.rotations.values[-1]


def _run_difference(
    stream: TakeStream, options: DifferenceOptions, context: PassContext
) -> TakeStream:
    """Run the pass: subtract the base or the rest pose."""
    if options.base is None:
        first_code = stream.first_frame
        base = rest_take(stream.rig, Clock(stream.fps, first_code, stream.step, 1))
    else:
        base = context.take(options.base, "base")
    return _subtract_stream(stream, _base_take(base, options.frame))


DIFFERENCE = Pass(
    "difference",
    "Make an additive take",
    DifferenceOptions,
    FrameScope.FRAME,
    _run_difference,
    changes=MOTION_PARTS,
)


# Distance from the rest offset within which a joint is posed by it, in its length [1].
POSE_TOLERANCE = 0.25


class LayerMode(StrEnum):
    """How a layer combines with the take below it."""

    ADDITIVE = "additive"
    OVERRIDE = "override"


@dataclass(frozen=True, slots=True)
class LayerOptions:
    """The take of a layer, the affected joints, and the weight.

    Attributes:
        take: File of the other take.
        mode: ``override`` blends towards the other take; ``additive`` adds it, and
            it must be a difference (see the pass of that name).
        weight: Weight [1]: a number, or pairs ``[frame, weight]``; 0 to 1 for
            ``override``, any for ``additive``.
        interpolation: Interpolation between the pairs of a weight curve.
        joints: Names or patterns of the affected joints; empty affects all of them,
            including shapes and controls.
        children: Whether the joints below these are affected too.
        delay: Delay of the other take relative to this one [time code].
    """

    take: Path | None = None
    mode: LayerMode = LayerMode.OVERRIDE
    weight: float | tuple[tuple[float, float], ...] = 1.0
    interpolation: KeyInterpolation = KeyInterpolation.LINEAR
    joints: tuple[str, ...] = ()
    children: bool = False
    delay: float = 0.0


def layer(
    take: Take,
    other: Take,
    *,
    mode: LayerMode | str = LayerMode.OVERRIDE,
    weight: WeightOption = 1.0,
    interpolation: KeyInterpolation | str = KeyInterpolation.LINEAR,
    joints: str | Sequence[str] = (),
    children: bool = False,
    delay: float = 0.0,
) -> Take:
    """Layer another take on top of a take.

    The result has the frames of ``take``. The other take starts with it, ``delay``
    later, is resampled to its rate and clamped at its ends.

    Args:
        take: A take of F frames, whose clock and rig the result has.
        other: A take of K frames of the same rig, at any rate.
        mode: ``override`` blends towards ``other``; ``additive`` adds it, and it must
            come from `difference`.
        weight: Weight of the other take [1], 0 to 1 for ``override`` and any for
            ``additive``: a number, or pairs of a time code and a weight.
        interpolation: Interpolation between the pairs of a weight curve.
        joints: Names or patterns of the affected joints; empty affects all of them,
            including shapes and controls.
        children: Whether the joints below these are affected too.
        delay: Delay of the other take [time codes].

    Raises:
        OptionError: A joint is not in the rig (SCN012), the delay is not finite
            (SCN013), a weight is not finite or out of bounds (SCN014), its curve
            malformed (SCN015), the rigs differ (SCN017), or there is no such mode
            or interpolation (SCN025).
    """
    check_loaded(take, Take, "take")
    check_loaded(other, Take, "other")
    plan = _LayerPlan(other, mode, weight, interpolation, joints, children, delay)
    return plan.layer_over(TakeStream.of(take)).collect()


@dataclass(frozen=True, slots=True)
class _LayerPlan:
    """A layer to combine with a stream, block by block."""

    other: Take
    mode: LayerMode | str
    weight: WeightOption
    interpolation: KeyInterpolation | str
    joints: str | Sequence[str]
    children: bool
    delay: float
    in_shot: bool = False
    placed_joints: tuple[PlacedJoint, ...] = ()

    def layer_over(self, stream: TakeStream) -> TakeStream:
        """Return a stream with the layer on top."""
        is_additive = parse_choice(LayerMode, self.mode, "mode") is LayerMode.ADDITIVE
        parse_choice(KeyInterpolation, self.interpolation, "interpolation")
        joints = None
        if self.joints:
            joints = match_joints(
                stream.rig, self.joints, includes_children=self.children
            )
        other = match_rig(stream.rig, self.other, is_additive=is_additive)
        self._weights(time_codes(Fraction(1), Fraction(1), 1))
        if is_additive:
            stream.notices.extend(_pose_notices(other, joints))
        return replace(stream, blocks=self._layered_blocks(stream, other, joints))

    def _weights(self, times: FloatArray) -> FloatArray:
        """Return the weights of the layer at times ``(F,)``."""
        is_bounded = self.mode == LayerMode.OVERRIDE
        return weights_at(self.weight, times, self.interpolation, is_bounded=is_bounded)

    def _layered_blocks(
        self, stream: TakeStream, other_take: Take, joints: list[int] | None
    ) -> Iterator[Motion]:
        """Yield the layered motion; add warnings about the complete take at the end.

        ``joints``: indices of the affected joints; None affects all.
        """
        first_code = stream.first_frame
        delay = exact_fraction(self.delay, "delay") / stream.step
        is_override = self.mode == LayerMode.OVERRIDE
        combine_motions = interpolate_motions if is_override else add_delta
        is_constant = isinstance(self.weight, (int, float))
        sampler = TakeSampler.from_take(other_take)
        rate = stream.fps / stream.step
        frame_count, last_rotations = 0, None
        largest_displacement = _LargestDisplacement(stream.rig, self.placed_joints)
        for block in stream.blocks:
            block_code = first_code + frame_count * stream.step
            times = time_codes(block_code, stream.step, block.frames)
            weights = self._weights(times)
            other_motion = sample_other_take(
                sampler, rate, frame_count, block.frames, delay
            )
            strength = BlendStrength(weights, is_constant, joints)
            motion = align_signs(
                combine_motions(block, other_motion, strength), last_rotations
            )
            largest_displacement.record_block(times, block, motion)
            yield motion
            frame_count += block.frames
            last_rotations = motion.rotations.values[-1]
        clock = Clock(stream.fps, first_code, stream.step, frame_count)
        stream.notices.extend(weight_warnings(self.weight, clock, in_shot=self.in_shot))
        stream.notices.extend(largest_displacement.warnings())
        if not self.in_shot:
            stream.notices.extend(_delay_warnings(other_take, self.delay, clock))


class _LargestDisplacement:
    """Largest displacement by a layer of a joint that an earlier pass placed."""

    def __init__(self, rig: Rig, placed_joints: Sequence[PlacedJoint]) -> None:
        self.rig = rig
        self.placed_joints = [p for p in placed_joints if p.joint in rig.names]
        self.distance, self.effector, self.time_code = 0.0, "", 0.0

    def record_block(self, times: FloatArray, before: Motion, after: Motion) -> None:
        """Update the displacements from a block's frames before and after the layer."""
        if not self.placed_joints:
            return
        offsets = after.world(self.rig).positions - before.world(self.rig).positions
        for placed_joint in self.placed_joints:
            distances = np.linalg.norm(
                offsets[:, self.rig.index(placed_joint.joint)], axis=1
            )
            distances = np.where(np.isin(times, placed_joint.times), distances, 0.0)
            worst_index = int(distances.argmax())
            if distances[worst_index] > self.distance:
                self.distance = float(distances[worst_index])
                self.effector = placed_joint.effector
                self.time_code = float(times[worst_index])

    def warnings(self) -> list[Fault]:
        """Return a warning if a joint leaves its target visibly (SCN120)."""
        if self.distance <= MIN_DISPLACEMENT * rest_size(self.rig):
            return []
        message = (
            f"the layer moves {self.effector!r} by up to {length_text(self.distance)} "
            f"from where ik has put it, at frame {self.time_code:g}"
        )
        return [warning("SCN120", message, "put the pass ik after this layer")]


def _delay_warnings(other_take: Take, delay: float, clock: Clock) -> list[Fault]:
    """Return a warning if a delayed take never plays (SCN118)."""
    if other_take.clock.count < 2:
        return []
    first, last = (float(clock.times[end]) for end in (0, -1))
    play_start = first + float(delay)
    seconds = (other_take.clock.count - 1) / other_take.clock.rate
    play_end = play_start + float(seconds * clock.fps)
    if first < play_end and play_start < last:
        return []
    clamped_pose = "first" if play_start >= last else "last"
    message = (
        f"with a delay of {delay:g} frames, the layered take plays from frame "
        f"{play_start:g} to {play_end:g}, but the take from {first:g} to {last:g}: its "
        f"{clamped_pose} pose is held in all frames"
    )
    hint = "delay counts frames from the first frame of the take"
    return [warning("SCN118", message, hint)]


def _pose_notices(other_take: Take, joint_indices: list[int] | None) -> list[Fault]:
    """Return a warning if an additive layer has poses, not differences (SCN119)."""
    rig = other_take.rig
    joint_rows = np.arange(len(rig.joints))
    if joint_indices is not None:
        joint_rows = np.array(joint_indices)
    rest_translations = rig.rest_translations[joint_rows]
    rest_lengths = np.linalg.norm(rest_translations, axis=1)
    has_length = (rest_lengths > 0) & (rig.parents[joint_rows] >= 0)
    if not has_length.any():
        return []
    translations = other_take.motion.translations.select(slice(0, 1)).dense()[
        0, joint_rows
    ]
    distances = np.linalg.norm(translations - rest_translations, axis=1)
    has_pose = has_length & (distances <= POSE_TOLERANCE * rest_lengths)
    if 2 * has_pose.sum() < has_length.sum():
        return []
    message = (
        f"the additive take holds whole poses: {int(has_pose.sum())} of "
        f"{counted(int(has_length.sum()), 'joint')} are at their rest offsets, which "
        "are added to those of the take, so that bones are twice as long"
    )
    hint = "use mode: override, with `joints` for a part of the body, or make an "
    hint += "additive take of it with the pass difference"
    return [warning("SCN119", message, hint)]


def _run_layer(
    stream: TakeStream, options: LayerOptions, context: PassContext
) -> TakeStream:
    """Run the pass: layer another take on top."""
    plan = _LayerPlan(
        context.take(options.take),
        options.mode,
        options.weight,
        options.interpolation,
        options.joints,
        options.children,
        options.delay,
        context.in_shot,
        tuple(context.placed_joints),
    )
    return plan.layer_over(stream)


def _check_layer(options: LayerOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    is_bounded = options.mode is LayerMode.OVERRIDE
    return {
        "take": lambda: required_take_path(options.take),
        "weight": lambda: weights_at(
            options.weight, np.zeros(0), is_bounded=is_bounded
        ),
        "delay": lambda: exact_fraction(options.delay, "delay"),
    }


LAYER = Pass(
    "layer",
    "Layer another take on top",
    LayerOptions,
    FrameScope.FRAME,
    _run_layer,
    _check_layer,
    changes=MOTION_PARTS,
)
