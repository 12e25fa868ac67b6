"""Rules on joints: limits, bind pose, left and right."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault
from animtool.core.quantities import length_text
from animtool.core.units import unit_name
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Joint, JointType
from animtool.rig.suspicious_shape import equal_sides
from animtool.validation.subjects.rig import RigSubject

# Tolerance for degrees rounded in a file [rad], [m].
LIMIT_TOLERANCE = 1e-6
# A twist axis this close to perpendicular to its bone does not twist the bone; cos 84°.
PERPENDICULAR_COSINE = 0.1


def rest_outside_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report joints whose rest pose is outside their limits (RIG201)."""
    for joint in rig.rig.joints:
        match joint.limits:
            case RangeLimit(lower, upper):
                limits_noun = "limits"
                rest_value = 0.0 if joint.mimic is None else joint.mimic.offset
            case BallLimit(twist=(lower, upper)):
                limits_noun, rest_value = "twist limits", 0.0
            case _:
                continue
        is_inside = lower - LIMIT_TOLERANCE <= rest_value <= upper + LIMIT_TOLERANCE
        if is_inside or joint.name in rig.mirrored:
            continue
        message = (
            f"the {limits_noun} of {joint.name!r} are "
            f"{range_text(rig, joint, lower, upper)}, which exclude its rest pose"
        )
        location = (*rig.at("joints", joint.name), "limits")
        hint = "limits are relative to the rest pose, which is 0"
        yield rig.fault("RIG201", location, message, hint)


def motionless_joints(rig: RigSubject) -> Iterator[Fault]:
    """Report joints whose limits allow no motion (RIG202)."""
    for joint in rig.rig.joints:
        match joint.limits:
            case RangeLimit(lower, upper):
                is_locked = upper - lower <= LIMIT_TOLERANCE
            case BallLimit(swing=(_, _) as swing, twist=(lower, upper)):
                is_locked = max(*swing, upper - lower) <= LIMIT_TOLERANCE
            case _:
                continue
        if is_locked and joint.name not in rig.mirrored:
            location = (*rig.at("joints", joint.name), "limits")
            message = f"the {joint.type} joint {joint.name!r} cannot move"
            yield rig.fault("RIG202", location, message, "write type: fixed")


def twist_axis_across_bone(rig: RigSubject) -> Iterator[Fault]:
    """Report ball joints whose twist axis is perpendicular to their bone (RIG203)."""
    for i, joint in enumerate(rig.rig.joints):
        limits = joint.limits
        bone = _bone_direction(rig, i)
        if not isinstance(limits, BallLimit) or limits.twist is None or bone is None:
            continue
        if abs(float(bone @ np.array(limits.twist_axis))) < PERPENDICULAR_COSINE:
            if joint.name in rig.mirrored:
                continue
            location = (*rig.at("joints", joint.name), "limits", "twist_axis")
            axis = _axis_text(np.array(limits.twist_axis))
            message = (
                f"the twist axis {axis} of {joint.name!r} is perpendicular to its "
                f"bone, which points along {_axis_text(bone)}"
            )
            hint = f"twist_axis: {_axis_text(bone)} rotates the bone about itself"
            yield rig.fault("RIG203", location, message, hint)


def mimics_beyond_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report mimic joints that their source drives beyond their limits (RIG205)."""
    for joint in rig.rig.joints:
        if joint.mimic is None or not isinstance(joint.limits, RangeLimit):
            continue
        source = rig.rig.joints[rig.rig.index(joint.mimic.joint)]
        if not isinstance(source.limits, RangeLimit) or joint.name in rig.mirrored:
            continue
        for source_limit in (source.limits.low, source.limits.high):
            value = joint.mimic.gain * source_limit + joint.mimic.offset
            if abs(float(joint.limits.excess(np.array(value)))) <= LIMIT_TOLERANCE:
                continue
            limits = range_text(rig, joint, joint.limits.low, joint.limits.high)
            message = (
                f"{joint.name!r} reaches {value_text(rig, joint, value)} where "
                f"{source.name!r} is at {value_text(rig, source, source_limit)}; its "
                f"limits are {limits}"
            )
            location = (*rig.at("joints", joint.name), "limits")
            yield rig.fault("RIG205", location, message, "widen them, or reduce gain")
            break


def range_text(rig: RigSubject, joint: Joint, lower: float, upper: float) -> str:
    """Format a range of a joint's angle or slide, such as ``-60° to 60°``."""
    return f"{value_text(rig, joint, lower)} to {value_text(rig, joint, upper)}"


