"""Reads the joints that a physics layer describes, as this project writes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pxr import Usd, UsdPhysics

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import JointType
from animtool.usd.rigs.layer import read_ball_limit

# What is off an axis by less is rounding of float32.
ON_AXIS = 1e-6


@dataclass(frozen=True, slots=True)
class JointDescription:
    """Description of a physics joint prim."""

    name: str  # USD name of the joint
    type: JointType  # what it can do
    # Unit axis of a pin or prismatic joint, in the joint's rest frame.
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    # Limits [rad], [m]; None without.
    limits: RangeLimit | BallLimit | None = None


def read_physics(stage: Any, meters_per_unit: float) -> dict[str, JointDescription]:
    """Return the joint types and limits of physics joints, by joint name.

    Joints of other tools are read where they have one axis or none; where there is no
    ``animtool:joint``, a PhysicsJoint is a ball.

    meters_per_unit: unit of its lengths [m].
    """
    joints = {}
    for each in Usd.PrimRange(stage.GetPseudoRoot()):
        if each.IsA(UsdPhysics.Joint):
            joints[each.GetName()] = _read_joint(each, meters_per_unit)
    return joints


_JOINT_TYPES = {
    "PhysicsRevoluteJoint": JointType.PIN,
    "PhysicsPrismaticJoint": JointType.PRISMATIC,
    "PhysicsFixedJoint": JointType.FIXED,
}


def _read_joint(joint: Any, meters_per_unit: float) -> JointDescription:
    kind = _JOINT_TYPES.get(str(joint.GetTypeName()), JointType.BALL)
    name = str(joint.GetName())
    rotation = UsdPhysics.Joint(joint).GetLocalRot1Attr().Get()
    frame = so3.normalize(np.array([*rotation.imaginary, rotation.real], np.float64))
    if kind is JointType.FIXED:
        return JointDescription(name, kind)
    token = joint.GetAttribute("physics:axis").Get() or "X"
    axis = _on_axis(so3.rotate(frame, np.eye(3)["XYZ".index(str(token))]))
    if kind is JointType.BALL:
        return JointDescription(name, kind, limits=read_ball_limit(joint, axis))
    scale = math.radians(1.0) if kind is JointType.PIN else meters_per_unit
    low, high = (
        joint.GetAttribute(f"physics:{side}Limit").Get() for side in ("lower", "upper")
    )
    limits = None
    if low is not None and high is not None and math.isfinite(low + high):
        limits = RangeLimit(low * scale, high * scale)
    return JointDescription(name, kind, axis, limits)


def _on_axis(vector: FloatArray) -> tuple[float, float, float]:
    nearest = np.round(vector)
    aligned = np.abs(vector - nearest).max() < ON_AXIS
    x, y, z = (nearest + 0.0 if aligned else vector).tolist()
    return x, y, z
