"""Ragdoll simulation from poses of a rig, and its results as transforms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import JointType, Rig
from animtool.sim.colliders import Colliders
from animtool.systems.particles.forces import find_force
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.ragdoll import Ragdoll, movable_root
from animtool.systems.rigid.simulation import RigidSimulation
from animtool.systems.rigid.spec import RigidModel


def ragdoll_simulation(
    ragdoll: Ragdoll,
    joints: Joints,
    colliders: Colliders,
    gravity: Sequence[float],
    name: str,
    **spec_keys: float,
) -> RigidSimulation:
    """Return a rigid simulation of a ragdoll, with gravity ``(3,)`` [m/s²].

    The name is used in messages; ``spec_keys`` are further keys of the rigid system.
    """
    force: Any = find_force("gravity")
    # The spec needs one body; the simulation's bodies are the rig's.
    body = {"name": "body", "shape": {"sphere": {"radius": 1}}}
    spec = RigidModel.model_validate(
        {"name": name, "bodies": [body], "sleep": {"speed": 0}, **spec_keys}
    )
    forces = [force(acceleration=tuple(gravity))]
    return RigidSimulation(spec, 0.0, ragdoll.bodies, joints, colliders, forces)


@dataclass(frozen=True)
class DriveTargets:
    """Drive targets from the joint coordinates of a take."""

    ragdoll: Ragdoll
    times: FloatArray  # times of frames (F,) [s]
    coordinates: FloatArray  # joint coordinates of frames (F, Q)
    coordinate_slices: Sequence[slice]

    def __call__(self, t: float) -> FloatArray:
        """Return position and rotation targets of drives ``(N, 5)`` at a time [s]."""
        targets = np.tile([0.0, *so3.IDENTITY], (len(self.ragdoll.joints), 1))
        k = int(np.clip(np.searchsorted(self.times, t) - 1, 0, len(self.times) - 2))
        duration = self.times[k + 1] - self.times[k]
        fraction = float(np.clip((t - self.times[k]) / duration, 0, 1))
        for i, j in enumerate(self.ragdoll.joints.tolist()):
            joint, coordinate_slice = (
                self.ragdoll.rig.joints[j],
                self.coordinate_slices[j],
            )
            start_values, end_values = self.coordinates[k : k + 2, coordinate_slice]
            if joint.type in (JointType.PIN, JointType.PRISMATIC):
                targets[i, 0] = (start_values + fraction * (end_values - start_values))[
                    0
                ]
            elif joint.type in (JointType.BALL, JointType.FREE):
                rotation = so3.slerp(start_values[-4:], end_values[-4:], fraction)
                axes = self.ragdoll.axes[i]
                rotation_in_axes = so3.multiply(so3.conjugate(axes), rotation)
                targets[i, 1:] = so3.multiply(rotation_in_axes, axes)
        return targets


def ragdoll_velocities(
    ragdoll: Ragdoll, world: WorldTransforms, times: FloatArray, frame_index: int
) -> FloatArray:
    """Return linear velocities and angular momenta of bodies at a frame ``(N, 6)``."""
    k = max(frame_index - 1, 0)
    frame_pair = slice(k, k + 2)
    duration = float(times[k + 1] - times[k])
    positions = world.positions[frame_pair, ragdoll.joints]
    rotations = so3.split_scale(world.linear[frame_pair, ragdoll.joints])[0]
    spins = so3.log(so3.multiply(rotations[1], so3.conjugate(rotations[0]))) / duration
    rigid_bodies = ragdoll.bodies
    centre_offsets = so3.rotate(rotations[1], rigid_bodies.centres)
    velocities = (positions[1] - positions[0]) / duration + np.cross(
        spins, centre_offsets
    )
    axes = rigid_bodies.initial_states[:, 3:7]
    momenta_local = so3.rotate(so3.conjugate(axes), spins) * rigid_bodies.moments
    return np.concatenate([velocities, so3.rotate(axes, momenta_local)], axis=1)


def ragdoll_transforms(
    ragdoll: Ragdoll,
    body_origins: FloatArray,
    body_rotations: FloatArray,
    local_translations: FloatArray,
    local_rotations: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return local translations and rotations of all joints, with constant lengths.

    Joints between two bodies keep their initial transform; joints below the last body
    follow the take.

    Origins [m] and rotations of bodies are in world space ``(F, N, 3)``, ``(F, N, 4)``.
    Translations [m] and rotations of the take's joints are ``(F, J, 3)`` and
    ``(F, J, 4)``.
    """
    rig = ragdoll.rig
    body_of_joint = {int(j): i for i, j in enumerate(ragdoll.joints)}
    bodiless_ancestors = {k for j in body_of_joint for k in rig.upwards(j)[1:]}
    bodiless_ancestors -= body_of_joint.keys()
    new_translations, new_rotations = local_translations.copy(), local_rotations.copy()
    root_bodies = np.flatnonzero(ragdoll.parent_bodies < 0).tolist()
    root_joints = {movable_root(rig, int(ragdoll.joints[i])): i for i in root_bodies}
    body_of_joint |= root_joints
    frame_count, joint_count = len(body_origins), len(rig.joints)
    positions = np.zeros((frame_count, joint_count, 3))
    world_rotations = np.zeros((frame_count, joint_count, 4))
    for j, joint in enumerate(rig.joints):
        if j in bodiless_ancestors:
            new_translations[:, j] = local_translations[0, j]
            new_rotations[:, j] = local_rotations[0, j]
        parent = joint.parent
        if j in body_of_joint:
            i = body_of_joint[j]
            body = int(ragdoll.joints[i])
            frame_on_body = _frame_on_body(
                rig, body, j, local_translations[0], local_rotations[0]
            )
            joint_rotations = so3.multiply(body_rotations[:, i], frame_on_body[3:])
            if parent < 0:
                world_to_parent = so3.IDENTITY
            else:
                world_to_parent = so3.conjugate(world_rotations[:, parent])
            new_rotations[:, j] = so3.multiply(world_to_parent, joint_rotations)
            new_translations[:, j] = local_translations[0, j]
            if j in root_joints or joint.type is JointType.PRISMATIC:
                origin = body_origins[:, i] + so3.rotate(
                    body_rotations[:, i], frame_on_body[:3]
                )
                offset = origin - (0 if parent < 0 else positions[:, parent])
                new_translations[:, j] = so3.rotate(world_to_parent, offset)
        if parent < 0:
            positions[:, j] = new_translations[:, j]
            world_rotations[:, j] = new_rotations[:, j]
        else:
            parent_rotations = world_rotations[:, parent]
            offset = so3.rotate(parent_rotations, new_translations[:, j])
            positions[:, j] = positions[:, parent] + offset
            world_rotations[:, j] = so3.multiply(parent_rotations, new_rotations[:, j])
    return new_translations, new_rotations


def _frame_on_body(
    rig: Rig,
    body: int,
    joint: int,
    local_translations: FloatArray,
    local_rotations: FloatArray,
) -> FloatArray:
    """Return the frame of a joint relative to a descendant body ``(7,)``.

    Local transforms are ``(J, 3)`` [m] and ``(J, 4)``.
    """
    position, rotation = np.zeros(3), so3.IDENTITY
    for k in rig.upwards(body):
        if k == joint:
            break
        position = local_translations[k] + so3.rotate(local_rotations[k], position)
        rotation = so3.multiply(local_rotations[k], rotation)
    inverse_rotation = so3.conjugate(rotation)
    return np.concatenate([-so3.rotate(inverse_rotation, position), inverse_rotation])
