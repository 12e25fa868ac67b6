"""Ragdolls: a rig's colliders as bodies, connected by its joints.

Joints with colliders become bodies, connected by joints with the limits of the rig. Rig
joints between two bodies are rigid; those below the last body follow the take.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Annotated

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.options import MAX_OPTION_VALUE, between
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Mass
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Capsule, Poses
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.systems.framework.fields import ColliderEntries
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.cores import point_inertia
from animtool.systems.rigid.joints import (
    MAX_SWING,
    BodyJoint,
    Joints,
    relative_to_principal,
)
from animtool.systems.rigid.kind import BodyKind, build_body_kind, principal_inertia
from animtool.systems.rigid.spec import BodyModel
from animtool.systems.rigid.tone import add_finger_capsules, passive_springs

_JOINT_TYPES = {
    JointType.FIXED: 0, JointType.PIN: 1, JointType.BALL: 2, JointType.FREE: 2,
    JointType.PRISMATIC: 3,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class RagdollOptions:
    """Options of the pass `ragdoll`: frames, mass, joints and colliders."""

    start: float | None = None  # start frame; None for the first
    end: float | None = None  # frame at which the take resumes; None for never
    # Blend frames at the start, and after `end` [frames].
    blend: Annotated[float, between(0.0, "SIM062", 1e6)] = 4.0
    # Total mass [kg], distributed as the rig states.
    mass: Annotated[float | None, between(0.0, "SIM062", includes_minimum=False)] = None
    # Density if neither `mass` nor the rig sets a mass [kg/m³].
    density: Annotated[float, between(0.0, "SIM062", includes_minimum=False)] = 1000.0
    # Stiffness towards the pose of the take [N m/rad].
    stiffness: Annotated[float, between(0.0, "SIM062")] = 0.0
    # Damping of joints [N m s/rad].
    damping: Annotated[float, between(0.0, "SIM062")] = 0.5
    # Passive stiffness and damping towards the pose of `start`, as of muscles and
    # ligaments [1]; 0 is limp.
    tone: Annotated[float, between(0.0, "SIM062", 100.0)] = 1.0
    # Whether fingers without colliders get capsules attached to the hand.
    fingers: bool = True
    # Along the rig's negative up axis [m/s²].
    gravity: Annotated[float, between(-MAX_OPTION_VALUE, "SIM062")] = 9.81
    friction: Annotated[float, between(0.0, "SIM062")] = 0.6  # friction coefficient [1]
    colliders: ColliderEntries = ()  # colliders of the ragdoll
    # Step [s].
    step: Annotated[float, between(0.0, "SIM062", 1.0, includes_minimum=False)] = 0.005
    # Substeps of each step.
    substeps: Annotated[int, between(1.0, "SIM062", 1000.0)] = 8


@dataclass(frozen=True)
class Ragdoll:
    """The bodies of a rig in the pose of one frame."""

    rig: Rig  # rig with colliders
    joints: IntArray  # joints with bodies, ascending (N,)
    parent_bodies: IntArray  # parent body of each body, -1 for none (N,)
    bodies: RigidBodies  # bodies in the same order
    # Rest frame of each joint relative to the parent body: origin and quaternion, with
    # x along the joint's axis (N, 7).
    frames: FloatArray
    axes: FloatArray  # rotation of each body's frame to its joint's axes (N, 4)


def build_ragdoll(rig: Rig, world: WorldTransforms, options: RagdollOptions) -> Ragdoll:
    """Return the ragdoll of a rig posed as in one frame.

    Raises OptionError (SIM062) if no ragdoll can be built from the rig.
    """
    capsules = JointCapsules.from_rig(rig)
    if not len(capsules):
        message = f"no joint of {rig.name!r} has colliders: nothing can fall"
        hint = "give its rig file `colliders`: capsules on joints"
        raise OptionError(Fault("SIM062", message, hint=hint))
    if options.fingers:
        capsules = add_finger_capsules(rig, world, capsules)
    joints = np.unique(capsules.joints)
    kinds = _body_kinds(rig, world, capsules, joints, options)
    rotations = so3.split_scale(world.linear[0])[0]
    positions = world.positions[0]
    poses = [Poses.fixed(positions[joint], rotations[joint]) for joint in joints]
    body_indices, is_dynamic = np.arange(len(joints)), np.ones(len(joints), np.bool_)
    bodies = RigidBodies(kinds, rig.names, body_indices, is_dynamic, poses, 0.0)
    frames, axes = _rest_frames(rig, positions, rotations, joints)
    return Ragdoll(rig, joints, _parent_bodies(rig, joints), bodies, frames, axes)


def _body_kinds(
    rig: Rig,
    world: WorldTransforms,
    capsules: JointCapsules,
    joints: IntArray,
    options: RagdollOptions,
) -> list[BodyKind]:
    """Return the body kind of each joint; raise SIM062 if a capsule has no radius."""
    _, ends = capsules.joint_poses_and_ends(world)
    radii = capsules.world_radii(world)
    kinds: list[BodyKind] = []
    for j in joints.tolist():
        shapes = []
        for capsule_index in np.flatnonzero(capsules.joints == j).tolist():
            if not radii[capsule_index] > 0:
                message = f"a collider of joint {rig.joints[j].name!r} has no size"
                hint = "give its capsule a radius above 0"
                raise OptionError(Fault("SIM062", message, hint=hint))
            radius, (a, b) = float(radii[capsule_index]), ends[capsule_index]
            length = float(np.linalg.norm(b - a))
            axis = (b - a) / length if length else np.array([0.0, 1.0, 0.0])
            shapes.append(Capsule(radius, length, tuple(axis), tuple((a + b) / 2)))
        model = BodyModel.model_validate(
            {
                "name": rig.joints[j].name,
                "shapes": [{"shape": {"capsule": None}}] * len(shapes),
                "density": options.density,
                "friction": options.friction,
            }
        )
        body_data = {"shapes": [{"shape": shape} for shape in shapes]}
        kinds.append(build_body_kind(model, body_data))
    if rig.masses:
        kinds = _replace_masses(rig, world, joints, kinds)
    if options.mass is None:
        return kinds
    mass_factor = options.mass / sum(kind.mass for kind in kinds)
    return [
        replace(kind, mass=kind.mass * mass_factor, moments=kind.moments * mass_factor)
        for kind in kinds
    ]


def _parent_bodies(rig: Rig, joints: IntArray) -> IntArray:
    """Return the parent body of each body ``(N,)``; -1 if there is none."""
    body_of_joint = {int(j): i for i, j in enumerate(joints)}
    parents = np.full(len(joints), -1)
    body_of_root: dict[int, int] = {}
    for i, j in enumerate(joints.tolist()):
        ancestors = [body_of_joint[k] for k in rig.upwards(j)[1:] if k in body_of_joint]
        # Branches below a joint without a body are attached to the first of them.
        if ancestors:
            parents[i] = ancestors[0]
        else:
            parents[i] = body_of_root.setdefault(movable_root(rig, j), i)
        if parents[i] == i:
            parents[i] = -1
    return parents


def _rest_frames(
    rig: Rig, positions: FloatArray, rotations: FloatArray, joints: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return rest frames of joints ``(N, 7)``, and rotations to their axes ``(N, 4)``.

    World ``positions`` ``(J, 3)`` [m] and ``rotations`` ``(J, 4)`` are of all joints.
    """
    frames, axes = np.zeros((len(joints), 7)), np.zeros((len(joints), 4))
    for i, j in enumerate(joints.tolist()):
        joint = rig.joints[j]
        axes[i] = _joint_axes(joint)
        origin, rotation = np.zeros(3), so3.IDENTITY
        if joint.parent >= 0:
            origin, rotation = positions[joint.parent], rotations[joint.parent]
        rest_rotation = so3.multiply(rotation, np.array(joint.rotation))
        frames[i, :3] = positions[j]
        if joint.type is JointType.PRISMATIC:
            frames[i, :3] = origin + so3.rotate(rotation, np.array(joint.translation))
        frames[i, 3:] = so3.multiply(rest_rotation, axes[i])
    return frames, axes


