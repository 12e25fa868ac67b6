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
from animtool.validation.subjects.rig import RigSubject

# Beyond rounding of degrees in a file [rad], [m].
SLACK = 1e-6
# A twist axis nearer than this to a right angle with its bone does not turn the bone
# about itself; cos 84°.
ACROSS = 0.1


def rest_outside(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints whose limits exclude their rest pose (RIG201)."""
    for joint in rig.rig.joints:
        at = (*rig.at("joints", joint.name), "limits")
        hint = "limits are relative to the rest pose, which is 0"
        match joint.limits:
            case RangeLimit(low, high):
                value = 0.0 if joint.mimic is None else joint.mimic.offset
                if low - SLACK <= value <= high + SLACK:
                    continue
                ends = f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
                message = (
                    f"the limits of {joint.name!r} are {ends}, which exclude its rest "
                    "pose"
                )
            case BallLimit(twist=(low, high)) if not low <= SLACK or not high >= -SLACK:
                ends = f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
                message = (
                    f"the twist limits of {joint.name!r} are {ends}, which exclude "
                    "its rest pose"
                )
            case _:
                continue
        if joint.name in rig.mirrored:
            continue
        yield rig.fault("RIG201", at, message, hint)


def motionless(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints whose limits allow no motion (RIG202)."""
    for joint in rig.rig.joints:
        match joint.limits:
            case RangeLimit(low, high):
                locked = high - low <= SLACK
            case BallLimit(swing=(a, b), twist=(low, high)):
                locked = max(a, b, high - low) <= SLACK
            case _:
                continue
        if locked and joint.name not in rig.mirrored:
            at = (*rig.at("joints", joint.name), "limits")
            message = f"the {joint.type} joint {joint.name!r} cannot move"
            yield rig.fault("RIG202", at, message, "write type: fixed")


def across(rig: RigSubject) -> Iterator[Fault]:
    """Yield ball joints whose twist axis is across their bone (RIG203)."""
    for i, joint in enumerate(rig.rig.joints):
        limits = joint.limits
        bone = _bone(rig, i)
        if not isinstance(limits, BallLimit) or limits.twist is None or bone is None:
            continue
        if abs(float(bone @ np.array(limits.twist_axis))) < ACROSS:
            if joint.name in rig.mirrored:
                continue
            at = (*rig.at("joints", joint.name), "limits", "twist_axis")
            axis = _rounded(np.array(limits.twist_axis))
            message = (
                f"the twist axis {axis} of {joint.name!r} is perpendicular to its "
                f"bone, which points along {_rounded(bone)}"
            )
            hint = f"twist_axis: {_rounded(bone)} rotates the bone about itself"
            yield rig.fault("RIG203", at, message, hint)


def follower(rig: RigSubject) -> Iterator[Fault]:
    """Yield mimic joints that their source moves beyond their limits (RIG205)."""
    for joint in rig.rig.joints:
        if joint.mimic is None or not isinstance(joint.limits, RangeLimit):
            continue
        leader = rig.rig.joints[rig.rig.index(joint.mimic.joint)]
        if not isinstance(leader.limits, RangeLimit) or joint.name in rig.mirrored:
            continue
        for end in (leader.limits.low, leader.limits.high):
            value = joint.mimic.gain * end + joint.mimic.offset
            if abs(float(joint.limits.excess(np.array(value)))) <= SLACK:
                continue
            low, high = joint.limits.low, joint.limits.high
            message = (
                f"{joint.name!r} reaches {shown(rig, joint, value)} where "
                f"{leader.name!r} is at {shown(rig, leader, end)}; its limits are "
                f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
            )
            at = (*rig.at("joints", joint.name), "limits")
            yield rig.fault("RIG205", at, message, "widen them, or reduce gain")
            break


def shown(rig: RigSubject, joint: Joint, value: float) -> str:
    """Return a joint coordinate in the rig's unit."""
    if joint.type is JointType.PRISMATIC:
        unit = rig.rig.meters_per_unit
        return f"{value / unit:.4g} {unit_name(unit)}"
    unit = rig.rig.radians_per_unit
    name = " rad" if unit == 1.0 else "\N{DEGREE SIGN}"
    return f"{value / unit:.4g}{name}"


def _bone(rig: RigSubject, i: int) -> FloatArray | None:
    """Return the direction of a joint's only bone in its rest frame, if it has one."""
    ends = [rig.rig.joints[child].translation for child in rig.children[i]]
    ends += rig.rig.joints[i].tips
    if len(ends) != 1:
        return None
    length = math.hypot(*ends[0])
    return np.array(ends[0]) / length if length > SLACK else None


def _rounded(axis: FloatArray) -> str:
    return "[" + ", ".join(f"{x + 0.0:.3g}" for x in axis) + "]"


# A bind pose that differs by less of the rig's size, and by a smaller angle, is a slip.
SLIP = 1e-3
SLIP_ANGLE = math.radians(0.5)


def nearly_rest(rig: RigSubject) -> Iterator[Fault]:
    """Yield bind poses that differ from rest only by rounding (RIG216)."""
    for name in rig.document.value.get("bind", {}):
        if name not in rig.rig.bind or not rig.size:
            continue
        pose, joint = rig.rig.bind[name], rig.rig.joints[rig.rig.index(name)]
        away = math.dist(pose.translation, joint.translation)
        rotations = np.array([pose.rotation]), np.array([joint.rotation])
        angle = float(so3.angle_between(*rotations)[0])
        plain = pose.stretch is None
        if plain and away <= SLIP * rig.size and angle <= SLIP_ANGLE:
            message = (
                f"the bind pose of {name!r} equals its rest pose except for "
                f"{length_text(away)} and {math.degrees(angle):.3g}°"
            )
            hint = "remove it, or write the pose in which the skin was made"
            yield rig.fault("RIG216", ("bind", name), message, hint)


def without_rest(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints that have a bind pose but no rest pose (RIG222)."""
    bind = rig.document.value.get("bind", {})
    if "from" in rig.document.value:
        return
    for i, entry in enumerate(rig.written("joints")):
        pose = bind.get(entry["name"], {})
        if any(pose.get("translate") or ()) and not {"translate", "rotate"} & {*entry}:
            name, above = entry["name"], entry.get("parent")
            location = f"where {above!r} is" if above else "at the origin"
            message = f"{name!r} has a bind pose but no rest pose: it rests {location}"
            hint = f"translate: {pose['translate']} is its position in the bind pose"
            yield rig.fault("RIG222", ("joints", i), message, hint)


# Bones that differ by less of the rig's size are alike [1].
SAME_POSITION = 1e-4
# Limits that differ by less are alike [rad], [m].
SAME_LIMIT = 1e-6


def other_position(rig: RigSubject) -> Iterator[Fault]:
    """Yield paired bones that are not mirror images at rest (RIG212)."""
    pairs, mirrored = _compared(rig)
    if not _symmetric(mirrored):
        return
    for (left, right), same in zip(pairs, mirrored.tolist(), strict=True):
        if not same:
            at = (*rig.at("joints", right.name), "translate")
            message = f"{right.name!r} is not the mirror image of {left.name!r} at rest"
            hint = f"mirror: {right.name} in {left.name!r} creates it"
            yield rig.fault("RIG212", at, message, hint)


def other_limits(rig: RigSubject) -> Iterator[Fault]:
    """Yield paired joints with different types or limits (RIG213)."""
    pairs, mirrored = _compared(rig)
    if not _symmetric(mirrored):
        return
    for left, right in pairs:
        what = "limits"
        if left.type is not right.type:
            what = "type"
        elif _same_limits(left, right):
            continue
        at = (*rig.at("joints", right.name), what)
        message = f"{right.name!r} has a different {what} than {left.name!r}"
        if what == "limits":
            message = f"{right.name!r} has different limits than {left.name!r}"
        hint = f"mirror: {right.name} in {left.name!r} creates it"
        yield rig.fault("RIG213", at, message, hint)


@lru_cache(maxsize=1)
def _compared(rig: RigSubject) -> tuple[list[tuple[Joint, Joint]], BoolArray]:
    """Return the pairs of a rig, and which are mirror images."""
    pairs = _pairs(rig)
    return pairs, _mirrored(rig, pairs)


def _pairs(rig: RigSubject) -> list[tuple[Joint, Joint]]:
    """Return joints and their counterparts that were written separately."""
    partners = pair_sides(rig.rig.names, rig.rig.parents).partners.tolist()
    return [
        (joint, rig.rig.joints[other])
        for i, (joint, other) in enumerate(zip(rig.rig.joints, partners, strict=True))
        if other > i and not joint.mirror
    ]


def _mirrored(rig: RigSubject, pairs: list[tuple[Joint, Joint]]) -> BoolArray:
    """Return which pairs are mirror images in the most common plane ``(P,)``."""
    positions, _ = rig.rest
    parents = rig.rig.parents
    bones = positions - np.where(parents[:, None] < 0, 0.0, positions[parents])
    left, right = (
        bones[[rig.rig.index(pair[side].name) for pair in pairs]].reshape(-1, 3)
        for side in (0, 1)
    )
    best = np.zeros(len(pairs), bool)
    for axis in range(3):
        across = np.ones(3)
        across[axis] = -1.0
        off = np.linalg.norm(left * across - right, axis=1)
        mirrored = off <= SAME_POSITION * max(rig.size, SAME_POSITION)
        # Bones in the plane itself are alike in any.
        if np.count_nonzero(mirrored) > np.count_nonzero(best):
            best = mirrored
    return best


def _symmetric(mirrored: BoolArray) -> bool:
    """Return whether a rig is meant to be symmetric."""
    return len(mirrored) > 1 and 2 * int(np.count_nonzero(mirrored)) >= len(mirrored)


def _same_limits(left: Joint, right: Joint) -> bool:
    match left.limits, right.limits:
        case RangeLimit() as one, RangeLimit() as two:
            return _same_range((one.low, one.high), (two.low, two.high))
        case BallLimit() as one, BallLimit() as two:
            swings = (one.swing or (), two.swing or ())
            same = len(swings[0]) == len(swings[1]) and np.allclose(
                sorted(swings[0]), sorted(swings[1]), rtol=0, atol=SAME_LIMIT
            )
            if one.twist is None or two.twist is None:
                return bool(same) and one.twist == two.twist
            return bool(same) and _same_range(one.twist, two.twist)
        case one, two:
            return one is None and two is None


def _same_range(one: tuple[float, float], two: tuple[float, float]) -> bool:
    """Return whether two ranges are equal or mirrored."""
    return any(
        np.allclose(one, other, rtol=0, atol=SAME_LIMIT)
        for other in (two, (-two[1], -two[0]))
    )
