"""Joints of a spec, in the kernel's layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Refusals, refuse, warning
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.rigid.bodies import NO_PAIRS, RigidBodies, refuse_unknown
from animtool.systems.rigid.spec import BodyModel, JointDriveModel, RigidJointModel

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
# Joints farther from their body than this many of its radii are a warning.
FAR_RADII = 4.0
# Largest half-angle of a swing, below 180 degrees, where its axis is undefined.
MAX_SWING = np.radians(179.0)


@dataclass(frozen=True)
class Joints:
    """K joints of dynamic bodies."""

    rows: IntArray  # type and both bodies (K, 3)
    numbers: FloatArray  # parameters in the kernel's layout (K, 27)
    anchors: Sequence[Poses]  # animated frames, for joints that have one
    names: Sequence[str] = ()
    above: Sequence[int] = ()  # parent body of each joint, of all bodies; -1 for none
    notices: Sequence[Fault] = ()
    # Pair of bodies that each joint excludes from collision, numbered as all; -1 for
    # none (K, 2).
    pairs: IntArray = field(default_factory=lambda: NO_PAIRS)
    # Other excluded pairs (P, 2).
    others: IntArray = field(default_factory=lambda: NO_PAIRS)
    # Break force [N] and torque [N m] (K, 2); empty if none breaks.
    breaks: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    # Returns numbers at a time [s] if drives change; else None.
    driven: Callable[[float], FloatArray] | None = None

    def subset(self, which: IntArray) -> Joints:
        """Return a subset of the joints, by index."""
        numbers = which.tolist()
        return replace(
            self,
            rows=self.rows[which],
            numbers=self.numbers[which],
            anchors=[self.anchors[k] for k in numbers],
            names=[self.names[k] for k in numbers] if self.names else (),
            above=[self.above[k] for k in numbers] if self.above else (),
            pairs=self.pairs[which],
            breaks=self.breaks[which],
        )

    @property
    def breakable(self) -> bool:
        """Whether any joint can break."""
        return bool(np.isfinite(self.breaks).any())

    @property
    def excluded_pairs(self) -> IntArray:
        """All pairs of bodies that do not collide ``(P, 2)``."""
        return np.concatenate([self.pairs[self.pairs[:, 0] >= 0], self.others])

    def frames(self, t0: float, t1: float) -> FloatArray:
        """Return anchor frames at both ends of a step ``(K, 2, 7)``."""
        ends = [[poses.at(t0), poses.at(t1)] for poses in self.anchors]
        return np.array(ends, np.float64).reshape(-1, 2, 7)


def concatenate_joints(joint_sets: Sequence[Joints]) -> Joints:
    """Concatenate several sets of joints."""
    return Joints(
        np.concatenate([joints.rows for joints in joint_sets]),
        np.concatenate([joints.numbers for joints in joint_sets]),
        [poses for joints in joint_sets for poses in joints.anchors],
        [name for joints in joint_sets for name in joints.names],
        [body for joints in joint_sets for body in joints.above],
        [notice for joints in joint_sets for notice in joints.notices],
        np.concatenate([joints.pairs for joints in joint_sets]),
        np.concatenate([joints.others for joints in joint_sets]),
        np.concatenate([joints.breaks for joints in joint_sets]),
    )


def check_joints(
    models: Sequence[RigidJointModel], bodies: Sequence[BodyModel]
) -> None:
    """Refuse joints that are invalid for any poses (SIM061)."""
    models_by_name = {body.name: body for body in bodies}
    refusals = Refusals()
    for i, model in enumerate(models):
        where = f"joints[{i}]"
        name = model.name or where
        with refusals.collect():
            body = _model_of(model.body, models_by_name, f"{where}.body")
            if body.kinematic and body.release is None:
                message = f"{model.body!r} is kinematic: joints cannot move it"
                refuse("SIM061", message, f"{where}.body")
        with refusals.collect():
            if model.to is not None:
                _model_of(model.to, models_by_name, f"{where}.to")
            if model.to == model.body:
                refuse(
                    "SIM061", f"{name!r} joins {model.body!r} to itself", f"{where}.to"
                )
        for option, types in _OPTION_TYPES.items():
            with refusals.collect():
                if getattr(model, option) is not None and model.type not in types:
                    message = f"{name!r} is a {model.type} joint: {option} is for "
                    message += f"{' and '.join(types)}"
                    hint = f"type: {types[0]}"
                    if model.type == "ball" and option == "limits":
                        hint = "use swing: 40, or twist: [-30, 30]"
                    refuse("SIM061", message, f"{where}.{option}", hint)
        with refusals.collect():
            _axis_rotation(model, name, where)
        with refusals.collect():
            _joint_limits(model, name, where)
        with refusals.collect():
            _joint_drive(model, where)
    refusals.check()


def _model_of(name: str, bodies: Mapping[str, BodyModel], key: str) -> BodyModel:
    """Return a body by name, or the model of a copy, as ``crate[2]``."""
    if name not in bodies and name.rpartition("[")[0] not in bodies:
        refuse_unknown(name, list(bodies), key)
    return bodies.get(name) or bodies[name.rpartition("[")[0]]


def joints_of(
    models: Sequence[RigidJointModel],
    parts: Sequence[Mapping[str, Any]],
    bodies: RigidBodies,
) -> Joints:
    """Return the joints of a spec, once `check_joints` has passed.

    Joints that are invalid for the poses of the bodies are refused (SIM061).
    """
    rows, numbers, anchors, above, pairs, breaks = [], [], [], [], [], []
    notices: list[Fault] = []
    dynamic_indices = {int(i): k for k, i in enumerate(bodies.dynamic)}
    for i, (model, part) in enumerate(zip(models, parts, strict=True)):
        where = f"joints[{i}]"
        name = model.name or where
        second = bodies.find(model.body, f"{where}.body")
        poses: Poses = part["poses"]
        frame = poses.at(bodies.begin)
        frame[3:] = so3.multiply(frame[3:], _axis_rotation(model, name, where))
        on_b = relative_to_principal(bodies, second, frame)
        first, anchor, parent = -1, Poses(), -1
        if model.to is None:
            anchor = poses
            on_a = np.concatenate([np.zeros(3), _axis_rotation(model, name, where)])
        else:
            parent = bodies.find(model.to, f"{where}.to")
            if len(poses.sample_times) > 1:
                message = f"{name!r} follows {model.to!r}, so it cannot have moves or "
                message += "a prim"
                refuse("SIM061", message, where)
            if parent in dynamic_indices:
                first, on_a = (
                    dynamic_indices[parent],
                    relative_to_principal(bodies, parent, frame),
                )
            else:
                anchor = bodies.poses[parent]
                on_a = relative_frame(anchor.at(bodies.begin), frame)
        rows.append((JOINT_KINDS[model.type], first, dynamic_indices[second]))
        numbers.append(
            [
                *on_a,
                *on_b,
                *_joint_limits(model, name, where),
                *_joint_drive(model, where),
            ]
        )
        anchors.append(anchor)
        above.append(parent)
        excluded = parent >= 0 and not model.contacts
        pairs.append((second, parent) if excluded else (-1, -1))
        breaks.append(_break_limits(model))
        for body in (second, parent) if parent >= 0 else (second,):
            notices += _far_warnings(bodies, body, frame, name, where)
    return Joints(
        np.array(rows, np.int64).reshape(-1, 3),
        np.array(numbers, np.float64).reshape(-1, PARAMETER_COUNT),
        anchors,
        [model.name or f"joint_{i + 1}" for i, model in enumerate(models)],
        above,
        notices,
        np.array(pairs, np.int64).reshape(-1, 2),
        breaks=np.array(breaks, np.float64).reshape(-1, 2),
    )


def joints_of_subset(
    joints: Joints, full: RigidBodies, bodies: RigidBodies
) -> tuple[Joints, IntArray]:
    """Return the joints of a subset of dynamic bodies, and their indices.

    Joints between two other bodies have no effect, and are left out.

    Args:
        joints: Joints of all bodies.
        full: All bodies that are ever dynamic.
        bodies: The bodies that are dynamic now.
    """
    if bodies is full:
        return joints, np.arange(len(joints.rows))
    dynamic_indices = {int(i): k for k, i in enumerate(bodies.dynamic)}
    rows, numbers, anchors, indices = [], [], [], []
    for k, (row, parameters) in enumerate(
        zip(joints.rows, joints.numbers, strict=True)
    ):
        kind, first, second = row.tolist()
        on_a, on_b, settings = parameters[:7], parameters[7:14], parameters[14:]
        a = -1 if first < 0 else int(full.dynamic[first])
        b, anchor = int(full.dynamic[second]), joints.anchors[k]
        if a >= 0 and a not in dynamic_indices:
            on_a, anchor = to_body_frame(full, first, on_a), bodies.poses[a]
        if b not in dynamic_indices:
            if a not in dynamic_indices:
                continue
            # Swapped: the joint's second body becomes the first.
            anchor, a, b = bodies.poses[b], b, a
            on_a, on_b = to_body_frame(full, second, on_b), on_a
            settings = swapped_parameters(settings)
        rows.append((kind, dynamic_indices.get(a, -1), dynamic_indices[b]))
        numbers.append(np.concatenate([on_a, on_b, settings]))
        anchors.append(anchor)
        indices.append(k)
    subset = joints.subset(np.array(indices, np.int64))
    joined = replace(
        subset,
        rows=np.array(rows, np.int64).reshape(-1, 3),
        numbers=np.array(numbers, np.float64).reshape(-1, PARAMETER_COUNT),
        anchors=anchors,
    )
    return joined, np.array(indices, np.int64)


def swapped_parameters(parameters: FloatArray) -> FloatArray:
    """Return a joint's limits and drive with its two bodies swapped."""
    swapped: FloatArray = parameters.copy()
    if parameters[0] <= parameters[1]:
        swapped[:2] = -parameters[1], -parameters[0]
    swapped[4], swapped[12] = -parameters[4], -parameters[12]
    swapped[5:9] = so3.conjugate(parameters[5:9])
    return swapped


