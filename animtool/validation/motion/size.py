"""Checks the size and stance of bodies: units, up axis, bone lengths."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from operator import itemgetter

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted
from animtool.core.quantities import plain_number
from animtool.motion.quaternion_order import ORDER_HINT, find_swapped_order
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.root_position import (
    UNIT_FACTORS,
    factor_text,
    height_factor,
    low_height_factor,
    root_warning,
)
from animtool.retarget.standing import (
    UP_AXIS_HINTS,
    Stance,
    has_swapped_channels,
    measure_stance,
)
from animtool.rig.body_size import (
    MIN_CHARACTER_JOINTS,
    find_feet,
    fitting_unit,
    is_character,
    size_warning_texts,
)
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import JointType
from animtool.validation.motion.body import (
    body_joints,
    hips_of,
    positioned_joints,
)
from animtool.validation.motion.subject import MotionSubject

# Fraction by which a bone's length may change, and length below which a bone counts as
# zero [size].
MAX_STRETCH, MIN_BONE_LENGTH = 0.5, 0.02
# Tolerance of a unit factor [1].
UNIT_FACTOR_TOLERANCE = 0.15
# Fraction of animated bones that must share one factor [1].
MIN_SCALED_FRACTION = 0.8
# A rig with a larger fraction of finger joints is a hand, not a body [1].
FINGER_NAMES = re.compile("thumb|index|middle|ring|pinky|finger", re.IGNORECASE)
MAX_FINGER_FRACTION = 0.8
# Plausible extent of any skeleton, with or without feet, from an insect to a ship [m].
SKELETON_SIZE_RANGE = (0.004, 400.0)
# With fewer frames, a take is a pose, which may lie.
MIN_STANCE_FRAMES = 8


def stretched_bones(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if a bone's length changes by more than 50 % (MOT212)."""
    subject = subject.without_first_pose
    if not subject.has_rest or _bone_factor(subject) is not None:
        return
    is_positioned = positioned_joints(subject)
    stretches: list[tuple[float, int, int, float, float]] = []
    channel = subject.take.motion.translations
    for channel_index, joint_index in enumerate(channel.animated.tolist()):
        joint = subject.take.rig.joints[joint_index]
        rest_length = math.hypot(*joint.translation)
        if joint.type is JointType.PRISMATIC or is_positioned[joint_index]:
            continue
        if rest_length <= MIN_BONE_LENGTH * subject.rest_size:
            continue
        lengths = np.linalg.norm(channel.values[:, channel_index], axis=1)
        strains = np.abs(lengths / rest_length - 1.0)
        frame = int(strains.argmax())
        if strains[frame] > MAX_STRETCH:
            strain, length = float(strains[frame]), float(lengths[frame])
            stretches.append((strain, joint_index, frame, length, rest_length))
    if not stretches:
        return
    _, joint_index, frame, length, rest_length = max(stretches, key=itemgetter(0))
    other_count = len(stretches) - 1
    repeat_text = ""
    if other_count:
        verb = "changes" if other_count == 1 else "change"
        repeat_text = f"; {counted(other_count, 'more bone')} {verb} too"
    message = (
        f"the bone to {subject.take.rig.joints[joint_index].name!r} is {length:.3g} m "
        f"long at frame {subject.time_text(frame)}, but {rest_length:.3g} m at "
        f"rest{repeat_text}"
    )
    hint = "translation keys replace the rest translation and are not added to it; "
    hint += "remove them if the bone should not stretch"
    yield subject.fault("MOT212", joint_index, frame, message, hint)


def _bone_factor(subject: MotionSubject) -> float | None:
    """Return the ratio of animated to rest bone lengths if it is a unit conversion."""
    rig, translations = subject.take.rig, subject.take.motion.translations
    child_joints = np.flatnonzero(~positioned_joints(subject))
    rest_lengths = np.linalg.norm(rig.rest_translations[child_joints], axis=1)
    is_measured = rest_lengths > MIN_BONE_LENGTH * subject.rest_size
    child_joints, rest_lengths = child_joints[is_measured], rest_lengths[is_measured]
    if not len(child_joints):
        return None
    lengths = np.linalg.norm(translations.gather(child_joints), axis=2)
    ratios = np.median(lengths, axis=0) / rest_lengths
    return _unit_factor(ratios)