def value_text(rig: RigSubject, joint: Joint, value: float) -> str:
    """Format a joint's angle or slide, [rad] or [m], in the rig's unit."""
    if joint.type is JointType.PRISMATIC:
        unit = rig.rig.meters_per_unit
        return f"{value / unit:.4g} {unit_name(unit)}"
    unit = rig.rig.radians_per_unit
    name = " rad" if unit == 1.0 else "\N{DEGREE SIGN}"
    return f"{value / unit:.4g}{name}"


def _bone_direction(rig: RigSubject, joint_index: int) -> FloatArray | None:
    """Return the direction of a joint's only bone in its rest frame, else None."""
    joints = rig.rig.joints
    offsets = [joints[child].translation for child in rig.children[joint_index]]
    offsets += joints[joint_index].tips
    if len(offsets) != 1:
        return None
    length = math.hypot(*offsets[0])
    return np.array(offsets[0]) / length if length > LIMIT_TOLERANCE else None


def _axis_text(axis: FloatArray) -> str:
    return "[" + ", ".join(f"{x + 0.0:.3g}" for x in axis) + "]"


# A bind pose that differs by less than this fraction of the rig's size, and by a
# smaller angle, is rounding.
BIND_ROUNDING_FRACTION = 1e-3
BIND_ROUNDING_ANGLE = math.radians(0.5)


def bind_nearly_rest(rig: RigSubject) -> Iterator[Fault]:
    """Report bind poses that differ from the rest pose only by rounding (RIG216)."""
    for name in rig.document.value.get("bind", {}):
        if name not in rig.rig.bind or not rig.size:
            continue
        pose, joint = rig.rig.bind[name], rig.rig.joints[rig.rig.index(name)]
        distance = math.dist(pose.translation, joint.translation)
        rotations = np.array([pose.rotation]), np.array([joint.rotation])
        angle = float(so3.angle_between(*rotations)[0])
        is_near = distance <= BIND_ROUNDING_FRACTION * rig.size
        if pose.stretch is None and is_near and angle <= BIND_ROUNDING_ANGLE:
            message = (
                f"the bind pose of {name!r} equals its rest pose except for "
                f"{length_text(distance)} and {math.degrees(angle):.3g}°"
            )
            hint = "remove it, or write the pose in which the skin was made"
            yield rig.fault("RIG216", ("bind", name), message, hint)


def bind_without_rest(rig: RigSubject) -> Iterator[Fault]:
    """Report joints that have a bind pose but no rest pose (RIG222)."""
    bind = rig.document.value.get("bind", {})
    if "from" in rig.document.value:
        return
    for i, joint in enumerate(rig.file_entries("joints")):
        pose = bind.get(joint["name"], {})
        if any(pose.get("translate") or ()) and not {"translate", "rotate"} & {*joint}:
            name, parent = joint["name"], joint.get("parent")
            position = f"where {parent!r} is" if parent else "at the origin"
            message = f"{name!r} has a bind pose but no rest pose: it rests {position}"
            hint = f"translate: {pose['translate']} is its position in the bind pose"
            yield rig.fault("RIG222", ("joints", i), message, hint)


# Positions that differ by a smaller fraction of the rig's size are equal [1].
POSITION_TOLERANCE = 1e-4
# Limits that differ by less are equal [rad], [m].
EQUAL_LIMIT_TOLERANCE = 1e-6


def asymmetric_positions(rig: RigSubject) -> Iterator[Fault]:
    """Report paired bones that are not mirror images at rest (RIG212)."""
    pairs, are_mirrored = _mirror_pairs(rig)
    if not _is_symmetric(are_mirrored):
        return
    coincident_pairs = equal_sides(rig.rig, rig.rest[0])  # reported when it was read
    for (left, right), is_mirrored in zip(pairs, are_mirrored.tolist(), strict=True):
        indices = rig.rig.index(left.name), rig.rig.index(right.name)
        if not is_mirrored and indices not in coincident_pairs:
            location = (*rig.at("joints", right.name), "translate")
            message = f"{right.name!r} is not the mirror image of {left.name!r} at rest"
            hint = f"mirror: {right.name} in {left.name!r} creates it"
            yield rig.fault("RIG212", location, message, hint)