def to_parent(pose: FloatArray, frame: FloatArray) -> FloatArray:
    """Return a frame expressed in the parent of another ``(7,)``."""
    origin = pose[:3] + so3.rotate(pose[3:], frame[:3])
    return np.concatenate([origin, so3.multiply(pose[3:], frame[3:])])


def to_body_frame(bodies: RigidBodies, number: int, frame: FloatArray) -> FloatArray:
    """Return a frame of principal axes in body coordinates ``(7,)``."""
    kind = bodies.kinds[bodies.of[bodies.dynamic[number]]]
    return to_parent(np.concatenate([kind.centre, kind.axes]), frame)


def joint_loads(joints: Joints, impulses: FloatArray) -> FloatArray:
    """Return joint forces [N] and torques [N m] ``(K, 2)``, without drives.

    Args:
        joints: The joints.
        impulses: Constraint impulses of each joint ``(K, 12)``.
    """
    force, torque = impulses[:, :3].copy(), impulses[:, 3:6].copy()
    is_prismatic = joints.rows[:, 0] == JOINT_KINDS["prismatic"]
    axis_impulses = impulses[:, 6] - impulses[:, 7]
    force[is_prismatic, 0] += axis_impulses[is_prismatic]
    torque[~is_prismatic, 0] += axis_impulses[~is_prismatic]
    torques = np.hypot(np.linalg.norm(torque, axis=1), impulses[:, 8])
    return np.stack([np.linalg.norm(force, axis=1), torques], axis=1)