def movable_root(rig: Rig, joint: int) -> int:
    """Return the nearest free joint at or above a joint, or else the root."""
    ancestors = rig.upwards(joint)
    free_joints = (k for k in ancestors if rig.joints[k].type is JointType.FREE)
    return next(free_joints, ancestors[-1])


def _joint_axes(joint: Joint) -> FloatArray:
    """Return the rotation of x, y, z to the twist and swing axes of a joint."""
    if isinstance(joint.limits, BallLimit):
        return so3.from_matrix(joint.limits.axes.T)
    x, y, z = np.asarray(joint.axis, np.float64)
    if joint.type in (JointType.PIN, JointType.PRISMATIC) and x > -1 + 1e-12:
        return so3.normalize(np.array([0.0, -z, y, 1 + x]))
    if joint.type in (JointType.PIN, JointType.PRISMATIC):
        return np.array([0.0, 1.0, 0.0, 0.0])
    return so3.IDENTITY.copy()


def build_ragdoll_joints(
    ragdoll: Ragdoll, options: RagdollOptions, targets: Callable[[float], FloatArray]
) -> Joints:
    """Return the joints between the bodies of a ragdoll.

    ``targets`` returns drive targets ``(N, 5)`` at a time [s].
    """
    rig, bodies = ragdoll.rig, ragdoll.bodies
    bodies_with_parent = np.flatnonzero(ragdoll.parent_bodies >= 0)
    springs = _passive_springs(ragdoll, options)
    start_targets = targets(0.0) if options.tone else None
    members = []
    for i in bodies_with_parent.tolist():
        joint = rig.joints[ragdoll.joints[i]]
        pose = bodies.poses[i].at(0.0)
        joint_frame = np.concatenate(
            [pose[:3], so3.multiply(pose[3:], ragdoll.axes[i])]
        )
        parent = int(ragdoll.parent_bodies[i])
        stiffness, damping = springs[i] + [options.stiffness, options.damping]
        target = [0.0, *so3.IDENTITY] if start_targets is None else start_targets[i]
        frame_a = relative_to_principal(bodies, parent, ragdoll.frames[i])
        frame_b = relative_to_principal(bodies, i, joint_frame)
        drive = [*target, stiffness, damping, -1.0, 0.0]
        parameters = [*frame_a, *frame_b, *_limit_parameters(joint), *drive]
        kind, pair = _JOINT_TYPES[joint.type], (parent, i)
        members.append(
            BodyJoint(joint.name, kind, pair, parameters, Poses(), parent, pair)
        )
    joints = Joints(members, other_pairs=_overlapping_pairs(ragdoll))

    def drive_parameters_at(t: float) -> FloatArray:
        parameters: FloatArray = joints.parameters.copy()
        parameters[:, 18:23] = targets(t)[bodies_with_parent]
        return parameters

    return (
        replace(joints, drive_parameters_at=drive_parameters_at)
        if options.stiffness
        else joints
    )


