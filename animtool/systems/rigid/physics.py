"""Conversion between bodies with joints and UsdPhysics records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from animtool.core.array_types import FloatArray
from animtool.core.errors import excerpt, refuse
from animtool.maths import so3
from animtool.motion.physics import (
    JointDrive,
    Physics,
    PhysicsBody,
    PhysicsJoint,
    PhysicsShape,
    relative_pose,
)
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    Mesh,
    Plane,
    Poses,
    Shape,
    Sphere,
)
from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.forces.pulls import Gravity
from animtool.systems.rigid.bodies import RigidBodies, collider_shape
from animtool.systems.rigid.joints import (
    JOINT_KINDS,
    BodyJoint,
    Joints,
    to_body_frame,
    to_parent_frame,
)
from animtool.systems.rigid.spec import BodyModel

Y_AXIS = np.array([0.0, 1.0, 0.0])


def physics_record(
    bodies: RigidBodies, joints: Joints, colliders: Colliders, forces: Sequence[Force]
) -> Physics:
    """Return bodies, joints and static colliders as a UsdPhysics record.

    Moving colliders and forces other than gravity are left out.
    """
    gravity = [force.acceleration for force in forces if isinstance(force, Gravity)]
    return Physics(
        [_physics_body(bodies, i) for i in range(len(bodies.names))],
        list(_physics_joints(bodies, joints)),
        [
            _physics_shape(
                collider.shape,
                collider.poses.rows[0],
                collider.friction,
                collider.restitution,
            )
            for collider in colliders
            if collider.poses.is_fixed and not collider.container
        ],
        np.sum([np.zeros(3), *map(np.asarray, gravity)], axis=0),
    )


def _physics_body(bodies: RigidBodies, body: int) -> PhysicsBody:
    """Return a body as a UsdPhysics record."""
    kind = bodies.kind_of(body)
    model = kind.model
    shapes = [
        _physics_shape(
            collider_shape(shape),
            np.concatenate([origin, rotation]),
            model.friction,
            model.restitution,
        )
        for shape, origin, rotation in kind.shapes
    ]
    return PhysicsBody(
        bodies.names[body],
        bodies.poses[body].at(bodies.begin),
        shapes,
        model.density,
        kind.mass,
        kind.centre,
        kind.moments,
        kind.axes,
        np.array(model.velocity, np.float64),
        np.radians(model.spin),
        not bodies.is_dynamic[body],
    )


def _physics_shape(
    shape: Shape, pose: FloatArray, friction: float, restitution: float
) -> PhysicsShape:
    """Return a shape as a record: centred at its pose, with y as its axis."""
    shape_kind, centre, axis = "mesh", np.zeros(3), Y_AXIS
    size: tuple[float, ...] = ()
    points, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    match shape:
        case Sphere():
            shape_kind, size, centre = "sphere", (shape.radius,), np.array(shape.centre)
        case Capsule():
            shape_kind, size = "capsule", (shape.radius, shape.length)
            centre, axis = np.array(shape.centre), np.array(shape.axis)
        case Box():
            shape_kind, size = "box", tuple(map(float, shape.size))
        case Plane():
            shape_kind, axis = "plane", np.array(shape.normal)
            centre = shape.anchors()[0]
        case Mesh():
            points, corners = shape.weld()
            triangles = corners.astype(np.int64)
    rotation = so3.shortest_rotation(Y_AXIS, axis / np.linalg.norm(axis))
    shape_pose = to_parent_frame(pose, np.concatenate([centre, rotation]))
    return PhysicsShape(
        shape_kind, size, shape_pose, points, triangles, friction, restitution
    )


def _physics_joints(bodies: RigidBodies, joints: Joints) -> Iterator[PhysicsJoint]:
    """Yield joints as UsdPhysics records."""
    type_names = {number: kind for kind, number in JOINT_KINDS.items()}
    dynamic = bodies.dynamic_indices
    excluded_pairs = {
        pair for a, b in joints.excluded_pairs.tolist() for pair in ((a, b), (b, a))
    }
    for joint, parameters in zip(joints.members, joints.parameters, strict=True):
        (first, second), parent = joint.bodies, joint.parent_body
        frame_a, frame_b = (
            parameters[:7],
            to_body_frame(bodies, second, parameters[7:14]),
        )
        if first >= 0:
            parent, frame_a = int(dynamic[first]), to_body_frame(bodies, first, frame_a)
        elif parent < 0:
            pose = joint.anchor.at(bodies.begin)
            frame_a = to_parent_frame(pose, frame_a)
        low, high, *swing = parameters[14:18].tolist()
        target, force_limit = float(parameters[18]), float(parameters[25])
        drive = None
        if parameters[23:25].any():
            stiffness, damping = parameters[23:25].tolist()
            max_force = None if force_limit < 0 else force_limit
            rotation, speed = parameters[19:23], float(parameters[26])
            drive = JointDrive(stiffness, damping, target, rotation, max_force, speed)
        yield PhysicsJoint(
            joint.name,
            type_names[joint.kind],
            (parent, int(dynamic[second])),
            (frame_a, frame_b),
            None if low > high else (low, high),
            None if swing[0] < 0 else (swing[0], swing[1]),
            drive,
            parent >= 0 and (parent, int(dynamic[second])) not in excluded_pairs,
            joint.break_limits,
        )


def body_entries(
    physics: Physics, entry_key: str
) -> tuple[list[BodyModel], list[dict[str, Any]]]:
    """Return bodies as models of a spec, and the data read for their keys.

    Faults are located at the key of the stage in the spec.
    """
    models, body_data = [], []
    for body in physics.bodies:
        first_shape = body.shapes[0]
        body_keys: dict[str, Any] = {
            "name": body.name,
            "density": body.density,
            "friction": first_shape.friction,
            "restitution": first_shape.restitution,
            "kinematic": body.kinematic,
            "shapes": [
                {
                    "shape": {"sphere": None},
                    "at": shape.pose[:3].tolist(),
                    "rotate": shape.pose[[6, 3, 4, 5]].tolist(),
                }
                for shape in body.shapes
            ],
        }
        if body.mass is not None:
            del body_keys["density"]
            body_keys["mass"] = body.mass
        if body.centre is not None:
            body_keys["centre"] = body.centre.tolist()
        if body.inertia is not None:
            body_keys["inertia"] = body.inertia.tolist()
            body_keys["inertia_axes"] = body.axes[[3, 0, 1, 2]].tolist()
        if not body.kinematic:
            body_keys["velocity"] = body.velocity.tolist()
            body_keys["spin"] = np.degrees(body.spin).tolist()
        models.append(_body_model(body_keys, body.origin, entry_key))
        poses_over_time = body.kinematic_poses
        times = body.times
        if poses_over_time is None:
            poses_over_time, times = body.pose[None], np.zeros(1)
        poses = Poses(times, poses_over_time[:, :3], poses_over_time[:, 3:])
        shapes = [
            {"shape": collider_shape_of(shape), "hull": shape.hull}
            for shape in body.shapes
        ]
        location = {"entry": entry_key, "origin": body.origin}
        body_data.append({"poses": poses, "shapes": shapes, **location})
    return models, body_data


def _body_model(keys: dict[str, Any], origin: str, entry_key: str) -> BodyModel:
    """Return the model of a body; raise SIM051 for invalid numbers."""
    try:
        return BodyModel.model_validate(keys)
    except ValidationError as error:
        problem = error.errors()[0]
        value, key = problem["input"], ".".join(map(str, problem["loc"]))
        value_text = f"{value:g}" if isinstance(value, float) else excerpt(str(value))
        message = f"{origin}: {key} is {value_text} in metres, kilograms and seconds"
        hint = f"{problem['msg']}: check the units of the stage"
        refuse("SIM051", message, entry_key, hint)


def collider_shape_of(shape: PhysicsShape) -> Shape:
    """Return the collider shape of a UsdPhysics shape, in the frame of the shape."""
    match shape.kind:
        case "sphere":
            return Sphere(shape.size[0])
        case "capsule":
            return Capsule(shape.size[0], shape.size[1])
        case "box":
            return Box(shape.size)
        case "plane":
            return Plane()
    return Mesh(shape.points, shape.triangles, closed=True)


def stage_joints(
    physics: Physics, bodies: RigidBodies, first_body: int
) -> list[BodyJoint]:
    """Return the joints of a stage, whose bodies start at a given index."""
    dynamic_indices = {int(i): k for k, i in enumerate(bodies.dynamic_indices)}
    joints = []
    for joint in physics.joints:
        body_pair = [i if i < 0 else i + first_body for i in joint.bodies]
        frames, drive, limits = list(joint.frames), joint.drive, joint.limits
        target, speed = (0.0, 0.0) if drive is None else (drive.target, drive.speed)
        rotation = so3.IDENTITY if drive is None else drive.rotation
        if body_pair[1] not in dynamic_indices:
            # Swapped: the joint's second body becomes the first.
            body_pair.reverse()
            frames.reverse()
            limits = None if limits is None else (-limits[1], -limits[0])
            target, speed, rotation = -target, -speed, so3.conjugate(rotation)
        if body_pair[1] not in dynamic_indices:
            continue
        parent, body = body_pair
        frame_b = relative_pose(bodies.kind_of(body).principal_frame, frames[1])
        anchor = Poses()
        frame_a, parent_index = frames[0], dynamic_indices.get(parent, -1)
        if parent_index >= 0:
            frame_a = relative_pose(bodies.kind_of(parent).principal_frame, frame_a)
        elif parent >= 0:
            anchor = bodies.poses[parent]
        swing = (-1.0, -1.0) if joint.swing is None else joint.swing
        drive_parameters = [0.0, 0.0, -1.0, 0.0]
        if drive is not None:
            max_force = -1.0 if drive.max_force is None else drive.max_force
            drive_parameters = [drive.stiffness, drive.damping, max_force, speed]
        limit_parameters = [*(limits or (1.0, 0.0)), *swing]
        drive_parameters = [target, *rotation, *drive_parameters]
        is_excluded = parent >= 0 and not joint.contacts
        joints.append(
            BodyJoint(
                joint.name,
                JOINT_KINDS[joint.kind],
                (parent_index, dynamic_indices[body]),
                [*frame_a, *frame_b, *limit_parameters, *drive_parameters],
                anchor,
                parent,
                (body, parent) if is_excluded else (-1, -1),
                joint.break_limits,
            )
        )
    return joints


def static_colliders(physics: Physics) -> list[Collider]:
    """Return the static colliders of a stage."""
    return [
        Collider(
            collider_shape_of(shape),
            Poses.fixed(shape.pose[:3], shape.pose[3:]),
            name=shape.name,
            restitution=shape.restitution,
            friction=shape.friction,
        )
        for shape in physics.colliders
    ]
