"""Detection of joints that other joints prevent from moving.

Joint constraints are velocities that must be 0; the possible motion is their null
space. A joint without relative motion in it cannot move, however strong its drive: two
slides of one body in different directions, a pin across another.

References:
    J. Angeles, "Fundamentals of Robotic Mechanical Systems", 2014, section 9.2:
    mobility as the nullity of the Jacobian of a loop's constraints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, excerpt, warning
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.joints import Joints, to_parent_frame

# Joints with a smaller fraction of their motion left are locked [1].
LOCKED_MOTION = 1e-6
# Singular values below this fraction of the largest count as 0.
RANK_TOLERANCE = 1e-9
# Largest number of bodies in a loop that is analysed.
MAX_LOOP_BODIES = 64
# Constrained translations and rotations of a joint in its first frame, by type; the
# other axes are free.
_LOCKED_TRANSLATIONS = {0: (0, 1, 2), 1: (0, 1, 2), 2: (0, 1, 2), 3: (1, 2)}
_LOCKED_ROTATIONS = {0: (0, 1, 2), 1: (1, 2), 2: (), 3: (0, 1, 2)}


@dataclass(frozen=True, slots=True)
class LockedJoint:
    """A joint that other joints prevent from moving."""

    joint_index: int  # index of the joint
    # Joints that would each unlock it if removed; empty if several joints together lock
    # it.
    blocking_joints: tuple[int, ...]
    remaining_motion: float  # fraction of its motion that remains [1]


def locked_joints(
    kinds_and_bodies: IntArray, frames: FloatArray, centres: FloatArray
) -> list[LockedJoint]:
    """Return the joints of closed loops that cannot move at the start.

    Joints have a kind and two bodies ``(K, 3)``, -1 for static ones, and world frames
    on their first body ``(K, 7)`` [m]; centres of bodies are ``(N, 3)`` [m].
    """
    blocked_joints = []
    for loop in _closed_loops(kinds_and_bodies, len(centres)):
        loop_joints = kinds_and_bodies[loop]
        loop_bodies = np.setdiff1d(loop_joints[:, 1:], [-1])
        body_indices = np.searchsorted(loop_bodies, loop_joints[:, 1:])
        loop_joints[:, 1:] = np.where(loop_joints[:, 1:] < 0, -1, body_indices)
        body_centres = centres[loop_bodies]
        points = np.concatenate([body_centres, frames[loop, :3]])
        loop_size = float(np.ptp(points, axis=0).max()) or 1.0
        jacobians = [
            _joint_jacobians(joint, frames[k], body_centres, loop_size)
            for joint, k in zip(loop_joints, loop, strict=True)
        ]
        constraint_jacobians = [constrained for constrained, _ in jacobians]
        null_space = _null_space(constraint_jacobians)
        for k, (_, free) in zip(loop, jacobians, strict=True):
            remaining_motion = _remaining_motion(free, null_space)
            if not len(free) or remaining_motion > LOCKED_MOTION:
                continue
            blocking_joints = []
            for i, other_joint in enumerate(loop):
                if other_joint == k:
                    continue
                null_space_without = _null_space(
                    constraint_jacobians[:i] + constraint_jacobians[i + 1 :]
                )
                if _remaining_motion(free, null_space_without) > LOCKED_MOTION:
                    blocking_joints.append(other_joint)
            blocked_joints.append(
                LockedJoint(k, tuple(blocking_joints), remaining_motion)
            )
    return blocked_joints


def locked_notices(joints: Joints, bodies: RigidBodies) -> list[Fault]:
    """Return a warning for each locked joint (SIM172)."""
    states = bodies.initial_states
    joint_frames = [
        to_parent_frame(states[joint.bodies[1], :7], parameters[7:14])
        for joint, parameters in zip(joints.members, joints.parameters, strict=True)
    ]
    frames = np.array(joint_frames).reshape(-1, 7)
    names = [joint.name for joint in joints.members]
    notices = []
    for locked_joint in locked_joints(joints.kinds_and_bodies, frames, states[:, :3]):
        name = excerpt(names[locked_joint.joint_index])
        message = (
            f"joint {name} cannot move: {locked_joint.remaining_motion:.1g} of its "
        )
        message += "motion is left by "
        if locked_joint.blocking_joints:
            message += "joint" + "s" * (len(locked_joint.blocking_joints) > 1) + " "
            message += ", ".join(
                excerpt(names[k]) for k in locked_joint.blocking_joints[:3]
            )
            other_count = len(locked_joint.blocking_joints) - 3
            if other_count > 0:
                message += f" and {counted(other_count, 'more', 'more')}"
        else:
            message += "several other joints"
        hint = "align their axes, or remove one of them"
        notices.append(warning("SIM172", message, hint))
    return notices


def _closed_loops(kinds_and_bodies: IntArray, body_count: int) -> list[list[int]]:
    """Return the joint indices of each closed loop, without dangling branches."""
    joint_bodies = [
        (first if first >= 0 else body_count, second)
        for _, first, second in kinds_and_bodies.tolist()
    ]
    remaining_joints = set(range(len(joint_bodies)))
    while True:
        joint_ends = [i for k in remaining_joints for i in joint_bodies[k]]
        joint_counts = np.bincount(joint_ends, minlength=body_count + 1)
        dangling_joints = {
            k
            for k in remaining_joints
            if any(joint_counts[i] == 1 and i < body_count for i in joint_bodies[k])
        }
        if not dangling_joints:
            break
        remaining_joints -= dangling_joints
    loop_groups: list[tuple[set[int], list[int]]] = []
    for k in sorted(remaining_joints):
        # Static bodies connect no loops.
        group_bodies, joints = {i for i in joint_bodies[k] if i < body_count}, [k]
        for group in [
            candidate for candidate in loop_groups if candidate[0] & group_bodies
        ]:
            loop_groups.remove(group)
            group_bodies |= group[0]
            joints = group[1] + joints
        loop_groups.append((group_bodies, sorted(joints)))
    return [
        joints
        for group_bodies, joints in loop_groups
        if len(joints) > 1 and len(group_bodies) <= MAX_LOOP_BODIES
    ]


def _joint_jacobians(
    joint: IntArray, joint_frame: FloatArray, centres: FloatArray, loop_size: float
) -> tuple[FloatArray, FloatArray]:
    """Return Jacobians of the constrained and of the free directions of a joint.

    They map the velocity and scaled spin of each body to relative velocities along
    these directions ``(R, 6 N)``.
    """
    kind, first_body, second_body = joint.tolist()
    axes = so3.to_matrix(joint_frame[3:]).T
    # Translations along all axes, then rotations about them.
    jacobian: FloatArray = np.zeros((6, len(centres), 6))
    for body, sign in ((second_body, 1.0), (first_body, -1.0)):
        if body >= 0:
            lever_arm = (joint_frame[:3] - centres[body]) / loop_size
            jacobian[:3, body, :3] = jacobian[3:, body, 3:] = sign * axes
            jacobian[:3, body, 3:] = sign * np.cross(lever_arm, axes)
    rows = [*_LOCKED_TRANSLATIONS[kind], *(3 + i for i in _LOCKED_ROTATIONS[kind])]
    jacobian = jacobian.reshape(6, -1)
    return jacobian[rows], np.delete(jacobian, rows, axis=0)


def _null_space(constraints: Sequence[FloatArray]) -> FloatArray:
    """Return a basis of the velocities that satisfy all constraints ``(6 N, …)``."""
    matrix = np.concatenate(constraints)
    if not len(matrix):
        return np.eye(matrix.shape[1])
    _, singular_values, right_vectors = np.linalg.svd(matrix)
    rank = int((singular_values > RANK_TOLERANCE * singular_values[0]).sum())
    return np.asarray(right_vectors[rank:].T)


def _remaining_motion(free_jacobian: FloatArray, null_space: FloatArray) -> float:
    """Return the largest relative motion of a joint within the null space."""
    return float(np.linalg.norm(free_jacobian @ null_space, axis=1).max(initial=0.0))
