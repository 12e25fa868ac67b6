"""Joints of a spec, in the kernel's layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, RefusalCollector, refuse, warning
from animtool.core.quantities import vector_text
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.physics import relative_pose
from animtool.sim.colliders import Poses
from animtool.systems.rigid.bodies import NO_PAIRS, RigidBodies, refuse_unknown
from animtool.systems.rigid.spec import BodyModel, JointDriveModel, RigidJointModel
from animtool.systems.rigid.suspicious_joints import (
    JointEnd,
    quaternion_order_warnings,
)

# Width of the kernel's joint table.
PARAMETER_COUNT = 27
# Damping of a motor that is only limited by its force or torque [N s/m, N m s/rad].
RIGID_MOTOR_DAMPING = 1e15
JOINT_KINDS = {"fixed": 0, "pin": 1, "ball": 2, "prismatic": 3}
# Options that only some types support.
_OPTION_TYPES = {
    "limits": ("pin", "prismatic"),
    "swing": ("ball",),
    "twist": ("ball",),
    "drive": ("pin", "ball", "prismatic"),
}
# Largest unreported distance of a joint from its body, in radii of the body.
MAX_DISTANCE_RADII = 4.0
# Largest half-angle of a swing, below 180 degrees, where its axis is undefined.
MAX_SWING = np.radians(179.0)


@dataclass(frozen=True, slots=True)
class BodyJoint:
    """A joint of dynamic bodies, in the kernel's layout."""

    name: str
    kind: int  # value of `JOINT_KINDS`
    bodies: tuple[int, int]  # indices of dynamic bodies; the first may be -1
    parameters: FloatArray | list[float]  # frames, limits and drive (27,)
    anchor: Poses  # animated frame if there is no first dynamic body
    parent_body: int  # index of the parent among all bodies; -1 for none
    # Pair that does not collide, as indices of all bodies; -1 for none.
    excluded_pair: tuple[int, int]
    break_limits: tuple[float, float] = (np.inf, np.inf)  # force [N] and torque [N m]


@dataclass(frozen=True)
class Joints:
    """K joints of dynamic bodies, and their arrays for the kernel."""

    members: Sequence[BodyJoint]
    notices: Sequence[Fault] = ()
    # Other pairs of bodies that do not collide (P, 2).
    other_pairs: IntArray = field(default_factory=lambda: NO_PAIRS)
    # Returns `parameters` at a time [s]; None if drives do not change.
    drive_parameters_at: Callable[[float], FloatArray] | None = None

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.members)

    @cached_property
    def kinds_and_bodies(self) -> IntArray:
        """Kind and both dynamic bodies of each joint ``(K, 3)``; body -1 is none."""
        rows = [(joint.kind, *joint.bodies) for joint in self.members]
        return np.array(rows, np.int64).reshape(-1, 3)

    @cached_property
    def parameters(self) -> FloatArray:
        """Parameters of all joints ``(K, 27)``."""
        rows = [joint.parameters for joint in self.members]
        return np.array(rows, np.float64).reshape(-1, PARAMETER_COUNT)

    @cached_property
    def break_limits(self) -> FloatArray:
        """Break force [N] and torque [N m] of each joint ``(K, 2)``."""
        limits = [joint.break_limits for joint in self.members]
        return np.array(limits, np.float64).reshape(-1, 2)

    @property
    def is_breakable(self) -> bool:
        """Whether any joint can break."""
        return bool(np.isfinite(self.break_limits).any())

    @cached_property
    def excluded_pairs(self) -> IntArray:
        """All pairs of bodies that do not collide ``(P, 2)``."""
        pairs = [joint.excluded_pair for joint in self.members]
        joint_pairs = [pair for pair in pairs if pair[0] >= 0]
        return np.concatenate(
            [np.array(joint_pairs, np.int64).reshape(-1, 2), self.other_pairs]
        )

    def anchor_frames(self, t0: float, t1: float) -> FloatArray:
        """Return anchor frames at both ends of a step [s] ``(K, 2, 7)``."""
        anchors = [joint.anchor for joint in self.members]
        ends = [[poses.at(t0), poses.at(t1)] for poses in anchors]
        return np.array(ends, np.float64).reshape(-1, 2, 7)


