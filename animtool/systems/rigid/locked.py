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
from animtool.systems.rigid.joints import to_parent_frame

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
    rows: IntArray, frames: FloatArray, centres: FloatArray
) -> list[LockedJoint]:
    """Return the joints of closed loops that cannot move at the start.

    Args:
        rows: Kind and both bodies of K joints ``(K, 3)``; -1 is static.
        frames: World frame of each joint on its first body ``(K, 7)`` [m].
        centres: Centres of N bodies ``(N, 3)`` [m].
    """
    locked_list = []
    for loop in _closed_loops(rows, len(centres)):
        loop_bodies = np.setdiff1d(rows[loop, 1:], [-1])
        loop_rows, body_count = rows[loop], len(loop_bodies)
        body_indices = np.searchsorted(loop_bodies, loop_rows[:, 1:])
        loop_rows[:, 1:] = np.where(loop_rows[:, 1:] < 0, -1, body_indices)
        body_centres = centres[loop_bodies]
        points = np.concatenate([body_centres, frames[loop, :3]])
        loop_size = float(np.ptp(points, axis=0).max()) or 1.0
        rows_by_joint = [
            _constraint_rows(row, frames[k], body_centres, loop_size)
            for row, k in zip(loop_rows, loop, strict=True)
        ]
        constraints = [constrained for constrained, _ in rows_by_joint]
        null_space = _null_space(constraints, body_count)
        for k, (_, free_rows) in zip(loop, rows_by_joint, strict=True):
            remaining_motion = _remaining_motion(free_rows, null_space)
            if not len(free_rows) or remaining_motion > LOCKED_MOTION:
                continue
            blocking_joints = []
            for i, other_joint in enumerate(loop):
                if other_joint == k:
                    continue
                others = constraints[:i] + constraints[i + 1 :]
                null_space_without = _null_space(others, body_count)
                if _remaining_motion(free_rows, null_space_without) > LOCKED_MOTION:
                    blocking_joints.append(other_joint)
            locked_list.append(LockedJoint(k, tuple(blocking_joints), remaining_motion))
    return locked_list


def locked_notices(
    rows: IntArray, numbers: FloatArray, names: Sequence[str], bodies: RigidBodies
) -> list[Fault]:
    """Return a warning for each locked joint (SIM172)."""
    start = bodies.initial_states
    joint_frames = [
        to_parent_frame(start[row[2], :7], parameters[7:14])
        for row, parameters in zip(rows.tolist(), numbers, strict=True)
    ]
    frames = np.array(joint_frames).reshape(-1, 7)
    notices = []
    for locked in locked_joints(rows, frames, start[:, :3]):
        name = excerpt(names[locked.joint_index])
        message = f"joint {name} cannot move: {locked.remaining_motion:.1g} of its "
        message += "motion is left by "
        if locked.blocking_joints:
            message += "joint" + "s" * (len(locked.blocking_joints) > 1) + " "
            message += ", ".join(excerpt(names[k]) for k in locked.blocking_joints[:3])
            other_count = len(locked.blocking_joints) - 3
            if other_count > 0:
                message += f" and {counted(other_count, 'more', 'more')}"
        else:
            message += "several other joints"
        hint = "align their axes, or remove one of them"
        notices.append(warning("SIM172", message, hint))
    return notices


def _closed_loops(rows: IntArray, body_count: int) -> list[list[int]]:
    """Return the joint indices of each closed loop, without dangling branches."""
    joint_bodies = [
        (row[1] if row[1] >= 0 else body_count, row[2]) for row in rows.tolist()
    ]
    remaining_joints = set(range(len(joint_bodies)))
    while True:
        ends = [i for k in remaining_joints for i in joint_bodies[k]]
        joint_counts = np.bincount(ends, minlength=body_count + 1)
        dangling_joints = {
            k
            for k in remaining_joints
            if any(joint_counts[i] == 1 and i < body_count for i in joint_bodies[k])
        }
        if not dangling_joints:
            break
        remaining_joints -= dangling_joints
    groups: list[tuple[set[int], list[int]]] = []
    for k in sorted(remaining_joints):
        # Static bodies connect no loops.
        group_bodies, joints = {i for i in joint_bodies[k] if i < body_count}, [k]
        for group in [candidate for candidate in groups if candidate[0] & group_bodies]:
            groups.remove(group)
            group_bodies |= group[0]
            joints = group[1] + joints
        groups.append((group_bodies, sorted(joints)))
    return [
        joints
        for group_bodies, joints in groups
        if len(joints) > 1 and len(group_bodies) <= MAX_LOOP_BODIES
    ]


def _constraint_rows(
    row: IntArray, frame: FloatArray, centres: FloatArray, size: float
) -> tuple[list[tuple[int, int, FloatArray]], list[tuple[int, int, FloatArray]]]:
    """Return Jacobian rows of the constrained and of the free directions of a joint.

    Each row has the second and the first body, and factors ``(2, 6)`` on their velocity
    and scaled spin.
    """
    kind, first, second = row.tolist()
    axes = so3.to_matrix(frame[3:]).T

    def build_row(axis: FloatArray, is_rotation: bool) -> tuple[int, int, FloatArray]:
        factors = np.zeros((2, 6))
        for k, (body, sign) in enumerate(((second, 1.0), (first, -1.0))):
            if body < 0:
                continue
            if is_rotation:
                factors[k, 3:] = sign * axis
            else:
                lever_arm = (frame[:3] - centres[body]) / size
                factors[k, :3] = sign * axis
                factors[k, 3:] = sign * np.cross(lever_arm, axis)
        return second, first, factors

    constraints = [build_row(axes[i], False) for i in _LOCKED_TRANSLATIONS[kind]]
    constraints += [build_row(axes[i], True) for i in _LOCKED_ROTATIONS[kind]]
    free_translations = sorted({0, 1, 2} - {*_LOCKED_TRANSLATIONS[kind]})
    free_rotations = sorted({0, 1, 2} - {*_LOCKED_ROTATIONS[kind]})
    free_rows = [build_row(axes[i], False) for i in free_translations]
    free_rows += [build_row(axes[i], True) for i in free_rotations]
    return constraints, free_rows


def _constraint_matrix(
    rows: Sequence[tuple[int, int, FloatArray]], body_count: int
) -> FloatArray:
    """Return constraint rows as a matrix ``(R, 6 N)``."""
    matrix = np.zeros((len(rows), 6 * body_count))
    for k, (second, first, factors) in enumerate(rows):
        matrix[k, 6 * second : 6 * second + 6] = factors[0]
        if first >= 0:
            matrix[k, 6 * first : 6 * first + 6] = factors[1]
    return matrix


def _null_space(
    joint_constraints: Sequence[Sequence[tuple[int, int, FloatArray]]], body_count: int
) -> FloatArray:
    """Return a basis of the velocities that satisfy all constraints ``(6 N, …)``."""
    rows = [row for joint_rows in joint_constraints for row in joint_rows]
    if not rows:
        return np.eye(6 * body_count)
    matrix = _constraint_matrix(rows, body_count)
    _, singular_values, right_vectors = np.linalg.svd(matrix)
    rank = int((singular_values > RANK_TOLERANCE * singular_values[0]).sum())
    return np.asarray(right_vectors[rank:].T)


def _remaining_motion(
    free_rows: Sequence[tuple[int, int, FloatArray]], null_space: FloatArray
) -> float:
    """Return the largest relative motion of a joint within the null space."""
    body_count = len(null_space) // 6
    motions = _constraint_matrix(free_rows, body_count) @ null_space
    return float(np.linalg.norm(motions, axis=1).max(initial=0.0))