def _break_limits(model: RigidJointModel) -> tuple[float, float]:
    if model.breaks is None:
        return np.inf, np.inf
    limits = model.breaks.force, model.breaks.torque
    force, torque = (np.inf if limit is None else limit for limit in limits)
    return force, torque


def _axis_rotation(model: RigidJointModel, name: str, where: str) -> FloatArray:
    """Return the shortest rotation of x to the axis ``(4,)``."""
    axis = np.array(model.axis, np.float64)
    length = float(np.linalg.norm(axis))
    if not length:
        message = f"the axis of {name!r} has no direction"
        refuse("SIM061", message, f"{where}.axis", "use axis: [0, 1, 0]")
    return so3.between(np.array([1.0, 0.0, 0.0]), axis / length)


def relative_frame(pose: FloatArray, frame: FloatArray) -> FloatArray:
    """Return a frame relative to another ``(7,)``."""
    inverse = so3.conjugate(pose[3:])
    origin = so3.rotate(inverse, frame[:3] - pose[:3])
    return np.concatenate([origin, so3.multiply(inverse, frame[3:])])


def relative_to_principal(bodies: RigidBodies, i: int, frame: FloatArray) -> FloatArray:
    """Return a world frame relative to a body's principal axes ``(7,)``."""
    kind, pose = bodies.kinds[bodies.of[i]], bodies.poses[i].at(bodies.begin)
    at = pose[:3] + so3.rotate(pose[3:], kind.centre)
    return relative_frame(
        np.concatenate([at, so3.multiply(pose[3:], kind.axes)]), frame
    )