def check_joints(
    models: Sequence[RigidJointModel], bodies: Sequence[BodyModel]
) -> None:
    """Raise SIM061 for joints that are invalid regardless of the body poses."""
    models_by_name = {body.name: body for body in bodies}
    refusals = RefusalCollector()
    for i, model in enumerate(models):
        location = f"joints[{i}]"
        name = model.name or location
        with refusals.collect():
            body = _body_model(model.body, models_by_name, f"{location}.body")
            if body.kinematic and body.release is None:
                message = f"{model.body!r} is kinematic, so joints cannot move it"
                refuse("SIM061", message, f"{location}.body")
        with refusals.collect():
            if model.to is not None:
                _body_model(model.to, models_by_name, f"{location}.to")
            if model.to == model.body:
                message = f"{name!r} joins {model.body!r} to itself"
                refuse("SIM061", message, f"{location}.to")
        for key, joint_types in _OPTION_TYPES.items():
            with refusals.collect():
                if getattr(model, key) is not None and model.type not in joint_types:
                    message = f"{name!r} is a {model.type} joint, but {key!r} applies "
                    message += f"only to {' and '.join(joint_types)} joints"
                    hint = f"remove it, or write 'type: {joint_types[0]}'"
                    if model.type == "ball" and key == "limits":
                        hint = "use 'swing: 40' or 'twist: [-30, 30]' instead"
                    refuse("SIM061", message, f"{location}.{key}", hint)
        with refusals.collect():
            _axis_rotation(model, name, location)
        with refusals.collect():
            _limit_parameters(model, name, location)
        with refusals.collect():
            _drive_parameters(model, location)
    refusals.check()


def _body_model(name: str, bodies: Mapping[str, BodyModel], key: str) -> BodyModel:
    """Return the model of a body or of a copy such as ``crate[2]`` by name."""
    if name not in bodies and name.rpartition("[")[0] not in bodies:
        refuse_unknown(name, list(bodies), key)
    return bodies.get(name) or bodies[name.rpartition("[")[0]]


def build_joints(
    models: Sequence[RigidJointModel],
    joint_data: Sequence[Mapping[str, Any]],
    bodies: RigidBodies,
) -> Joints:
    """Return the joints of a spec, once `check_joints` has passed.

    Raises SIM061 for joints that are invalid for the poses of the bodies.
    """
    joints: list[BodyJoint] = []
    notices: list[Fault] = []
    joint_ends: list[JointEnd] = []
    dynamic_indices = {int(i): k for k, i in enumerate(bodies.dynamic_indices)}
    for i, (model, entry_data) in enumerate(zip(models, joint_data, strict=True)):
        location = f"joints[{i}]"
        name = model.name or location
        second_body = bodies.body_index(model.body, f"{location}.body")
        poses: Poses = entry_data["poses"]
        joint_frame = poses.at(bodies.begin)
        joint_frame[3:] = so3.multiply(
            joint_frame[3:], _axis_rotation(model, name, location)
        )
        frame_b = relative_to_principal(bodies, second_body, joint_frame)
        first_index, anchor, parent = -1, Poses(), -1
        if model.to is None:
            anchor = poses
            frame_a = np.concatenate(
                [np.zeros(3), _axis_rotation(model, name, location)]
            )
        else:
            parent = bodies.body_index(model.to, f"{location}.to")
            if not poses.is_fixed:
                message = f"{name!r} follows {model.to!r}, so it cannot have moves or "
                message += "a prim"
                refuse("SIM061", message, location)
            if parent in dynamic_indices:
                first_index = dynamic_indices[parent]
                frame_a = relative_to_principal(bodies, parent, joint_frame)
            else:
                anchor = bodies.poses[parent]
                frame_a = relative_pose(anchor.at(bodies.begin), joint_frame)
        limits = _limit_parameters(model, name, location)
        drive = _drive_parameters(model, location)
        is_excluded = parent >= 0 and not model.contacts
        joints.append(
            BodyJoint(
                model.name or f"joint_{i + 1}",
                JOINT_KINDS[model.type],
                (first_index, dynamic_indices[second_body]),
                [*frame_a, *frame_b, *limits, *drive],
                anchor,
                parent,
                (second_body, parent) if is_excluded else (-1, -1),
                _break_limits(model),
            )
        )
        for body in (second_body, parent) if parent >= 0 else (second_body,):
            notices += _distance_warnings(bodies, body, joint_frame, name, location)
            joint_ends.append(JointEnd(i, body, joint_frame[:3]))
    notices += quaternion_order_warnings(bodies, joint_ends)
    return Joints(joints, notices)