def _passive_springs(ragdoll: Ragdoll, options: RagdollOptions) -> FloatArray:
    """Return passive stiffness and damping of the joints of bodies ``(N, 2)``."""
    if not options.tone:
        return np.zeros((len(ragdoll.joints), 2))
    bodies, parent_bodies = ragdoll.bodies, ragdoll.parent_bodies
    centres, pivots = bodies.initial_states[:, :3], ragdoll.frames[:, :3]
    springs = passive_springs(parent_bodies, bodies.masses, centres, pivots)
    joint_types = [ragdoll.rig.joints[j].type for j in ragdoll.joints]
    is_rotational = [type is not JointType.PRISMATIC for type in joint_types]
    factors = np.array([options.tone, np.sqrt(options.tone)])
    return np.asarray(springs * factors * np.array(is_rotational)[:, None])


def _limit_parameters(joint: Joint) -> list[float]:
    """Return the kernel's limits of a joint: low, high, and two swing angles."""
    match joint.limits:
        case RangeLimit(low=low, high=high):
            return [low, high, -1.0, -1.0]
        case BallLimit(swing=swing, twist=twist):
            low, high = (1.0, 0.0) if twist is None else twist
            swings = [-1.0, -1.0] if swing is None else np.minimum(swing, MAX_SWING)
            return [low, high, *swings]
    return [1.0, 0.0, -1.0, -1.0]