def _unit_factor(ratios: FloatArray) -> float | None:
    """Return the unit conversion factor that most of the ratios are close to."""
    if not len(ratios):
        return None
    for factor in (*UNIT_FACTORS, *(1.0 / factor for factor in UNIT_FACTORS)):
        is_near = np.abs(ratios / factor - 1.0) < UNIT_FACTOR_TOLERANCE
        if float(is_near.mean()) >= MIN_SCALED_FRACTION:
            return factor
    return None


def mismatched_units(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the motion or the character is in another unit (MOT213)."""
    subject = subject.without_first_pose
    # The reader of a file reports its unit when it is baked, too.
    is_reported = any(notice.code == "MOT213" for notice in subject.take.notices)
    if is_reported:
        return
    unit_factor = _bone_factor(subject) if subject.has_rest else None
    if unit_factor is not None:
        message = (
            f"the bones are {factor_text(unit_factor)} as long as those of the rig at "
            "rest, so the animation probably uses another unit"
        )
        hint = "convert the animation, or set metersPerUnit of its layer"
        yield subject.fault("MOT213", None, 0, message, hint)
        return
    root_and_factor = _root_factor(subject)
    if root_and_factor is not None:
        root, unit_factor = root_and_factor
        message = (
            f"the root {subject.take.rig.joints[root].name!r} is "
            f"{factor_text(unit_factor)} as high as at rest: its translation uses "
            "another unit"
        )
        hint = "convert the root's translations to the unit of the rig"
        yield subject.fault("MOT213", root, 0, message, hint)
        return
    size, unit = subject.size, subject.take.rig.meters_per_unit
    likely_unit = fitting_unit(subject.take.rig.names, size, unit)
    if likely_unit is None or not subject.has_units:
        return
    message, hint = size_warning_texts(size, unit, likely_unit, subject.file_format)
    yield subject.fault("MOT213", None, None, message, hint)


def _root_factor(subject: MotionSubject) -> tuple[int, float] | None:
    """Return a root that is too high or low for another unit, and the unit factor.

    If the rig rests at its hips, their height is the length of its legs.
    """
    if not subject.has_rest or not is_character(subject.take.rig.names):
        return None
    rig = subject.take.rig
    translating_joints = set(subject.translating_joints.tolist())
    heights = subject.rest_positions @ subject.up_vector
    leg_length = float(heights[hips_of(subject)] - heights[find_feet(rig.names)].min())
    min_height = 0.1 * subject.rest_size
    for root in sorted({*rig.roots, hips_of(subject)} & translating_joints):
        rest_height = float(heights[root])
        is_resting_at_hips = rest_height < min_height
        if max(rest_height, leg_length) < min_height:
            continue
        height = float(np.median(subject.heights[:, root]))
        ratio = height / (leg_length if is_resting_at_hips else rest_height)
        # At 1/100 of its height, a root is at 0, like a root with another origin.
        factor = height_factor(ratio)
        if ratio < 1.0:
            factor = low_height_factor(
                subject.positions[:, root],
                subject.positions[:, body_joints(subject)],
                subject.up_vector,
                subject.size,
                subject.interval,
            )
        if factor is None and not is_resting_at_hips:
            factor = _unit_factor(np.array([ratio]))
        if factor is not None and abs(math.log10(factor)) > 1.5:
            return int(root), factor
    return None


def _length_text(meters: float) -> str:
    """Return a length as text in a fitting unit.

    >>> _length_text(0.0012), _length_text(158.0)
    ('1.2 mm', '158 m')
    """
    if meters < 0.01:
        return f"{plain_number(1000.0 * meters)} mm"
    if meters < 1.0:
        return f"{100.0 * meters:.3g} cm"
    return f"{meters:.4g} m"


def implausible_size(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the size of the skeleton is implausible (MOT215)."""
    min_size, max_size = SKELETON_SIZE_RANGE
    if not subject.has_units:
        return
    # A watch in millimetres is meant.
    min_size = min(min_size, subject.take.rig.meters_per_unit)
    if len(subject.take.rig.joints) < 2 or min_size <= subject.size <= max_size:
        return
    if is_character(subject.take.rig.names) and any(mismatched_units(subject)):
        return
    if subject.size * 1e3 < min_size * 1e-3:
        # All joints are at one position: a rig of controls, or a single joint.
        return
    message = f"the skeleton spans {_length_text(subject.size)}"
    unit = subject.take.rig.meters_per_unit
    hint = f"check its unit, {unit:g} m"
    yield subject.fault("MOT215", None, None, message, hint)


def tilted_stance(subject: MotionSubject) -> Stance | None:
    """Return the stance of a body that is not upright along the up axis; else None."""
    rig = subject.take.rig
    is_short = subject.frame_count < MIN_STANCE_FRAMES
    if is_short or len(rig.joints) < MIN_CHARACTER_JOINTS:
        return None
    finger_count = sum(map(bool, map(FINGER_NAMES.search, rig.names)))
    if finger_count > MAX_FINGER_FRACTION * len(rig.joints):
        return None
    rest_positions = rest_world(rig).positions[0] if subject.has_rest else None
    roles = find_anatomy(rig).roles
    stance = measure_stance(roles, subject.positions, rig.up, rest_positions)
    return None if stance.axis is None and not stance.is_upside_down else stance


def swapped_quaternions(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if quaternion components seem to be in the other order (MOT222)."""
    order = find_swapped_order(subject.take.rig, subject.take.motion)
    if order is not None and subject.has_rest:
        yield subject.fault("MOT222", None, None, order.message, ORDER_HINT)


def far_root(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the root stays far from the origin (MOT223)."""
    rig = subject.take.rig
    is_reported = any(notice.code == "MOT223" for notice in subject.take.notices)
    problem = root_warning(rig, subject.take.motion) if subject.has_rest else None
    if problem is not None and problem.code == "MOT223" and not is_reported:
        message, hint = problem.message, problem.hint
        yield subject.fault("MOT223", int(rig.roots[0]), 0, message, hint or "")


def mismatched_up_axis(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the body is upright along an axis that is not up (MOT214)."""
    rig, stance = subject.take.rig, tilted_stance(subject)
    if has_swapped_channels(subject.take.notices):
        return
    if stance is None:
        # The bake of a file reports it, too.
        is_reported = any(notice.code == "MOT214" for notice in subject.take.notices)
        problem = root_warning(rig, subject.take.motion) if subject.has_rest else None
        if problem is not None and problem.code == "MOT214" and not is_reported:
            message, hint = problem.message, problem.hint
            yield subject.fault("MOT214", int(rig.roots[0]), 0, message, hint or "")
        return
    direction = (
        "is upside down" if stance.axis is None else f"stands along {stance.axis}"
    )
    percent_of_frames = f"{100.0 * stance.fraction:.0f}%"
    frames_text = f"{percent_of_frames} of the frames"
    frames_text = "every frame" if percent_of_frames == "100%" else frames_text
    message = f"the body {direction} in {frames_text}; the up axis is {rig.up}"
    hint = "rotate the root"
    if stance.axis is not None:
        hint = UP_AXIS_HINTS.get(subject.file_format, "").format(stance.axis)
        hint = hint or f"read the file with {argument('source.up', stance.axis)}"
    fault = subject.fault("MOT214", int(rig.roots[0]), 0, message, hint)
    # A file without an up axis is read with the default one.
    yield fault if subject.has_units else replace(fault, severity=Severity.NOTE)