def subset_joints(
    joints: Joints, all_bodies: RigidBodies, bodies: RigidBodies
) -> tuple[Joints, IntArray]:
    """Return the joints of a subset of dynamic bodies, and their original indices.

    Joints between two bodies outside the subset have no effect, and are left out. Of
    ``all_bodies``, which are dynamic at some time, ``bodies`` are dynamic now.
    """
    if bodies is all_bodies:
        return joints, np.arange(len(joints))
    new_indices = {int(i): k for k, i in enumerate(bodies.dynamic_indices)}
    members, indices = [], []
    for k, joint in enumerate(joints.members):
        (first, second), parameters = joint.bodies, joints.parameters[k]
        frame_a, frame_b, limits_and_drive = (
            parameters[:7],
            parameters[7:14],
            parameters[14:],
        )
        a = -1 if first < 0 else int(all_bodies.dynamic_indices[first])
        b, anchor = int(all_bodies.dynamic_indices[second]), joint.anchor
        if a >= 0 and a not in new_indices:
            frame_a, anchor = to_body_frame(all_bodies, first, frame_a), bodies.poses[a]
        if b not in new_indices:
            if a not in new_indices:
                continue
            # Swapped: the joint's second body becomes the first.
            anchor, a, b = bodies.poses[b], b, a
            frame_a, frame_b = to_body_frame(all_bodies, second, frame_b), frame_a
            limits_and_drive = swap_bodies(limits_and_drive)
        pair = new_indices.get(a, -1), new_indices[b]
        parameters = np.concatenate([frame_a, frame_b, limits_and_drive])
        members.append(
            replace(joint, bodies=pair, parameters=parameters, anchor=anchor)
        )
        indices.append(k)
    return replace(joints, members=members), np.array(indices, np.int64)


def swap_bodies(parameters: FloatArray) -> FloatArray:
    """Return the limits and drive of a joint with its two bodies swapped."""
    swapped_parameters: FloatArray = parameters.copy()
    if parameters[0] <= parameters[1]:
        swapped_parameters[:2] = -parameters[1], -parameters[0]
    swapped_parameters[4], swapped_parameters[12] = -parameters[4], -parameters[12]
    swapped_parameters[5:9] = so3.conjugate(parameters[5:9])
    return swapped_parameters


def to_parent_frame(pose: FloatArray, frame: FloatArray) -> FloatArray:
    """Transform a frame ``(7,)`` from a pose to the parent of the pose."""
    origin = pose[:3] + so3.rotate(pose[3:], frame[:3])
    return np.concatenate([origin, so3.multiply(pose[3:], frame[3:])])


def to_body_frame(
    bodies: RigidBodies, dynamic_index: int, frame: FloatArray
) -> FloatArray:
    """Transform a frame ``(7,)`` from principal axes to the frame of the body."""
    kind = bodies.kind_of(bodies.dynamic_indices[dynamic_index])
    return to_parent_frame(kind.principal_frame, frame)


def joint_forces_and_torques(joints: Joints, impulses: FloatArray) -> FloatArray:
    """Return joint forces [N] and torques [N m] ``(K, 2)``, without drives.

    ``impulses`` are the constraint impulses of each joint ``(K, 12)``.
    """
    force, torque = impulses[:, :3].copy(), impulses[:, 3:6].copy()
    is_prismatic = joints.kinds_and_bodies[:, 0] == JOINT_KINDS["prismatic"]
    axis_impulses = impulses[:, 6] - impulses[:, 7]
    force[is_prismatic, 0] += axis_impulses[is_prismatic]
    torque[~is_prismatic, 0] += axis_impulses[~is_prismatic]
    torques = np.hypot(np.linalg.norm(torque, axis=1), impulses[:, 8])
    return np.stack([np.linalg.norm(force, axis=1), torques], axis=1)


def _break_limits(model: RigidJointModel) -> tuple[float, float]:
    """Return the force [N] and torque [N m] at which a joint breaks."""
    if model.breaks is None:
        return np.inf, np.inf
    limits = model.breaks.force, model.breaks.torque
    force, torque = (np.inf if limit is None else limit for limit in limits)
    return force, torque


def _axis_rotation(model: RigidJointModel, name: str, location: str) -> FloatArray:
    """Return the shortest rotation from the x axis to the joint axis ``(4,)``."""
    axis = np.array(model.axis, np.float64)
    length = float(np.linalg.norm(axis))
    if not length:
        message = f"the axis of {name!r} has no direction"
        refuse("SIM061", message, f"{location}.axis", "use axis: [0, 1, 0]")
    return so3.shortest_rotation(np.array([1.0, 0.0, 0.0]), axis / length)


def relative_to_principal(
    bodies: RigidBodies, body: int, frame: FloatArray
) -> FloatArray:
    """Return a world frame relative to the principal axes of a body ``(7,)``."""
    pose = bodies.poses[body].at(bodies.begin)
    principal_frame = to_parent_frame(pose, bodies.kind_of(body).principal_frame)
    return relative_pose(principal_frame, frame)


