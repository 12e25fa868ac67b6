"""Detects implausible values, and left and right sides that are swapped or static."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.quantities import percent_hint, plain_number
from animtool.maths import so3
from animtool.retarget.swapped_sides import SWAPPED_SIDES_HINT, find_swapped_sides
from animtool.validation.motion.body import body_carriers
from animtool.validation.motion.subject import MotionSubject

# Files of a bind pose often have two equal frames, since players need two, and some
# last two seconds: from a longer take the recording is missing [frame], [s].
BIND_FRAME_COUNT, MAX_BIND_SECONDS = 2, 2.0
# Joints that move a rigid mesh or hold something, and so need no weights.
RIGID_NAMES = re.compile(
    r"eye|jaw|teeth|tongue|lid|prop|weapon|attach|socket|target"
    r"|(?<![a-z])(end|nub|tip|site|root)(?![a-z])|(?<=[a-z])(End|Nub|Tip|_end|_tip)",
    re.IGNORECASE,
)
# A smaller scale makes geometry invisible [1].
MIN_VISIBLE_SCALE = 1e-4
# Weights beyond 1 exaggerate; larger ones are in percent, or wrong [1].
MAX_PLAUSIBLE_WEIGHT, MIN_PLAUSIBLE_WEIGHT = 2.0, -1.0
MIN_PERCENT_WEIGHT = 10.0
# Largest length ratio of bones between bind and rest pose, and the fraction of bones
# that may exceed it; and the largest distance of the bind pose [size].
MAX_BONE_LENGTH_RATIO, MAX_DIFFERENT_BONE_FRACTION, MAX_BIND_DISTANCE_RATIO = (
    2.0,
    0.5,
    1.5,
)
MIN_BONE_LENGTH_RATIO = 0.02


def motionless_take(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if no joint or shape moves (MOT201)."""
    motion = subject.take.motion
    if motion.frames <= BIND_FRAME_COUNT:
        return
    channels = (motion.translations, motion.rotations, motion.scales, motion.weights)
    if any(channel is not None and len(channel.animated) for channel in channels):
        return
    message = f"nothing moves in {motion.frames} frames"
    hint = "if it is a pose, one frame is enough; else export the take again"
    joint = 0 if subject.take.rig.joints else None
    fault = subject.fault("MOT201", joint, None, message, hint)
    is_short = (motion.frames - 1) * subject.interval <= MAX_BIND_SECONDS
    yield replace(fault, severity=Severity.NOTE) if is_short else fault