def asymmetric_limits(rig: RigSubject) -> Iterator[Fault]:
    """Report paired joints with different types or limits (RIG213)."""
    pairs, are_mirrored = _mirror_pairs(rig)
    if not _is_symmetric(are_mirrored):
        return
    for left, right in pairs:
        key = "limits"
        if left.type is not right.type:
            key = "type"
        elif _same_limits(left, right):
            continue
        location = (*rig.at("joints", right.name), key)
        message = f"{right.name!r} has a different {key} than {left.name!r}"
        if key == "limits":
            message = f"{right.name!r} has different limits than {left.name!r}"
        hint = f"mirror: {right.name} in {left.name!r} creates it"
        yield rig.fault("RIG213", location, message, hint)


@lru_cache(maxsize=1)
def _mirror_pairs(rig: RigSubject) -> tuple[list[tuple[Joint, Joint]], BoolArray]:
    """Return the left/right joint pairs in a file, and a mask of mirror images."""
    partners = pair_sides(rig.rig.names, rig.rig.parents).partners.tolist()
    # A joint that is mirrored has its partner from the file's reader.
    pairs = [
        (joint, rig.rig.joints[partner])
        for i, (joint, partner) in enumerate(zip(rig.rig.joints, partners, strict=True))
        if partner > i and not joint.mirror
    ]
    return pairs, _are_mirror_images(rig, pairs)


def _are_mirror_images(rig: RigSubject, pairs: list[tuple[Joint, Joint]]) -> BoolArray:
    """Return a mask of the pairs mirrored in the most common plane ``(P,)``."""
    positions, _ = rig.rest
    parents = rig.rig.parents
    bone_vectors = positions - np.where(parents[:, None] < 0, 0.0, positions[parents])
    left_vectors, right_vectors = (
        bone_vectors[[rig.rig.index(pair[side].name) for pair in pairs]].reshape(-1, 3)
        for side in (0, 1)
    )
    tolerance = POSITION_TOLERANCE * max(rig.size, POSITION_TOLERANCE)
    best_mirrored = np.zeros(len(pairs), bool)
    largest_count = -1
    for axis in range(3):
        mirror_signs = np.ones(3)
        mirror_signs[axis] = -1.0
        distances = np.linalg.norm(left_vectors * mirror_signs - right_vectors, axis=1)
        is_mirrored = distances <= tolerance
        # Bones in the plane are equal, whichever plane it is.
        is_across = is_mirrored & (np.abs(left_vectors[:, axis]) > tolerance)
        if int(np.count_nonzero(is_across)) > largest_count:
            largest_count = int(np.count_nonzero(is_across))
            best_mirrored = is_mirrored
    return best_mirrored


def _is_symmetric(are_mirrored: BoolArray) -> bool:
    """Return whether at least half of several pairs are mirror images."""
    mirrored_count = int(np.count_nonzero(are_mirrored))
    return len(are_mirrored) > 1 and 2 * mirrored_count >= len(are_mirrored)


def _same_limits(left: Joint, right: Joint) -> bool:
    match left.limits, right.limits:
        case RangeLimit(low, high), RangeLimit(other_low, other_high):
            return _same_range((low, high), (other_low, other_high))
        case BallLimit() as left_limits, BallLimit() as right_limits:
            swings = sorted(left_limits.swing or ()), sorted(right_limits.swing or ())
            is_same_swing = len(swings[0]) == len(swings[1]) and np.allclose(
                *swings, rtol=0, atol=EQUAL_LIMIT_TOLERANCE
            )
            if left_limits.twist is None or right_limits.twist is None:
                return bool(is_same_swing) and left_limits.twist == right_limits.twist
            is_same_twist = _same_range(left_limits.twist, right_limits.twist)
            return bool(is_same_swing) and is_same_twist
        case left_limits, right_limits:
            return left_limits is None and right_limits is None


def _same_range(first: tuple[float, float], second: tuple[float, float]) -> bool:
    """Return whether two ranges are equal or mirrored."""
    return any(
        np.allclose(first, candidate, rtol=0, atol=EQUAL_LIMIT_TOLERANCE)
        for candidate in (second, (-second[1], -second[0]))
    )