def _joint_limits(model: RigidJointModel, name: str, where: str) -> list[float]:
    low, high, swing = 1.0, 0.0, [-1.0, -1.0]
    key = "twist" if model.type == "ball" else "limits"
    limits = getattr(model, key)
    if limits is not None:
        scale = 1.0 if model.type == "prismatic" else np.pi / 180
        low, high = (value * scale for value in limits)
        if low > high:
            message = f"the lower limit of {name!r}, {limits[0]:g}, is above the upper "
            message += "limit"
            refuse("SIM061", f"{message}, {limits[1]:g}", f"{where}.{key}")
        if model.type == "pin" and high - low > 2 * np.pi * (1 + 1e-12):
            message = f"the limits of {name!r} are more than 360 degrees apart"
            hint = "remove them: full rotations are not counted"
            refuse("SIM061", message, f"{where}.{key}", hint)
    if model.swing is not None:
        pair = model.swing if isinstance(model.swing, list) else [model.swing] * 2
        if min(pair) <= 0:
            refuse("SIM061", f"the swing of {name!r} must be above 0", f"{where}.swing")
        swing = np.minimum(np.radians(pair), MAX_SWING).tolist()
    return [low, high, *swing]


def _joint_drive(model: RigidJointModel, where: str) -> list[float]:
    drive = model.drive
    if drive is None:
        return [0.0, *so3.IDENTITY, 0.0, 0.0, -1.0, 0.0]
    speed = _motor_speed(model, drive, where)
    ball = model.type == "ball"
    if ("target" if ball else "rotation") in drive.model_fields_set:
        invalid_key, valid_key = (
            ("target", "rotation") if ball else ("rotation", "target")
        )
        message = f"the drive of a {model.type} has a {valid_key}, not a {invalid_key}"
        refuse("SIM061", message, f"{where}.drive.{invalid_key}", f"{valid_key}: ...")
    rotation = np.array(drive.rotation, np.float64)[[1, 2, 3, 0]]
    if not rotation.any():
        refuse(
            "SIM061", "the rotation of a drive is a zero quaternion", f"{where}.drive"
        )
    target = drive.target if model.type == "prismatic" else np.radians(drive.target)
    # Drives act in the joint's axes.
    axis = _axis_rotation(model, model.name, where)
    rotation = so3.multiply(
        so3.multiply(so3.conjugate(axis), so3.normalize(rotation)), axis
    )
    max_force = -1.0 if drive.most is None else drive.most
    is_rigid = drive.speed is not None and "damping" not in drive.model_fields_set
    damping = RIGID_MOTOR_DAMPING if is_rigid else drive.damping
    return [target, *rotation, drive.stiffness, damping, max_force, speed]


def _motor_speed(model: RigidJointModel, drive: JointDriveModel, where: str) -> float:
    """Return a motor's speed [rad/s] or [m/s]."""
    if drive.speed is None:
        return 0.0
    if model.type == "ball":
        message = "the drive of a ball has no speed: it has no single axis"
        refuse("SIM061", message, f"{where}.drive.speed", "type: pin")
    for key in ("stiffness", "target"):
        if key in drive.model_fields_set:
            message = f"a drive has either a speed or a {key}"
            refuse("SIM061", message, f"{where}.drive.{key}", "keep one")
    if "damping" in drive.model_fields_set and not drive.damping:
        message = "a motor with zero damping has no effect"
        refuse(
            "SIM061",
            message,
            f"{where}.drive.damping",
            "remove it to make the motor rigid",
        )
    return drive.speed * (1.0 if model.type == "prismatic" else float(np.pi / 180))


def _far_warnings(
    bodies: RigidBodies, i: int, frame: FloatArray, name: str, where: str
) -> list[Fault]:
    kind, pose = bodies.kinds[bodies.of[i]], bodies.poses[i].at(bodies.begin)
    offset = frame[:3] - pose[:3] - so3.rotate(pose[3:], kind.centre)
    distance = float(np.linalg.norm(offset))
    if distance <= FAR_RADII * kind.reach:
        return []
    message = f"{name} is {distance:g} m from {bodies.names[i]!r}, which extends "
    hint = "is its `where` in world space?"
    message += f"{kind.reach:g} m from its centre of mass"
    return [warning("SIM127", message, hint, f"{where}.at")]
