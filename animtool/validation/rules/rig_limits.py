"""Limits of joints against their rest pose, their axes and their followers."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType
from animtool.units import unit_name
from animtool.validation.subjects.rig import RigSubject

# Beyond rounding of degrees in a file [rad], [m].
SLACK = 1e-6
# A twist axis nearer than this to a right angle with its bone does not turn the bone
# about itself; cos 84°.
ACROSS = 0.1


def rest_outside(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints whose limits leave their rest pose out (RIG201)."""
    for joint in rig.rig.joints:
        at = (*rig.at("joints", joint.name), "limits")
        hint = "limits count from the rest pose, which is 0"
        match joint.limits:
            case RangeLimit(low, high):
                value = 0.0 if joint.mimic is None else joint.mimic.offset
                if low - SLACK <= value <= high + SLACK:
                    continue
                ends = f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
                message = f"{joint.name!r} may go from {ends}, and rests outside"
            case BallLimit(twist=(low, high)) if not low <= SLACK or not high >= -SLACK:
                ends = f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
                message = f"{joint.name!r} may twist from {ends}, and rests outside"
            case _:
                continue
        if joint.name in rig.mirrored:
            continue
        yield rig.fault("RIG201", at, message, hint)


def motionless(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints that their limits leave no motion (RIG202)."""
    for joint in rig.rig.joints:
        match joint.limits:
            case RangeLimit(low, high):
                still = high - low <= SLACK
            case BallLimit(swing=(a, b), twist=(low, high)):
                still = max(a, b, high - low) <= SLACK
            case _:
                continue
        if still and joint.name not in rig.mirrored:
            at = (*rig.at("joints", joint.name), "limits")
            message = f"the {joint.type} joint {joint.name!r} can go nowhere"
            yield rig.fault("RIG202", at, message, "type: fixed says so")


def across(rig: RigSubject) -> Iterator[Fault]:
    """Yield ball joints that twist across their bone (RIG203)."""
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
                f"the twist axis {axis} of {joint.name!r} is at right angles to its "
                f"bone, which points along {_rounded(bone)}"
            )
            hint = f"twist_axis: {_rounded(bone)} turns the bone about itself"
            yield rig.fault("RIG203", at, message, hint)


def follower(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints that the joint they follow leads beyond their limits (RIG205)."""
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
                f"{joint.name!r} goes to {shown(rig, joint, value)} where "
                f"{leader.name!r} is at {shown(rig, leader, end)}; its limits are "
                f"{shown(rig, joint, low)} to {shown(rig, joint, high)}"
            )
            at = (*rig.at("joints", joint.name), "limits")
            yield rig.fault("RIG205", at, message, "widen them, or lessen gain")
            break


def shown(rig: RigSubject, joint: Joint, value: float) -> str:
    """Return a coordinate of a joint in the rig's own unit."""
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
