"""Writes bodies, joints and colliders as UsdPhysics on existing Xforms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from pxr import Gf, Sdf

from animtool.core.array_types import FloatArray
from animtool.core.names import numbered_names
from animtool.maths import so3
from animtool.motion.physics import (
    JointDrive,
    Physics,
    PhysicsBody,
    PhysicsJoint,
    PhysicsShape,
)
from animtool.rig.limits import BallLimit
from animtool.usd.layers.names import legal_name
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute_spec,
    author_relationship,
    author_xform_order,
    gf_quaternion,
    gf_quatf,
    gf_vec3f,
    gf_vector,
    prim_spec,
)
from animtool.usd.rigs.layer import author_ball_limit
from animtool.usd.rigs.meshes import author_mesh

_TYPES = Sdf.ValueTypeNames
PHYSICS_SCOPE = "Physics"  # scope of everything except bodies
_JOINT_TYPES = {
    "fixed": "PhysicsFixedJoint",
    "pin": "PhysicsRevoluteJoint",
    "prismatic": "PhysicsPrismaticJoint",
}
NamedT = TypeVar("NamedT", PhysicsShape, PhysicsJoint)
_SHAPE_TYPES = {
    "sphere": "Sphere",
    "capsule": "Capsule",
    "box": "Cube",
    "plane": "Plane",
}


class PhysicsWriter:
    """Writes the UsdPhysics prims of bodies, each of which has its own Xform.

    Args:
        spec: The prim spec.
        xform_names: Names of the bodies' Xforms.
        physics: Bodies and joints.
        unit: Unit of the layer [m].
        up_rotation: Rotation from Y up to the layer's up axis ``(4,)``.
    """

    def __init__(
        self,
        spec: Any,
        xform_names: Sequence[str],
        physics: Physics,
        unit: float,
        up_rotation: FloatArray,
    ) -> None:
        self._layer, self._root, self._unit = spec.layer, str(spec.path), unit
        self._xform_names = xform_names
        self._physics = physics
        self._up_rotation = up_rotation
        self._materials: dict[tuple[float, float], str] = {}

    def write(self) -> None:
        """Write scene, bodies, joints and materials."""
        physics, scope = self._physics, f"{self._root}/{PHYSICS_SCOPE}"
        self._layer.pseudoRoot.SetInfo("kilogramsPerUnit", 1.0)
        prim_spec(self._layer, scope, "Scope")
        self._write_scene(f"{scope}/Scene")
        for xform_name, body in zip(self._xform_names, physics.bodies, strict=True):
            self._write_body(f"{self._root}/{xform_name}", body)
        for path, shape in self._scope_entries("Collider", physics.colliders):
            self._write_shape(path, shape, "none")
        for path, joint in self._scope_entries("Joint", physics.joints):
            self._write_joint(path, joint)

    def _scope_entries(
        self, kind: str, entries: Sequence[NamedT]
    ) -> Iterator[tuple[str, NamedT]]:
        """Yield the prim path of each entry in a scope, and the entry."""
        scope = f"{self._root}/{PHYSICS_SCOPE}/{kind}s"
        if entries:
            prim_spec(self._layer, scope, "Scope")
        names = [legal_name(entry.name or kind.lower()) for entry in entries]
        for name, entry in zip(numbered_names(names), entries, strict=True):
            yield f"{scope}/{name}", entry

    def _write_scene(self, path: str) -> None:
        spec = prim_spec(self._layer, path, "PhysicsScene")
        magnitude = float(np.linalg.norm(self._physics.gravity))
        direction = so3.rotate(
            self._up_rotation, self._physics.gravity / (magnitude or 1.0)
        )
        attribute_spec(
            spec, "physics:gravityDirection", _TYPES.Vector3f, gf_vec3f(direction)
        )
        self._author_number(spec, "physics:gravityMagnitude", magnitude / self._unit)

    @staticmethod
    def _author_number(spec: Any, name: str, value: float) -> None:
        attribute_spec(spec, name, _TYPES.Float, value)

    def _author_vector(
        self, spec: Any, name: str, metres: FloatArray, value_type: Any
    ) -> None:
        attribute_spec(spec, name, value_type, gf_vec3f(metres / self._unit))

    def _write_body(self, path: str, body: PhysicsBody) -> None:
        spec = self._layer.GetPrimAtPath(path)
        apply_schemas(spec, ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
        attribute_spec(spec, "physics:rigidBodyEnabled", _TYPES.Bool, True)
        attribute_spec(spec, "physics:kinematicEnabled", _TYPES.Bool, body.kinematic)
        if not body.kinematic:
            velocity_name = "physics:velocity"
            angular_velocity_name = "physics:angularVelocity"
            self._author_vector(spec, velocity_name, body.velocity, _TYPES.Vector3f)
            angular_velocity = gf_vec3f(np.degrees(body.spin))
            attribute_spec(
                spec, angular_velocity_name, _TYPES.Vector3f, angular_velocity
            )
        if body.mass is not None:
            self._author_number(spec, "physics:mass", body.mass)
        if body.centre is not None:
            self._author_vector(
                spec, "physics:centerOfMass", body.centre, _TYPES.Point3f
            )
        if body.inertia is not None:
            inertia = gf_vec3f(body.inertia / self._unit**2)
            attribute_spec(spec, "physics:diagonalInertia", _TYPES.Float3, inertia)
            attribute_spec(
                spec, "physics:principalAxes", _TYPES.Quatf, gf_quatf(body.axes)
            )
        for k, shape in enumerate(body.shapes):
            self._write_shape(f"{path}/shape_{k + 1}", shape, "convexHull")

    def _write_shape(self, path: str, shape: PhysicsShape, approximation: str) -> None:
        """Write a collision shape that is not rendered: its purpose is guide."""
        is_mesh = shape.kind == "mesh"
        spec = prim_spec(
            self._layer, path, "Mesh" if is_mesh else _SHAPE_TYPES[shape.kind]
        )
        schemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]
        apply_schemas(
            spec, [*schemas, *(["PhysicsMeshCollisionAPI"] if is_mesh else [])]
        )
        attribute_spec(spec, "purpose", _TYPES.Token, "guide", is_uniform=True)
        pose, op_names = shape.pose, ["xformOp:translate", "xformOp:orient"]
        translation = gf_vector(pose[:3] / self._unit)
        attribute_spec(spec, op_names[0], _TYPES.Double3, translation)
        attribute_spec(spec, op_names[1], _TYPES.Quatd, gf_quaternion(pose[3:]))
        sizes = [size / self._unit for size in shape.size]
        match shape.kind:
            case "sphere":
                attribute_spec(spec, "radius", _TYPES.Double, sizes[0])
            case "capsule":
                attribute_spec(spec, "axis", _TYPES.Token, "Y", is_uniform=True)
                attribute_spec(spec, "radius", _TYPES.Double, sizes[0])
                attribute_spec(spec, "height", _TYPES.Double, sizes[1])
            case "box":
                attribute_spec(spec, "size", _TYPES.Double, 1.0)
                op_names.append("xformOp:scale")
                attribute_spec(spec, op_names[2], _TYPES.Float3, Gf.Vec3f(*sizes))
            case "plane":
                attribute_spec(spec, "axis", _TYPES.Token, "Y", is_uniform=True)
            case "mesh":
                self._write_mesh(spec, shape, approximation)
        author_xform_order(spec, *op_names)
        binding_name = "material:binding:physics"
        author_relationship(
            spec, binding_name, self._material_path(shape.friction, shape.restitution)
        )

    def _write_mesh(self, spec: Any, shape: PhysicsShape, approximation: str) -> None:
        points = np.ascontiguousarray(shape.points / self._unit, np.float32)
        vertex_indices = shape.triangles.astype(np.int32).ravel()
        vertex_counts = np.full(len(shape.triangles), 3, np.int32)
        bounds = np.stack([points.min(axis=0), points.max(axis=0)])
        values = {
            "points": points,
            "extent": bounds,
            "faceVertexCounts": vertex_counts,
            "faceVertexIndices": vertex_indices,
        }
        author_mesh(spec, values, is_closed=True)
        name, token = "physics:approximation", _TYPES.Token
        attribute_spec(spec, name, token, approximation, is_uniform=True)

    def _material_path(self, friction: float, restitution: float) -> str:
        """Return the path of a material; write it on first use."""
        key = friction, restitution
        if key not in self._materials:
            scope = f"{self._root}/{PHYSICS_SCOPE}/Materials"
            prim_spec(self._layer, scope, "Scope")
            path = f"{scope}/material_{len(self._materials) + 1}"
            spec = prim_spec(self._layer, path, "Material")
            apply_schemas(spec, ["PhysicsMaterialAPI"])
            for side in ("static", "dynamic"):
                self._author_number(spec, f"physics:{side}Friction", friction)
            self._author_number(spec, "physics:restitution", restitution)
            self._materials[key] = path
        return self._materials[key]

    def _write_joint(self, path: str, joint: PhysicsJoint) -> None:
        has_twist_limit = joint.limits is not None or joint.drive is not None
        ball_type = "PhysicsJoint" if has_twist_limit else "PhysicsSphericalJoint"
        spec = prim_spec(self._layer, path, _JOINT_TYPES.get(joint.kind, ball_type))
        for k, (body_index, frame) in enumerate(
            zip(joint.bodies, joint.frames, strict=True)
        ):
            body_path = (
                self._root
                if body_index < 0
                else f"{self._root}/{self._xform_names[body_index]}"
            )
            author_relationship(spec, f"physics:body{k}", body_path)
            self._author_vector(spec, f"physics:localPos{k}", frame[:3], _TYPES.Point3f)
            attribute_spec(
                spec, f"physics:localRot{k}", _TYPES.Quatf, gf_quatf(frame[3:])
            )
        for power, name in enumerate(("breakForce", "breakTorque"), start=1):
            if math.isfinite(joint.break_limits[power - 1]):
                break_limit = joint.break_limits[power - 1] / self._unit**power
                self._author_number(spec, f"physics:{name}", break_limit)
        if joint.contacts:
            attribute_spec(spec, "physics:collisionEnabled", _TYPES.Bool, value=True)
        schemas: list[str] = []
        if joint.kind != "fixed" and not (joint.kind == "ball" and has_twist_limit):
            attribute_spec(spec, "physics:axis", _TYPES.Token, "X", is_uniform=True)
        if joint.kind == "ball":
            limits = BallLimit(joint.swing, joint.limits, (1.0, 0.0, 0.0))
            schemas += author_ball_limit(spec, limits, is_twist_limited=has_twist_limit)
        elif joint.limits is not None:
            scale = math.degrees(1.0) if joint.kind == "pin" else 1 / self._unit
            for end, value in zip(("lower", "upper"), joint.limits, strict=True):
                self._author_number(spec, f"physics:{end}Limit", value * scale)
        if joint.drive is not None:
            schemas += self._write_drive(spec, joint.kind, joint.drive)
        if schemas:
            apply_schemas(spec, schemas)

    def _write_drive(self, spec: Any, kind: str, drive: JointDrive) -> list[str]:
        """Write a drive; return the schemas to apply."""
        if kind == "prismatic":
            targets_by_axis = {"linear": drive.target}
            position_unit = 1 / self._unit
            gain_unit = 1.0
            force_unit = 1 / self._unit
        else:
            force_unit = 1 / self._unit**2
            position_unit, gain_unit = math.degrees(1.0), force_unit * math.radians(1.0)
            targets_by_axis = {"angular": drive.target}
            if kind == "ball":
                rotation = so3.log(drive.rotation).tolist()
                targets_by_axis = dict(
                    zip(("rotX", "rotY", "rotZ"), rotation, strict=True)
                )
        for axis, target in targets_by_axis.items():
            name = f"drive:{axis}:physics"
            attribute_spec(spec, f"{name}:type", _TYPES.Token, "force", is_uniform=True)
            self._author_number(spec, f"{name}:targetPosition", target * position_unit)
            self._author_number(spec, f"{name}:stiffness", drive.stiffness * gain_unit)
            self._author_number(spec, f"{name}:damping", drive.damping * gain_unit)
            if drive.speed:
                velocity = drive.speed * position_unit
                self._author_number(spec, f"{name}:targetVelocity", velocity)
            if drive.max_force is not None:
                self._author_number(
                    spec, f"{name}:maxForce", drive.max_force * force_unit
                )
        return [f"PhysicsDriveAPI:{axis}" for axis in targets_by_axis]
