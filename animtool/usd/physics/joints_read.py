"""Reads joints between bodies from UsdPhysics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from pxr import UsdPhysics

from animtool.core.array_types import FloatArray
from animtool.core.errors import excerpt
from animtool.maths import so3
from animtool.motion.physics import (
    IDENTITY_POSE,
    JointDrive,
    PhysicsJoint,
    relative_pose,
)
from animtool.usd.physics.stage import (
    AXIS_VECTORS,
    MAX_FORCE,
    MAX_NUMBER,
    PhysicsStage,
    is_body,
)
from animtool.usd.rigs.layer import read_ball_limit
from animtool.usd.rigs.prims import nearest_prim, self_and_ancestors

JOINT_KINDS = {
    "PhysicsFixedJoint": "fixed",
    "PhysicsRevoluteJoint": "pin",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsSphericalJoint": "ball",
    "PhysicsJoint": "ball",
}


# Names of the rotational degrees of freedom of an untyped joint.
ROTATION_AXES = ("rotX", "rotY", "rotZ")
# Valid range of swing half-angles [rad].
SWING_RANGE = math.radians(1e-3), math.radians(179.0)


def read_joint(
    source: PhysicsStage,
    prim: Any,
    body_indices: Mapping[str, int],
    is_dynamic: Sequence[bool],
) -> PhysicsJoint | None:
    """Return a joint between bodies; None if it is disabled or has no bodies.

    ``is_dynamic`` says which bodies are dynamic.
    """
    joint = UsdPhysics.Joint(prim)
    if joint.GetJointEnabledAttr().Get() is False:
        return None
    kind = JOINT_KINDS.get(str(prim.GetTypeName()))
    if kind is None:
        source.add_notice(prim, f"is a {prim.GetTypeName()}, which is not supported")
        return None
    axis = prim.GetAttribute("physics:axis")
    axis_name = str((axis.Get() if axis else None) or "X")
    if axis_name not in AXIS_VECTORS:
        source.fail(axis, f"is {axis_name!r}", "X, Y or Z")
    axis_rotation = so3.shortest_rotation(AXIS_VECTORS["X"], AXIS_VECTORS[axis_name])
    bodies, frames = [], []
    for side in (0, 1):
        position = source.read_numbers(prim.GetAttribute(f"physics:localPos{side}"), 3)
        rotation = source.read_numbers(prim.GetAttribute(f"physics:localRot{side}"), 4)
        local_frame = IDENTITY_POSE.copy()
        local_frame[:3] = 0.0 if position is None else position * source.meters_per_unit
        local_frame[3:] = (
            so3.IDENTITY if rotation is None or not rotation.any() else rotation
        )
        local_frame[3:] = so3.multiply(so3.normalize(local_frame[3:]), axis_rotation)
        targets = prim.GetRelationship(f"physics:body{side}").GetTargets()
        if len(targets) > 1:
            message = f"has {len(targets)} targets for body{side}: using {targets[0]}"
            source.add_notice(prim, message)
        target = targets[0] if targets else None
        body, frame = _resolve_body(
            source, prim, side, target, local_frame, body_indices
        )
        bodies.append(body)
        frames.append(frame)
    if bodies[0] < 0 and bodies[1] < 0:
        source.add_notice(prim, "joins no supported body")
        return None
    if bodies[0] == bodies[1]:
        source.add_notice(prim, "joins a body to itself and is skipped")
        return None
    if not any(is_dynamic[body] for body in bodies if body >= 0):
        source.add_notice(prim, "joins no dynamic body and is skipped")
        return None
    limits, swing = _joint_limits(source, prim, kind)
    return PhysicsJoint(
        str(prim.GetName()),
        kind,
        (bodies[0], bodies[1]),
        (frames[0], frames[1]),
        limits,
        swing,
        _joint_drive(source, prim, kind),
        joint.GetCollisionEnabledAttr().Get() is True,
        (
            _break_limit(source, prim, "breakForce", 1),
            _break_limit(source, prim, "breakTorque", 2),
        ),
    )


def _break_limit(source: PhysicsStage, prim: Any, name: str, power: int) -> float:
    """Return the break force [N] or torque [N m] of a joint; inf if unbreakable."""
    value = source.read_number_or_infinity(prim.GetAttribute(f"physics:{name}"))
    if value is None or not 0 < value < MAX_FORCE:
        return math.inf
    return float(value) * source.kilograms_per_unit * source.meters_per_unit**power


def _resolve_body(
    source: PhysicsStage,
    joint: Any,
    side: int,
    target: Any,
    local_frame: FloatArray,
    body_indices: Mapping[str, int],
) -> tuple[int, FloatArray]:
    """Return a body of a joint (-1 is the world), and the joint frame in its space."""
    if target is None:
        return -1, source.to_y_up(local_frame)
    prim = source.stage.GetPrimAtPath(target) if target.IsPrimPath() else None
    if not prim:
        message = f"body{side} refers to {excerpt(str(target))}, which does not exist"
        hint = nearest_prim(source.stage, str(target))
        source.fail(joint, message, hint)
    pose, scale = source.pose_and_scale(source.world_matrix(prim))
    local_frame = np.concatenate([local_frame[:3] * scale, local_frame[3:]])
    joint_pose = np.concatenate(
        [
            pose[:3] + so3.rotate(pose[3:], local_frame[:3]),
            so3.multiply(pose[3:], local_frame[3:]),
        ]
    )
    for ancestor in self_and_ancestors(prim):
        body = body_indices.get(str(ancestor.GetPath()))
        if body is not None:
            return body, relative_pose(
                source.pose_and_scale(source.world_matrix(ancestor))[0], joint_pose
            )
        if is_body(ancestor):
            message = (
                f"is attached to {excerpt(str(ancestor.GetPath()))}, a body that is "
                "not supported: attached to the world instead"
            )
            source.add_notice(joint, message)
            break
    return -1, source.to_y_up(joint_pose)


def _joint_limits(
    source: PhysicsStage, prim: Any, kind: str
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return the lower and upper limit, and the swing limits of a ball joint."""
    if kind == "fixed":
        return None, None
    if kind == "ball":
        cone_limit_names = [f"physics:coneAngle{i}Limit" for i in (0, 1)]
        limit_names = product(ROTATION_AXES, ("low", "high"))
        for name in (
            *cone_limit_names,
            *(f"limit:{axis}:physics:{end}" for axis, end in limit_names),
        ):
            source.read_number_or_infinity(prim.GetAttribute(name))
        ball_limit = read_ball_limit(prim, (1.0, 0.0, 0.0))
        if ball_limit is None:
            return None, None
        swing_limits = None
        if ball_limit.swing is not None:
            swing_y, swing_z = np.clip(ball_limit.swing, *SWING_RANGE).tolist()
            swing_limits = swing_y, swing_z
        return _valid_range(source, prim, ball_limit.twist, 2 * math.pi), swing_limits
    lower, upper = (
        source.read_number_or_infinity(prim.GetAttribute(f"physics:{end}Limit"))
        for end in ("lower", "upper")
    )
    if lower is None or upper is None or (math.isinf(lower) and math.isinf(upper)):
        return None, None
    if kind == "pin":
        return _valid_range(
            source, prim, (math.radians(lower), math.radians(upper))
        ), None
    slide_range = (lower * source.meters_per_unit, upper * source.meters_per_unit)
    slide_limits = tuple(np.clip(slide_range, -MAX_NUMBER, MAX_NUMBER).tolist())
    return _valid_range(source, prim, slide_limits, math.inf), None


