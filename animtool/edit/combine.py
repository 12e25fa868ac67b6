"""Combines two motions of one rig: interpolated or added, with continuous signs.

Addition of each kind of channel is defined in `animtool.maths.additive`.

Rows that are static in both motions are stored once, unless the weight changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import listed, refuse
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.edit.between import TakeSampler
from animtool.edit.travel import even_positions
from animtool.maths import additive, so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import transform_motion
from animtool.motion.take import Take
from animtool.rig.controls import Control
from animtool.rig.parts import Shape
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig

# A dot product of quaternions above this is positive despite rounding.
MIN_POSITIVE_DOT = 1e-12
MAX_NAMED_PARTS = 6


def align_signs(motion: Motion, last_rotations: FloatArray | None = None) -> Motion:
    """Make the quaternion signs of a motion continuous along its frames.

    ``last_rotations``: last rotations before the motion ``(A, 4)``.
    """
    channel = motion.rotations
    if not channel.values.size:
        return motion
    if last_rotations is None:
        last_rotations = channel.values[0]
    dots = np.einsum("fak,fak->fa", channel.values[1:], channel.values[:-1])
    first_dots = np.einsum("ak,ak->a", channel.values[0], last_rotations)
    if min(dots.min(initial=1.0), first_dots.min()) > MIN_POSITIVE_DOT:
        return motion
    values = so3.align_signs(channel.values, last_rotations)
    return replace(motion, rotations=replace(channel, values=values))


# Maps both values (F, A, K) and weights (F, 1, 1) to values (F, A, K).
Operation: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class ChannelOperations:
    """The operation on each kind of channel; ``scalars`` for weights and controls."""

    translations: Operation
    rotations: Operation
    scales: Operation
    scalars: Operation


@dataclass(frozen=True, slots=True)
class BlendStrength:
    """Weight of the second motion, and the joints it affects."""

    weights: FloatArray  # weight in each frame [1] ``(F,)``
    is_constant: bool = True  # whether the weight is constant, in all blocks
    # Affected joints; None affects all, including shapes and controls.
    joints: Sequence[int] | None = None


def check_same_rig(rig: Rig, other_rig: Rig) -> None:
    """Raise if two rigs differ in a joint's name or parent (SCN017)."""
    if rig.names == other_rig.names and np.array_equal(rig.parents, other_rig.parents):
        return
    missing_joints = sorted(set(rig.names) ^ set(other_rig.names))
    problem = "joints are in different positions"
    if missing_joints:
        problem = f"joint {missing_joints[0]!r} is in only one of them"
    message = f"the takes are of different rigs, {rig.name!r} with {len(rig.joints)} "
    message += f"joints and {other_rig.name!r} with {len(other_rig.joints)}: {problem}"
    refuse("SCN017", message, hint="retarget one of them first")


def match_rig(rig: Rig, other_take: Take, *, is_additive: bool = False) -> Take:
    """Convert another take to the up axis, shape order and control order of a rig.

    Both have the same joints. Deltas are rotations in the frames of the joints,
    whatever the up axis.
    """
    check_same_rig(rig, other_take.rig)
    shape_order = _part_order("shapes", rig.shapes, other_take.rig.shapes)
    control_order = _part_order("controls", rig.controls, other_take.rig.controls)
    rotation = up_from_up(rig.up, other_take.rig.up)
    if rotation is None and shape_order is None and control_order is None:
        return other_take
    roots, placement = np.array(rig.roots, np.int64), None
    if rotation is not None:
        placement = Placement.from_rotation(np.array(rotation))

    def match_motion(motion: Motion) -> Motion:
        """Return a motion in the axes and the order of the rig."""
        motion = replace(
            motion,
            weights=_reorder(motion.weights, shape_order),
            controls=_reorder(motion.controls, control_order),
        )
        if placement is None:
            return motion
        rotations = motion.rotations
        motion = transform_motion(motion, roots, placement)
        return replace(motion, rotations=rotations) if is_additive else motion

    matched_rig, curve = other_take.rig, other_take.curve
    if shape_order is not None:
        rig_shapes = tuple(matched_rig.shapes[i] for i in shape_order)
        matched_rig = replace(matched_rig, shapes=rig_shapes)
    if control_order is not None:
        rig_controls = tuple(matched_rig.controls[i] for i in control_order)
        matched_rig = replace(matched_rig, controls=rig_controls)
    if placement is not None:
        matched_rig = transform_rig(matched_rig, placement, rig.up)
    return replace(
        other_take,
        rig=matched_rig,
        motion=match_motion(other_take.motion).map(Channel.compact),
        curve=None if curve is None else lambda times: match_motion(curve(times)),
    )