def _limit_parameters(model: RigidJointModel, name: str, location: str) -> list[float]:
    """Return the kernel's limits of a joint: low, high, and two swing angles."""
    low, high, swing = 1.0, 0.0, [-1.0, -1.0]
    key = "twist" if model.type == "ball" else "limits"
    limits = getattr(model, key)
    if limits is not None:
        unit_factor = 1.0 if model.type == "prismatic" else np.pi / 180
        low, high = (value * unit_factor for value in limits)
        if low > high:
            message = f"the lower limit of {name!r}, {limits[0]:g}, is above the upper "
            message += "limit"
            refuse("SIM061", f"{message}, {limits[1]:g}", f"{location}.{key}")
        if model.type == "pin" and high - low > 2 * np.pi * (1 + 1e-12):
            message = f"the limits of {name!r} are more than 360 degrees apart"
            hint = "remove them, because full rotations are not counted"
            refuse("SIM061", message, f"{location}.{key}", hint)
    if model.swing is not None:
        swings = model.swing
        half_angles = swings if isinstance(swings, list) else [swings, swings]
        if min(half_angles) <= 0:
            refuse(
                "SIM061", f"the swing of {name!r} must be above 0", f"{location}.swing"
            )
        swing = np.minimum(np.radians(half_angles), MAX_SWING).tolist()
    return [low, high, *swing]


def _drive_parameters(model: RigidJointModel, location: str) -> list[float]:
    """Return the kernel's drive of a joint: target, gains and motor."""
    drive = model.drive
    if drive is None:
        return [0.0, *so3.IDENTITY, 0.0, 0.0, -1.0, 0.0]
    speed = _motor_speed(model, drive, location)
    is_ball = model.type == "ball"
    if ("target" if is_ball else "rotation") in drive.model_fields_set:
        keys = ("target", "rotation") if is_ball else ("rotation", "target")
        invalid_key, valid_key = keys
        message = f"the drive of a {model.type} has a {valid_key}, not a {invalid_key}"
        refuse(
            "SIM061", message, f"{location}.drive.{invalid_key}", f"{valid_key}: ..."
        )
    rotation = np.array(drive.rotation, np.float64)[[1, 2, 3, 0]]
    if not rotation.any():
        message = "the rotation of a drive is a zero quaternion"
        refuse("SIM061", message, f"{location}.drive")
    target = drive.target if model.type == "prismatic" else np.radians(drive.target)
    # Drives act in the joint's axes.
    axis = _axis_rotation(model, model.name, location)
    rotation = so3.multiply(so3.conjugate(axis), so3.normalize(rotation))
    rotation = so3.multiply(rotation, axis)
    max_force = -1.0 if drive.most is None else drive.most
    is_rigid = drive.speed is not None and "damping" not in drive.model_fields_set
    damping = RIGID_MOTOR_DAMPING if is_rigid else drive.damping
    return [target, *rotation, drive.stiffness, damping, max_force, speed]


def _motor_speed(
    model: RigidJointModel, drive: JointDriveModel, location: str
) -> float:
    """Return the speed of a joint motor [rad/s] or [m/s]; 0 if it has none."""
    if drive.speed is None:
        return 0.0
    if model.type == "ball":
        message = "the drive of a ball has no speed, because it has no single axis"
        refuse("SIM061", message, f"{location}.drive.speed", "type: pin")
    for key in ("stiffness", "target"):
        if key in drive.model_fields_set:
            message = f"a drive has either a speed or a {key}"
            refuse("SIM061", message, f"{location}.drive.{key}", "keep one")
    if "damping" in drive.model_fields_set and not drive.damping:
        message = "a motor with zero damping has no effect"
        hint = "remove it to make the motor rigid"
        refuse("SIM061", message, f"{location}.drive.damping", hint)
    return drive.speed * (1.0 if model.type == "prismatic" else float(np.pi / 180))


def _distance_warnings(
    bodies: RigidBodies, body: int, joint_frame: FloatArray, name: str, location: str
) -> list[Fault]:
    """Return a warning if a joint is far from the body that it moves (SIM127)."""
    kind, pose = bodies.kind_of(body), bodies.poses[body].at(bodies.begin)
    offset = joint_frame[:3] - pose[:3] - so3.rotate(pose[3:], kind.centre)
    distance = float(np.linalg.norm(offset))
    if distance <= MAX_DISTANCE_RADII * kind.bounding_radius:
        return []
    message = f"{name} is {distance:g} m from {bodies.names[body]!r}, which extends "
    hint = "correct `at`, which is not in the frame of the body: in world space "
    hint += f"{bodies.names[body]!r} is at {vector_text(pose[:3])}"
    message += f"{kind.bounding_radius:g} m from its centre of mass"
    return [warning("SIM127", message, hint, f"{location}.at")]