def zero_scale(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if joints are scaled to almost 0 along an axis (MOT218)."""
    scales = subject.take.motion.scales
    if scales is None:
        return
    scale_values = scales.dense()
    is_zero = np.asarray(np.abs(scale_values).min(axis=2) < MIN_VISIBLE_SCALE)
    zero_joints = np.flatnonzero(is_zero.any(axis=0))
    if not len(zero_joints):
        return
    names = [subject.take.rig.joints[joint].name for joint in zero_joints.tolist()]
    zero_frames = np.flatnonzero(is_zero.any(axis=1))
    message = (
        f"{listed([repr(name) for name in names])} "
        f"{'is' if len(names) == 1 else 'are'} scaled to 0 in "
        f"{counted(len(zero_frames), 'frame')}, first in frame "
        f"{subject.time_text(int(zero_frames[0]))}, so everything below vanishes"
    )
    hint = "to hide meshes, animate their visibility instead"
    yield subject.fault(
        "MOT218", int(zero_joints[0]), int(zero_frames[0]), message, hint
    )


def large_weights(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if shape weights are far outside 0 to 1 (MOT219)."""
    weights = subject.take.motion.weights
    # A clip with such keys is reported when it is read.
    is_reported = any(notice.code == "CLIP121" for notice in subject.take.notices)
    if weights is None or is_reported:
        return
    weight_values = weights.dense()[..., 0]
    is_large = (weight_values > MAX_PLAUSIBLE_WEIGHT) | (
        weight_values < MIN_PLAUSIBLE_WEIGHT
    )
    if not is_large.any():
        return
    largest_index = int(np.where(is_large, np.abs(weight_values), 0).argmax())
    frame, shape = np.unravel_index(largest_index, weight_values.shape)
    shapes = subject.take.rig.shapes
    names = [shapes[s].name for s in np.flatnonzero(is_large.any(axis=0))]
    name = shapes[int(shape)].name
    other_names = [repr(other_name) for other_name in names if other_name != name]
    message = (
        f"shape {name!r} has weight {weight_values[frame, shape]:.4g} at frame "
        f"{subject.time_text(int(frame))}"
    )
    message += f"; also {listed(other_names)}" if other_names else ""
    largest_weight = float(np.abs(weight_values).max())
    hint = "weights must be from 0 to 1"
    if largest_weight > MIN_PERCENT_WEIGHT:
        hint += f"; {percent_hint(largest_weight)}"
    yield subject.fault("MOT219", None, int(frame), message, hint)


def bind_far_from_rest(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if bind and rest pose differ in size or position (MOT220)."""
    if subject.bind_positions is None or not subject.has_rest:
        return
    rig, bind_positions, rest_positions = (
        subject.take.rig,
        subject.bind_positions,
        subject.rest_positions,
    )
    centroid_distance = float(
        np.linalg.norm(bind_positions.mean(axis=0) - rest_positions.mean(axis=0))
    )
    parents = rig.parents
    child_joints = np.flatnonzero(parents >= 0)
    rest_lengths = np.linalg.norm(
        rest_positions[child_joints] - rest_positions[parents[child_joints]], axis=1
    )
    is_measured = rest_lengths > MIN_BONE_LENGTH_RATIO * subject.size
    child_joints, rest_lengths = child_joints[is_measured], rest_lengths[is_measured]
    length_ratios = (
        np.linalg.norm(
            bind_positions[child_joints] - bind_positions[parents[child_joints]], axis=1
        )
        / rest_lengths
    )
    is_different = (length_ratios > MAX_BONE_LENGTH_RATIO) | (
        length_ratios < 1.0 / MAX_BONE_LENGTH_RATIO
    )
    hint = "bind transforms are in world space, in the pose in which the mesh was bound"
    if len(child_joints) and float(is_different.mean()) > MAX_DIFFERENT_BONE_FRACTION:
        most_different = int(np.abs(np.log(np.maximum(length_ratios, 1e-12))).argmax())
        joint = int(child_joints[most_different])
        message = (
            f"{np.count_nonzero(is_different)} of {len(child_joints)} bones have a "
            f"different length in the bind pose; that to {rig.joints[joint].name!r} is "
            f"{plain_number(length_ratios[most_different])} times its rest length"
        )
        yield subject.fault("MOT220", joint, None, message, hint)
        return
    if centroid_distance > MAX_BIND_DISTANCE_RATIO * subject.size:
        message = (
            f"the bind pose is {centroid_distance:.3g} m from the rest pose, of a "
            f"skeleton that spans {subject.size:.3g} m"
        )
        yield subject.fault("MOT220", int(rig.roots[0]), None, message, hint)
        return
    joint_distances = np.linalg.norm(bind_positions - rest_positions, axis=1)
    joint = int(joint_distances.argmax())
    if joint_distances[joint] > MAX_BIND_DISTANCE_RATIO * subject.size:
        message = (
            f"{rig.joints[joint].name!r} is {joint_distances[joint]:.3g} m from its "
            "rest position in the bind pose, of a skeleton that spans "
            f"{subject.size:.3g} m"
        )
        yield subject.fault("MOT220", joint, None, message, hint)


def joints_without_influence(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if joints influence no point of any mesh (MOT221)."""
    if subject.influencing_joints is None:
        return
    rig = subject.take.rig
    idle_names = [
        name
        for name in rig.names
        if name not in subject.influencing_joints and not RIGID_NAMES.search(name)
    ]
    if not idle_names:
        return
    message = (
        f"{len(idle_names)} of {counted(len(rig.joints), 'joint')} "
        f"{'deforms' if len(idle_names) == 1 else 'deform'} no mesh: "
        f"{listed(idle_names)}"
    )
    pronoun = "it" if len(idle_names) == 1 else "them"
    hint = f"paint weights for {pronoun}, or exclude {pronoun} from the export"
    yield subject.fault("MOT221", rig.index(idle_names[0]), None, message, hint)


# A joint is static if it rotates by less in all frames; its opposite is active if it
# rotates by more [rad].
STATIC_ANGLE, ACTIVE_ANGLE = 1e-6, math.radians(20.0)
# Shorter takes are a pose [s].
MIN_TAKE_SECONDS = 0.2
# Minimum rotation of each swapped joint, and of all of them together [rad].
MIN_SWAP_ANGLE, MIN_TOTAL_SWAP_ANGLE = math.radians(8.0), math.radians(30.0)
# Minimum number of steps, so that both sides move before and after a swap.
MIN_SWAP_FRAMES = 5
# Fewer pairs that swap simultaneously are just a pose.
MIN_SWAPPED_PAIRS = 2
# When two joints swap, continuing the other's motion leaves at most this fraction of
# the deviation from continuing the own motion [1].
MAX_SWAP_RATIO = 0.35
# For a single pair the fraction is lower, and the step larger [1], [rad].
MAX_SINGLE_SWAP_RATIO, MIN_SINGLE_SWAP_ANGLE = 0.1, math.radians(20.0)


def _side_pairs(subject: MotionSubject) -> list[tuple[int, int]]:
    """Return index pairs of left and right joints, matched by their names."""
    partners = subject.sides.partners
    return [(left, int(partners[left])) for left in subject.sides.left]


def swapped_sides(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if left and right are swapped in any or all frames (MOT210)."""
    subject = subject.without_first_pose
    pairs = _side_pairs(subject)
    if not pairs:
        return
    full_take_faults = list(_full_take_swap(subject))
    yield from full_take_faults or _side_swaps(subject, pairs)


def _full_take_swap(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if left joints are on the right side of the body in all frames."""
    swap = find_swapped_sides(
        subject.take.rig, subject.positions, subject.size, subject.sides
    )
    # The reader of a file reports it when it is baked, too.
    is_reported = any(notice.code == "MOT210" for notice in subject.take.notices)
    if swap is not None and not is_reported:
        hint, frame = SWAPPED_SIDES_HINT, swap.first_frame
        yield subject.fault("MOT210", swap.left_joint, frame, swap.message, hint)


def _side_swaps(
    subject: MotionSubject, pairs: list[tuple[int, int]]
) -> Iterator[Fault]:
    """Yield a fault at the step where the left and right joints swap their motion."""
    rotations = subject.take.motion.rotations
    moving_joints = set(rotations.animated.tolist())
    pairs = [pair for pair in pairs if moving_joints.issuperset(pair)]
    if not pairs or subject.frame_count < MIN_SWAP_FRAMES:
        return
    left = rotations.gather(np.array([pair[0] for pair in pairs]))
    right = rotations.gather(np.array([pair[1] for pair in pairs]))
    left_steps = so3.angle_between(left[1:], left[:-1])
    steps = np.minimum(left_steps, so3.angle_between(right[1:], right[:-1]))
    from_same_side, from_other_side = _side_deviations(left, right)
    reverse_from_same, reverse_from_other = _side_deviations(left[::-1], right[::-1])
    from_other_side = np.minimum(from_other_side, reverse_from_other[::-1])
    is_swapped = from_same_side > MIN_SWAP_ANGLE
    is_swapped &= from_other_side < MAX_SWAP_RATIO * from_same_side
    is_swapped &= _is_continuous_swap(steps, from_same_side, reverse_from_same[::-1])
    is_swapped &= ~subject.cut_mask()[:, None]
    total_angle = np.where(is_swapped, from_same_side, 0.0).sum(axis=1)
    has_enough_pairs = is_swapped.sum(axis=1) >= min(MIN_SWAPPED_PAIRS, len(pairs))
    is_certain = from_same_side > MIN_SINGLE_SWAP_ANGLE
    is_certain &= from_other_side < MAX_SINGLE_SWAP_RATIO * from_same_side
    is_large_swap = (total_angle > MIN_TOTAL_SWAP_ANGLE) & has_enough_pairs
    is_swapped &= is_large_swap[:, None] | is_certain
    swap_steps = np.flatnonzero(is_swapped.any(axis=1))
    if not len(swap_steps):
        return
    step, names = int(swap_steps[0]), subject.take.rig.names
    swapped_pairs = [pairs[i] for i in np.flatnonzero(is_swapped[step]).tolist()]
    pair_texts = [f"{names[i]!r} and {names[j]!r}" for i, j in swapped_pairs]
    until_text = ""
    if len(swap_steps) > 1:
        until_text = f", until frame {subject.time_text(int(swap_steps[1]))}"
    frame_text = f"at frame {subject.time_text(step + 1)}{until_text}"
    message = f"{listed(pair_texts)} swap {frame_text}"
    hint = "swap their channels there; markers of the two sides were mixed up"
    yield subject.fault("MOT210", swapped_pairs[0][0], step, message, hint)


def _side_deviations(
    left: FloatArray, right: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return deviations from the extrapolated same and opposite side ``(F - 1, P)``.

    The first is the smaller one of both sides, the second the larger one [rad].
    """
    same_side = np.minimum(
        _extrapolation_error(left, left), _extrapolation_error(right, right)
    )
    other_side = np.maximum(
        _extrapolation_error(left, right), _extrapolation_error(right, left)
    )
    return same_side, other_side


def _extrapolation_error(rotations: FloatArray, predictors: FloatArray) -> FloatArray:
    """Return the angle between rotations and the extrapolation of predictor rotations.

    Both are ``(F, P, 4)``, the result is ``(F - 1, P)`` [rad]. Predictors either hold
    still or repeat the rotation of the previous step: the smaller angle counts.
    """
    rotations_per_step = so3.multiply(predictors[1:-1], so3.conjugate(predictors[:-2]))
    predicted_rotations = predictors[:-1].copy()
    predicted_rotations[1:] = so3.multiply(rotations_per_step, predictors[1:-1])
    angles = so3.angle_between(rotations[1:], predicted_rotations)
    return np.minimum(angles, so3.angle_between(rotations[1:], predictors[:-1]))


def _is_continuous_swap(
    steps: FloatArray, deviation: FloatArray, reverse_deviation: FloatArray
) -> BoolArray:
    """Return a mask of swaps between steps of continuous motion ``(F - 1, P)``.

    Held poses of a library, and alternating ones, swap sides intentionally.
    ``deviation`` is relative to the motion before each step, ``reverse_deviation`` to
    the motion after it.
    """
    padded_steps = np.pad(steps, ((1, 1), (0, 0)))
    is_moving = np.minimum(padded_steps[:-2], padded_steps[2:]) > STATIC_ANGLE
    zero_row = np.zeros((1, steps.shape[1]))
    deviation_before = np.concatenate([zero_row, deviation[:-1]])
    deviation_after = np.concatenate([reverse_deviation[1:], zero_row])
    largest_deviation = np.maximum(deviation_before, deviation_after)
    return np.asarray(is_moving & (largest_deviation < MAX_SWAP_RATIO * deviation))


def motionless_side(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if joints never rotate although their opposites do (MOT211)."""
    channel = subject.take.motion.rotations
    roots = [*subject.take.rig.roots, *body_carriers(subject)]
    moving_joints = [*subject.rotating_joints, *subject.translating_joints]
    # With a static root, parts were keyed one by one, and one arm may wave alone.
    has_static_root = set(roots).isdisjoint(moving_joints)
    seconds = (subject.frame_count - 1) * subject.interval
    if seconds < MIN_TAKE_SECONDS or has_static_root:
        return
    angle_ranges = np.zeros(len(subject.take.rig.joints))
    angles = so3.angle_between(channel.values, channel.values[:1])
    # A single deviating frame is no motion.
    angle_ranges[channel.animated] = np.maximum(
        np.percentile(angles, 90, axis=0) if len(channel.animated) else 0.0,
        np.minimum(angles.max(axis=0, initial=0.0), 2.0 * STATIC_ANGLE),
    )
    pairs: list[tuple[int, int]] = []
    for left, right in _side_pairs(subject):
        for joint_index, opposite in ((left, right), (right, left)):
            if (
                angle_ranges[joint_index] <= STATIC_ANGLE
                and angle_ranges[opposite] >= ACTIVE_ANGLE
            ):
                pairs.append((joint_index, opposite))
    if not pairs:
        return
    names = subject.take.rig.names
    joint_index, opposite = pairs[0]
    other_names = [names[i] for i, _ in pairs[1:]]
    message = (
        f"{names[joint_index]!r} never rotates, but {names[opposite]!r} does, by "
        f"{math.degrees(angle_ranges[opposite]):.0f}°"
    )
    message += f"; nor do {listed(other_names)}" if other_names else ""
    hint = "its sensor or its channels were lost"
    yield subject.fault("MOT211", joint_index, None, message, hint)