def _part_order(
    noun: str, parts: Sequence[Shape | Control], other_parts: Sequence[Shape | Control]
) -> IntArray | None:
    """Return each part's index in the other rig; None if the orders are equal."""
    part_names, other_part_names = (
        [part.name for part in group] for group in (parts, other_parts)
    )
    if part_names == other_part_names or not part_names or not other_part_names:
        return None
    if sorted(part_names) != sorted(other_part_names):
        unmatched_names = listed(
            sorted({*part_names} ^ {*other_part_names}), MAX_NAMED_PARTS
        )
        message = f"the takes are of different rigs: {noun} that only one of them has: "
        refuse("SCN017", f"{message}{unmatched_names}")
    return np.array([other_part_names.index(name) for name in part_names], np.int64)


def _reorder(channel: Channel | None, order: IntArray | None) -> Channel | None:
    """Reorder the rows of a channel, if there is a channel and an order."""
    if channel is None or order is None:
        return channel
    return Channel.from_dense(channel.dense()[:, order])


def combine(
    base: Motion,
    other_motion: Motion,
    operations: ChannelOperations,
    strength: BlendStrength,
) -> Motion:
    """Return the combination of two motions with the same frames and rig.

    A motion with no scales has scale 1, and with no shape weights 0; controls
    change only if both motions have controls.
    """

    def combine_numbers(name: str) -> Channel | None:
        """Return combined weights or controls."""
        a: Channel | None = getattr(base, name)
        b: Channel | None = getattr(other_motion, name)
        has_both = a is not None and b is not None
        if strength.joints is not None or (name == "controls" and not has_both):
            return a
        if a is not None and b is not None and a.rest.shape != b.rest.shape:
            refuse(
                "SCN017", f"one take has {len(a.rest)} {name}, the other {len(b.rest)}"
            )
        return _combine_optional(a, b, 0.0, operations.scalars, strength)

    return Motion(
        _combine_channels(
            base.translations,
            other_motion.translations,
            operations.translations,
            strength,
        ),
        _combine_channels(
            base.rotations, other_motion.rotations, operations.rotations, strength
        ),
        _combine_optional(
            base.scales, other_motion.scales, 1.0, operations.scales, strength
        ),
        combine_numbers("weights"),
        combine_numbers("controls"),
        base.track_times,
    )


def _combine_optional(
    a: Channel | None,
    b: Channel | None,
    neutral_value: float,
    operation: Operation,
    strength: BlendStrength,
) -> Channel | None:
    """Combine two channels; a missing one has a neutral value everywhere."""
    if a is None:
        if b is None:
            return None
        a = _neutral_values(b, neutral_value)
    if b is None:
        b = _neutral_values(a, neutral_value)
    return _combine_channels(a, b, operation, strength)


def _neutral_values(channel: Channel, value: float) -> Channel:
    """Return a constant channel with the same rows as another."""
    return Channel.static(np.full(channel.rest.shape, value), len(channel.values))


def _combine_channels(
    a: Channel, b: Channel, operation: Operation, strength: BlendStrength
) -> Channel:
    """Apply an operation to the affected rows of two channels, with the weights."""
    rows = np.arange(len(a.rest))
    if strength.joints is not None:
        rows = np.array(strength.joints, np.int64)
    is_moving = np.isin(rows, np.union1d(a.animated, b.animated))
    is_moving |= not strength.is_constant
    moving_rows, fixed_rows = rows[is_moving], rows[~is_moving]
    weights = strength.weights[:, None, None]
    rest_values = a.rest.copy()
    if len(fixed_rows) and len(weights):
        rest_of_both = a.rest[fixed_rows][None], b.rest[fixed_rows][None]
        rest_values[fixed_rows] = operation(*rest_of_both, weights[:1])[0]
    result = replace(a, rest=rest_values)
    if len(moving_rows):
        values_of_both = a.gather(moving_rows), b.gather(moving_rows)
        result = result.put(moving_rows, operation(*values_of_both, weights))
    return result


