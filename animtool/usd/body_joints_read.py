"""Joints between bodies that UsdPhysics says of a stage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pxr import UsdPhysics

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.physics import STILL, JointDrive, PhysicsJoint
from animtool.usd.physics_stage import AXES, MAX_FORCE, PhysicsStage, within
from animtool.usd.rig_layer import read_ball
from animtool.usd.rig_prims import upwards

JOINTS = {
    "PhysicsFixedJoint": "fixed",
    "PhysicsRevoluteJoint": "pin",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsSphericalJoint": "ball",
    "PhysicsJoint": "ball",
}


def read_joint(
    source: PhysicsStage, prim: Any, places: Mapping[str, int]
) -> PhysicsJoint | None:
    """Return a joint between bodies, by path; None where it joins none, or is off."""
    joint = UsdPhysics.Joint(prim)
    if joint.GetJointEnabledAttr().Get() is False:
        return None
    kind = JOINTS.get(str(prim.GetTypeName()))
    if kind is None:
        source.note(prim, f"is a {prim.GetTypeName()}, which is not read")
        return None
    token = str(prim.GetAttribute("physics:axis").Get() or "X")
    lean = so3.between(AXES["X"], AXES.get(token, AXES["X"]))
    bodies, frames = [], []
    for side in (0, 1):
        at = source.numbers(prim.GetAttribute(f"physics:localPos{side}"), 3)
        turn = source.numbers(prim.GetAttribute(f"physics:localRot{side}"), 4)
        own = STILL.copy()
        own[:3] = 0.0 if at is None else at * source.unit
        own[3:] = so3.IDENTITY if turn is None or not turn.any() else turn
        own[3:] = so3.multiply(so3.normalize(own[3:]), lean)
        targets = prim.GetRelationship(f"physics:body{side}").GetTargets()
        body, frame = _side(source, targets[0] if targets else None, own, places)
        bodies.append(body)
        frames.append(frame)
    if bodies[0] < 0 and bodies[1] < 0:
        source.note(prim, "joins no body that is read")
        return None
    limits, swing = _limits(source, prim, kind)
    return PhysicsJoint(
        str(prim.GetName()),
        kind,
        (bodies[0], bodies[1]),
        (frames[0], frames[1]),
        limits,
        swing,
        _drive(source, prim, kind),
        joint.GetCollisionEnabledAttr().Get() is True,
        (_most(source, prim, "breakForce", 1), _most(source, prim, "breakTorque", 2)),
    )


def _most(source: PhysicsStage, prim: Any, name: str, power: int) -> float:
    """Return the force [N] or torque [N m] that a joint breaks at; infinite is none."""
    value = prim.GetAttribute(f"physics:{name}").Get()
    if value is None or not 0 < value < MAX_FORCE:
        return math.inf
    return float(value) * source.kilograms * source.unit**power


def _side(
    source: PhysicsStage, target: Any, own: FloatArray, places: Mapping[str, int]
) -> tuple[int, FloatArray]:
    """Return the body of a side, -1 the world, and the joint's frame there."""
    if target is None:
        return -1, source.up(own)
    prim = source.stage.GetPrimAtPath(target)
    if not prim:
        return -1, source.up(own)
    pose, scale = source.pose(source.matrix(prim))
    own = np.concatenate([own[:3] * scale, own[3:]])
    placed = np.concatenate(
        [pose[:3] + so3.rotate(pose[3:], own[:3]), so3.multiply(pose[3:], own[3:])]
    )
    for above in upwards(prim):
        body = places.get(str(above.GetPath()))
        if body is not None:
            return body, within(source.pose(source.matrix(above))[0], placed)
    return -1, source.up(placed)


def _limits(
    source: PhysicsStage, prim: Any, kind: str
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return least and most, and the swing of a ball."""
    if kind == "fixed":
        return None, None
    if kind == "ball":
        ball = read_ball(prim, (1.0, 0.0, 0.0))
        if ball is None:
            return None, None
        swing = None if ball.swing is None else np.broadcast_to(ball.swing, 2)
        pair = None if swing is None else (float(swing[0]), float(swing[1]))
        return ball.twist, pair
    scale = math.radians(1.0) if kind == "pin" else source.unit
    low = prim.GetAttribute("physics:lowerLimit").Get()
    high = prim.GetAttribute("physics:upperLimit").Get()
    if low is None or high is None or not math.isfinite(low + high):
        return None, None
    return (low * scale, high * scale), None


def _drive(source: PhysicsStage, prim: Any, kind: str) -> JointDrive | None:
    axes = {"prismatic": ["linear"], "ball": ["rotX", "rotY", "rotZ"]}
    names = axes.get(kind, ["angular"])
    drives = [UsdPhysics.DriveAPI(prim, axis) for axis in names]
    if not all(prim.HasAPI(UsdPhysics.DriveAPI, axis) for axis in names):
        return None
    linear = kind == "prismatic"
    force = source.kilograms * source.unit ** (1 if linear else 2)
    gain = source.kilograms if linear else force * math.degrees(1.0)
    scale = source.unit if linear else math.radians(1.0)

    def value(drive: Any, name: str) -> float:
        attribute = getattr(drive, f"Get{name}Attr")()
        number = attribute.Get()
        # What has no end is not meant to be read.
        if name == "MaxForce" or number is None:
            return float(number or 0.0)
        numbers = source.numbers(attribute, 1)
        return 0.0 if numbers is None else float(numbers[0])

    targets = [value(drive, "TargetPosition") * scale for drive in drives]
    most = value(drives[0], "MaxForce")
    rates = [value(drive, "TargetVelocity") for drive in drives]
    ball = kind == "ball"
    if ball and any(rates):
        source.note(prim, "has a drive with a velocity to reach, which is not read")
    return JointDrive(
        max(value(drives[0], "Stiffness"), 0.0) * gain,
        max(value(drives[0], "Damping"), 0.0) * gain,
        0.0 if ball else targets[0],
        so3.exp(np.array(targets)) if ball else so3.IDENTITY.copy(),
        most * force if 0 < most < MAX_FORCE else None,
        0.0 if ball else rates[0] * scale,
    )