def _valid_range(
    source: PhysicsStage,
    prim: Any,
    limits: tuple[float, float] | None,
    max_range: float = 2 * math.pi,
) -> tuple[float, float] | None:
    """Return limits if they are valid; otherwise add a notice and return None."""
    if limits is None:
        return None
    lower, upper = limits
    if lower > upper:
        source.add_notice(
            prim, "has a lower limit above its upper limit: the limit is ignored"
        )
        return None
    if upper - lower > max_range * (1 + 1e-6):
        message = (
            "has a range of more than 360 degrees, but full rotations are not counted: "
            "the limit is ignored"
        )
        source.add_notice(prim, message)
        return None
    return lower, upper


def _joint_drive(source: PhysicsStage, prim: Any, kind: str) -> JointDrive | None:
    """Return the drive of a joint in SI units; None if it has none."""
    axes_by_kind = {"prismatic": ["linear"], "ball": ["rotX", "rotY", "rotZ"]}
    drive_axes = axes_by_kind.get(kind, ["angular"])
    drives = [UsdPhysics.DriveAPI(prim, axis) for axis in drive_axes]
    if not all(prim.HasAPI(UsdPhysics.DriveAPI, axis) for axis in drive_axes):
        return None
    is_linear = kind == "prismatic"
    force_unit = source.kilograms_per_unit * source.meters_per_unit ** (
        1 if is_linear else 2
    )
    gain_unit = (
        source.kilograms_per_unit if is_linear else force_unit * math.degrees(1.0)
    )
    position_unit = source.meters_per_unit if is_linear else math.radians(1.0)

    def drive_value(drive: Any, name: str, minimum: float = -MAX_NUMBER) -> float:
        return source.read_number(getattr(drive, f"Get{name}Attr")(), minimum) or 0.0

    targets = [drive_value(drive, "TargetPosition") * position_unit for drive in drives]
    max_force = source.read_number_or_infinity(drives[0].GetMaxForceAttr())
    velocities = [drive_value(drive, "TargetVelocity") for drive in drives]
    is_ball = kind == "ball"
    if is_ball and any(velocities):
        source.add_notice(
            prim, "has a drive with a target velocity, which is not supported"
        )
    return JointDrive(
        drive_value(drives[0], "Stiffness", 0.0) * gain_unit,
        drive_value(drives[0], "Damping", 0.0) * gain_unit,
        0.0 if is_ball else targets[0],
        so3.exp(np.array(targets)) if is_ball else so3.IDENTITY.copy(),
        max_force * force_unit
        if max_force is not None and 0 <= max_force < MAX_FORCE
        else None,
        0.0 if is_ball else velocities[0] * position_unit,
    )