def add_delta(base: Motion, delta: Motion, strength: BlendStrength) -> Motion:
    """Return a motion with a weighted delta on top.

    Weights may be above 1 or negative. Signs of rotations may jump.

    >>> from animtool.motion.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> motion, full = Motion(one, turn), BlendStrength(np.ones(1))
    >>> found = add_delta(motion, motion, full)
    >>> found.translations.rest.tolist(), found.rotations.rest.round(2).tolist()
    ([[2.0, 2.0, 2.0]], [[0.96, 0.0, 0.0, 0.28]])
    """
    return combine(base, delta, _ADD, strength)


def subtract_base(source: Motion, base: Motion) -> Motion:
    """Return the delta from ``base`` to ``source``; `add_delta` reverses it.

    Scales of the base must not be 0. Signs of rotations may jump.

    >>> from animtool.motion.take import Channel
    >>> one = Channel.from_dense(np.ones((1, 1, 3)))
    >>> turn = Channel.from_dense(np.array([[[0.6, 0, 0, 0.8]]]))
    >>> subtract_base(Motion(one, turn), Motion(one, turn)).rotations.rest.tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    return combine(source, base, _SUBTRACT, BlendStrength(np.ones(source.frames)))


def _full_difference(operation: additive.Difference) -> Operation:
    """Return an operation that computes a difference and ignores the weights."""
    return lambda source, base, _: operation(source, base)


_ADD = ChannelOperations(
    additive.add_offset,
    additive.add_rotation,
    additive.multiply_scale,
    additive.add_offset,
)
_SUBTRACT = ChannelOperations(
    _full_difference(additive.offset_delta),
    _full_difference(additive.rotation_delta),
    _full_difference(additive.scale_delta),
    _full_difference(additive.offset_delta),
)


def interpolate_motions(
    base: Motion, other_motion: Motion, strength: BlendStrength
) -> Motion:
    """Interpolate between two motions with a weight from 0 to 1.

    Rotations follow the shortest arc (slerp), other values are linear; at weight 0 and
    1 the values are exactly those of one motion. Signs of rotations may jump.

    >>> from animtool.motion.take import Channel
    >>> zero, one = (Channel.from_dense(np.full((1, 1, 3), x)) for x in (0.0, 1.0))
    >>> turn = Channel.from_dense(np.array([[[0.0, 0, 0, 1]]]))
    >>> start, end = Motion(zero, turn), Motion(one, turn)
    >>> half = interpolate_motions(start, end, BlendStrength(np.array([0.5])))
    >>> half.translations.rest.tolist()
    [[0.5, 0.5, 0.5]]
    """
    return combine(base, other_motion, _INTERPOLATE, strength)


def _interpolate_linear(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    """Interpolate values linearly, exact at weights 0 and 1."""
    return np.where(weight == 1, b, a + (b - a) * weight)


def _interpolate_rotations(
    a: FloatArray, b: FloatArray, weight: FloatArray
) -> FloatArray:
    """Interpolate rotations by slerp, exact at weights 0 and 1."""
    slerped_rotations = so3.slerp(a, b, weight[..., 0])
    # Equal values stay bit-identical.
    is_unchanged = (weight == 0) | (a == b).all(axis=-1, keepdims=True)
    return np.where(is_unchanged, a, np.where(weight == 1, b, slerped_rotations))


_INTERPOLATE = ChannelOperations(
    _interpolate_linear,
    _interpolate_rotations,
    _interpolate_linear,
    _interpolate_linear,
)


def sample_other_take(
    other_take: Take | TakeSampler,
    rate: Fraction,
    first_index: int,
    frame_count: int,
    delay: Fraction = Fraction(0),
) -> Motion:
    """Return another take at ``frame_count`` frames of a rate [1/s].

    First frames coincide, whatever the time codes; ``delay`` starts it later [frame].
    Before its first and after its last frame the take holds that frame.
    Its curves are evaluated. Pass a `TakeSampler` to read block by block, so that all
    blocks have the same animated rows.
    """
    sampler = (
        other_take
        if isinstance(other_take, TakeSampler)
        else TakeSampler.from_take(other_take)
    )
    clock = sampler.take.clock
    frame_indices = np.arange(first_index, first_index + frame_count)
    positions = even_positions(frame_indices, -delay, clock.rate / rate, clock.count)
    return sampler.sample(positions, has_fixed_rows=sampler is other_take)
