"""Joint limits of falling agents: widened to the start pose, and applied to results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.limits import MIN_CONE, BallLimit, RangeLimit, swing_twist
from animtool.rig.skeleton import Joint, JointType, Rig


def widen_limits(rig: Rig, rotations: FloatArray) -> Rig:
    """Return a rig with limits widened to contain local rotations ``(J, 4)``.

    A walking pose may exceed the limits of its rig, and would snap back to them.
    """
    joints = zip(rig.joints, _rotations_from_rest(rig, rotations), strict=True)
    return replace(rig, joints=tuple(_widen_joint_limits(*args) for args in joints))


def clamp_to_limits(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return local rotations ``(J, 4)`` clamped to the limits of a rig.

    Squeezed bodies may have arbitrary joint rotations for some frames.
    """
    rest_rotations = _rotations_from_rest(rig, rotations)
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.PIN:
            angle = _pin_angle(joint, rest_rotations[j])
            if isinstance(joint.limits, RangeLimit):
                angle = float(joint.limits.clamped(np.array(angle)))
            rest_rotations[j] = so3.from_axis_angle(joint.axis, np.array(angle))
        elif joint.type is JointType.BALL and isinstance(joint.limits, BallLimit):
            rest_rotations[j] = joint.limits.clamped(rest_rotations[j][None])[0]
    return so3.multiply(rig.rest_rotations, rest_rotations)


def _rotations_from_rest(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return joint rotations relative to the rest pose ``(J, 4)``."""
    return so3.multiply(so3.conjugate(rig.rest_rotations), rotations)


def _pin_angle(joint: Joint, rotation: FloatArray) -> float:
    """Return the angle of a pin joint, unwrapped to the middle of its limits [rad]."""
    angle = 2 * float(np.arctan2(rotation[:3] @ np.array(joint.axis), rotation[3]))
    limits = joint.limits
    middle = (limits.low + limits.high) / 2 if isinstance(limits, RangeLimit) else 0.0
    return angle - 2 * np.pi * round((angle - middle) / (2 * np.pi))


def _widen_joint_limits(joint: Joint, rotation: FloatArray) -> Joint:
    """Return a joint with limits widened to a rotation from rest ``(4,)``."""
    limits = joint.limits
    if joint.type is JointType.PIN and isinstance(limits, RangeLimit):
        angle = _pin_angle(joint, rotation)
        widened = RangeLimit(min(limits.low, angle), max(limits.high, angle))
        return replace(joint, limits=widened)
    if joint.type is not JointType.BALL or not isinstance(limits, BallLimit):
        return joint
    swings, twists = swing_twist(rotation[None], limits.twist_axis)
    twist, swing = limits.twist, limits.swing
    if twist is not None:
        twist = min(twist[0], float(twists[0])), max(twist[1], float(twists[0]))
    if swing is not None:
        min_swing = np.maximum(swing, MIN_CONE)
        ratio = np.linalg.norm(so3.log(swings[0]) @ limits.axes[1:].T / min_swing)
        first, second = (min_swing * max(1.0, float(ratio))).tolist()
        swing = first, second
    return replace(joint, limits=replace(limits, swing=swing, twist=twist))