def _overlapping_pairs(ragdoll: Ragdoll) -> IntArray:
    """Return pairs of bodies that overlap at the start ``(P, 2)``."""
    fractions = np.linspace(0, 1, 9)[:, None]
    # Points on the axis of each core, and its radius.
    samples_by_body = []
    for kind, poses in zip(ragdoll.bodies.kinds, ragdoll.bodies.poses, strict=True):
        pose, axis_samples = poses.at(0.0), []
        for core in kind.cores:
            points = core.transformed(pose[:3], pose[3:]).points
            axis_points = points[0] + fractions * (points[-1] - points[0])
            axis_samples.append((axis_points, core.radius))
        samples_by_body.append(axis_samples)
    pairs = []
    for i, j in combinations(range(len(samples_by_body)), 2):
        gaps = [
            np.linalg.norm(a[:, None] - b, axis=2).min() - radius_a - radius_b
            for a, radius_a in samples_by_body[i]
            for b, radius_b in samples_by_body[j]
        ]
        if min(gaps) < 0:
            pairs.append((i, j))
    return np.array(pairs, np.int64).reshape(-1, 2)


def _replace_masses(
    rig: Rig, world: WorldTransforms, joints: IntArray, kinds: Sequence[BodyKind]
) -> list[BodyKind]:
    """Return body kinds with their masses replaced by those of the rig.

    A mass is added to the body of its joint, or of the next ancestor that has a body.
    Bodies without a mass in the rig are unchanged. ``world`` has one frame; ``joints``
    are those of the bodies ``(N,)``.
    """
    body_of_joint = {int(j): i for i, j in enumerate(joints)}
    masses_by_body: dict[int, list[Mass]] = {}
    for mass in rig.masses:
        ancestors = rig.upwards(rig.index(mass.joint))
        body = next((body_of_joint[j] for j in ancestors if j in body_of_joint), None)
        if body is not None:
            masses_by_body.setdefault(body, []).append(mass)
    rotations = so3.split_scale(world.linear[0])[0]
    new_kinds = list(kinds)
    for body, masses in masses_by_body.items():
        kind, joint = kinds[body], int(joints[body])
        if all(mass.inertia is None for mass in masses):
            total_mass = sum(mass.mass for mass in masses)
            moments = kind.moments * (total_mass / kind.mass)
            new_kinds[body] = replace(kind, mass=total_mass, moments=moments)
        else:
            new_kinds[body] = _combined_body(rig, world, rotations, joint, masses, kind)
    return new_kinds


def _combined_body(
    rig: Rig,
    world: WorldTransforms,
    rotations: FloatArray,
    body: int,
    masses: Sequence[Mass],
    kind: BodyKind,
) -> BodyKind:
    """Return a body kind with the combined masses of several joints."""
    world_to_body = so3.conjugate(rotations[body])
    total_mass = sum(mass.mass for mass in masses)
    centres, inertias = [], []
    for mass in masses:
        j = rig.index(mass.joint)
        offset = so3.rotate(rotations[j], np.array(mass.centre))
        position = world.positions[0, j] + offset
        centres.append(so3.rotate(world_to_body, position - world.positions[0, body]))
        rotation = so3.multiply(world_to_body, rotations[j])
        matrix = so3.to_matrix(so3.multiply(rotation, np.array(mass.axes)))
        # A mass without inertia is a point mass.
        local_inertia = np.diag(mass.inertia or (0.0, 0.0, 0.0))
        inertias.append(matrix @ local_inertia @ matrix.T)
    mass_values = np.array([mass.mass for mass in masses])
    centre = (mass_values[:, None] * np.array(centres)).sum(axis=0) / total_mass
    inertia = np.sum(inertias, axis=0)
    for mass_value, position in zip(mass_values, centres, strict=True):
        inertia = inertia + point_inertia(mass_value, position - centre)
    moments, axes = principal_inertia(inertia)
    return replace(kind, mass=total_mass, centre=centre, moments=moments, axes=axes)
