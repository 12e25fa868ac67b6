"""Writes a rig as a USD layer that other departments reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.rig.surfaces import surfaces_of
from animtool.usd.layers.names import RigPaths, joint_names, legal_name
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute_spec,
    author_relationship,
    author_xform_order,
    gf_quaternion,
    gf_quatf,
    gf_vec3f,
    gf_vector,
    new_layer,
    prim_spec,
    save_layer,
)
from animtool.usd.rigs.meshes import author_meshes
from animtool.usd.rigs.skeleton import author_rig

# UsdPhysics locks an axis if low is above high.
LOCKED_LIMITS = (1.0, -1.0)

_TYPES = Sdf.ValueTypeNames
_AXES = "XYZ"


def author_physics(layer: Any, model: str, rig: Rig, names: Sequence[str]) -> int:
    """Write bodies and joints below ``MODEL/Physics``; return the joint count."""
    movable_joints = [
        i for i, joint in enumerate(rig.joints) if joint.type is not JointType.FREE
    ]
    bodies = sorted(
        {*movable_joints, *(rig.joints[i].parent for i in movable_joints)} - {-1}
    )
    scope = f"{model}/Physics"
    prim_spec(layer, model, is_over=True)
    for path in (scope, f"{scope}/Bodies", f"{scope}/Joints"):
        prim_spec(layer, path, "Scope")
    world = rest_world(rig)
    rotations = so3.from_matrix(world.linear[0])
    for i in bodies:
        position = world.positions[0, i] / rig.meters_per_unit
        _author_body(layer, f"{scope}/Bodies/{names[i]}", position, rotations[i])
    for i in movable_joints:
        _author_joint(layer, scope, rig, i, names)
    return len(movable_joints)


def _author_body(
    layer: Any, path: str, position: FloatArray, rotation: FloatArray
) -> None:
    spec = prim_spec(layer, path, "Xform")
    apply_schemas(spec, ["PhysicsRigidBodyAPI"])
    attribute_spec(spec, "physics:kinematicEnabled", _TYPES.Bool, True)
    attribute_spec(spec, "xformOp:translate", _TYPES.Double3, gf_vector(position))
    attribute_spec(spec, "xformOp:orient", _TYPES.Quatd, gf_quaternion(rotation))
    author_xform_order(spec, "xformOp:translate", "xformOp:orient")


def _author_joint(
    layer: Any, scope: str, rig: Rig, joint_index: int, names: Sequence[str]
) -> None:
    joint, meters_per_unit = rig.joints[joint_index], rig.meters_per_unit
    spec = prim_spec(
        layer, f"{scope}/Joints/{names[joint_index]}", _joint_prim_type(joint)
    )
    type_attr = attribute_spec(spec, "animtool:joint", _TYPES.Token, str(joint.type))
    type_attr.custom = True
    if joint.parent >= 0:
        author_relationship(
            spec, "physics:body0", f"{scope}/Bodies/{names[joint.parent]}"
        )
    author_relationship(spec, "physics:body1", f"{scope}/Bodies/{names[joint_index]}")
    axis, frame = _joint_frame(joint)
    position = np.array(joint.translation) / meters_per_unit
    parent_frame = so3.multiply(np.array(joint.rotation), frame)
    origin = Gf.Vec3f(0.0)
    attribute_spec(spec, "physics:localPos0", _TYPES.Point3f, gf_vec3f(position))
    attribute_spec(spec, "physics:localPos1", _TYPES.Point3f, origin)
    attribute_spec(spec, "physics:localRot0", _TYPES.Quatf, gf_quatf(parent_frame))
    attribute_spec(spec, "physics:localRot1", _TYPES.Quatf, gf_quatf(frame))
    if axis:
        attribute_spec(spec, "physics:axis", _TYPES.Token, axis, is_uniform=True)
    if isinstance(joint.limits, RangeLimit):
        is_pin = joint.type is JointType.PIN
        scale = math.degrees(1.0) if is_pin else 1.0 / meters_per_unit
        for end, value in (("lower", joint.limits.low), ("upper", joint.limits.high)):
            attribute_spec(spec, f"physics:{end}Limit", _TYPES.Float, value * scale)
    elif isinstance(joint.limits, BallLimit):
        has_twist = joint.limits.twist is not None
        if schemas := author_ball_limit(spec, joint.limits, is_twist_limited=has_twist):
            apply_schemas(spec, schemas)


def _joint_prim_type(joint: Joint) -> str:
    if joint.type is JointType.BALL:
        limits = joint.limits
        has_twist = isinstance(limits, BallLimit) and limits.twist is not None
        return "PhysicsJoint" if has_twist else "PhysicsSphericalJoint"
    return {
        JointType.PIN: "PhysicsRevoluteJoint",
        JointType.PRISMATIC: "PhysicsPrismaticJoint",
        JointType.FIXED: "PhysicsFixedJoint",
    }[joint.type]


def _joint_frame(joint: Joint) -> tuple[str, FloatArray]:
    """Return the axis token (empty for none) and the joint frame in the body."""
    if isinstance(joint.limits, BallLimit):
        token = "" if joint.limits.twist is not None else "X"
        return token, so3.from_matrix(joint.limits.axes.T)
    if joint.type is JointType.BALL:
        return "X", so3.IDENTITY
    if joint.type is JointType.FIXED:
        return "", so3.IDENTITY
    for letter, basis in zip(_AXES, np.eye(3), strict=True):
        if (basis == joint.axis).all():
            return letter, so3.IDENTITY
    return "X", so3.from_matrix(BallLimit(twist_axis=joint.axis).axes.T)


def author_ball_limit(
    spec: Any, limits: BallLimit, *, is_twist_limited: bool
) -> list[str]:
    """Author the limits of a ball joint; return the schemas to apply.

    A limited twist requires an untyped joint with a limit per axis, as spherical
    joints have no twist limits.
    """
    swing_degrees = None if limits.swing is None else np.degrees(limits.swing).tolist()
    if not is_twist_limited:
        if swing_degrees is not None:
            # The first cone angle tilts towards Y, a rotation about Z.
            for i, angle in enumerate(reversed(swing_degrees)):
                name = f"physics:coneAngle{i}Limit"
                attribute_spec(spec, name, _TYPES.Float, angle)
        return []
    ranges: dict[str, tuple[float, float]] = {}
    if limits.twist is not None:
        lower, upper = np.degrees(limits.twist).tolist()
        ranges["rotX"] = LOCKED_LIMITS if lower == upper == 0 else (lower, upper)
    if swing_degrees is not None:
        ranges |= {
            "rotY": (-swing_degrees[0], swing_degrees[0]),
            "rotZ": (-swing_degrees[1], swing_degrees[1]),
        }
    ranges |= {f"trans{axis}": LOCKED_LIMITS for axis in _AXES}
    for name, (lower, upper) in ranges.items():
        attribute_spec(spec, f"limit:{name}:physics:low", _TYPES.Float, lower)
        attribute_spec(spec, f"limit:{name}:physics:high", _TYPES.Float, upper)
    return [f"PhysicsLimitAPI:{name}" for name in ranges]


def read_ball_limit(joint: Any, axis: tuple[float, float, float]) -> BallLimit | None:
    """Return the limits of a ball joint with a twist axis; None if unlimited."""

    def axis_limits(name: str) -> tuple[float, float] | None:
        lower, upper = (
            joint.GetAttribute(f"limit:{name}:physics:{end}").Get()
            for end in ("low", "high")
        )
        if lower is None or upper is None or not math.isfinite(lower + upper):
            return None
        return (
            (0.0, 0.0) if lower > upper else (math.radians(lower), math.radians(upper))
        )

    if joint.IsA(UsdPhysics.SphericalJoint):
        swing_y, swing_z = (
            joint.GetAttribute(f"physics:coneAngle{i}Limit").Get() for i in (1, 0)
        )
        if (
            swing_y is None
            or swing_z is None
            or not 0 <= min(swing_y, swing_z) < math.inf
        ):
            return None
        # An infinite limit is 180 degrees.
        swing_y, swing_z = min(swing_y, 180.0), min(swing_z, 180.0)
        return BallLimit((math.radians(swing_y), math.radians(swing_z)), None, axis)
    twist, swing_y_limits, swing_z_limits = (
        axis_limits("rotX"),
        axis_limits("rotY"),
        axis_limits("rotZ"),
    )
    swing_limits = None
    if swing_y_limits is not None and swing_z_limits is not None:
        swing_limits = (swing_y_limits[1], swing_z_limits[1])
    if twist is None and swing_limits is None:
        return None
    return BallLimit(swing_limits, twist, axis)


# USD's fallback rate; animation layers over the rig adopt it.
FALLBACK_RATE = Fraction(24)


def write_rig_layer(rig: Rig, path: Path) -> tuple[int, list[Fault]]:
    """Write a rig layer; return its size in bytes and notices about names.

    The layer has model, SkelRoot, Skeleton, meshes and blend shapes but no animation.
    Properties that USD cannot express are stored as customData.
    """
    names = joint_names(rig.joints)
    paths = RigPaths.from_model(f"/{legal_name(rig.name)}")
    layer, meters_per_unit = new_layer(path), rig.meters_per_unit
    with Sdf.ChangeBlock():
        _author_layer_metadata(layer, rig, paths)
        author_rig(layer, rig, names, paths, meters_per_unit)
        tokens = dict(zip(rig.names, rig.paths(names.names), strict=True))
        _, mesh_notices = author_meshes(
            layer, surfaces_of(rig), paths, tokens, meters_per_unit
        )
        root = layer.GetPrimAtPath(paths.root)
        apply_schemas(root, ["SkelBindingAPI"])
        author_relationship(root, "skel:skeleton", paths.skeleton)
    stage = Usd.Stage.Open(layer)
    boundable = UsdGeom.Boundable(stage.GetPrimAtPath(paths.root))
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(
        boundable, Usd.TimeCode.Default()
    )
    bounds = np.array(extent, np.float32).reshape(-1, 3)
    with Sdf.ChangeBlock():
        value = Vt.Vec3fArray.FromNumpy(bounds)
        attribute_spec(root, "extent", Sdf.ValueTypeNames.Float3Array, value)
    notices = [replace(fault, path=str(path)) for fault in names.notices + mesh_notices]
    return save_layer(layer, path), notices


def _author_layer_metadata(layer: Any, rig: Rig, paths: RigPaths) -> None:
    layer.defaultPrim = Sdf.Path(paths.model).name
    layer.framesPerSecond = layer.timeCodesPerSecond = float(FALLBACK_RATE)
    layer.pseudoRoot.SetInfo("metersPerUnit", rig.meters_per_unit)
    layer.pseudoRoot.SetInfo("upAxis", rig.up.value)


def write_physics_layer(rig: Rig, path: Path, rig_path: Path) -> tuple[int, int]:
    """Write joints as UsdPhysics over a rig layer.

    Returns the size in bytes and the number of joints.
    """
    layer = new_layer(path)
    paths = RigPaths.from_model(f"/{legal_name(rig.name)}")
    names = joint_names(rig.joints).names
    with Sdf.ChangeBlock():
        _author_layer_metadata(layer, rig, paths)
        layer.pseudoRoot.SetInfo("kilogramsPerUnit", 1.0)
        joint_count = author_physics(layer, paths.model, rig, names)
    layer.subLayerPaths = [f"./{rig_path.name}"]
    return save_layer(layer, path), joint_count
