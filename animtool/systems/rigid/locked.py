"""Joints that other joints prevent from moving.

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

# Joints with less motion, over the possible motion, are locked.
LOCKED_MOTION = 1e-6
# Smaller singular values, over the largest, count as 0.
RANK_TOLERANCE = 1e-9
# Largest number of bodies in a loop that is analysed.
MAX_LOOP_BODIES = 64
# Constrained translations and rotations of a joint in its first frame, by type; the
# other axes are free.
_LOCKED_TRANSLATIONS = {0: (0, 1, 2), 1: (0, 1, 2), 2: (0, 1, 2), 3: (1, 2)}
_LOCKED_ROTATIONS: dict[int, tuple[int, ...]] = {
    0: (0, 1, 2),
    1: (1, 2),
    2: (),
    3: (0, 1, 2),
}


@dataclass(frozen=True, slots=True)
class LockedJoint:
    """A joint that cannot move.

    Attributes:
        joint_index: Index of the joint.
        by: Joints that would each unlock it if removed; empty if several lock it.
        left: Remaining fraction of its motion.
    """

    joint_index: int
    by: tuple[int, ...]
    left: float


def locked_joints(
    rows: IntArray, frames: FloatArray, centres: FloatArray
) -> list[LockedJoint]:
    """Return joints of closed loops that cannot move from their start.

    Args:
        rows: Kind and both bodies of K joints ``(K, 3)``; -1 is static.
        frames: World frame of each joint on its first body ``(K, 7)`` [m].
        centres: Centres of N bodies ``(N, 3)`` [m].
    """
    locked = []
    for loop in _closed_loops(rows, len(centres)):
        loop_bodies = np.setdiff1d(rows[loop, 1:], [-1])
        loop_rows, count = rows[loop], len(loop_bodies)
        body_indices = np.searchsorted(loop_bodies, loop_rows[:, 1:])
        loop_rows[:, 1:] = np.where(loop_rows[:, 1:] < 0, -1, body_indices)
        body_centres = centres[loop_bodies]
        size = float(
            np.ptp(np.concatenate([body_centres, frames[loop, :3]]), axis=0).max()
        )
        equations = [
            _constraint_rows(row, frames[k], body_centres, size or 1.0)
            for row, k in zip(loop_rows, loop, strict=True)
        ]
        free = _null_space([constraints for constraints, _ in equations], count)
        for k, (_, motions) in zip(loop, equations, strict=True):
            remaining = _remaining_motion(motions, free)
            if not len(motions) or remaining > LOCKED_MOTION:
                continue
            blocking = []
            for i, other_joint in enumerate(loop):
                if other_joint != k:
                    other_constraints = [
                        constraints
                        for j, (constraints, _) in enumerate(equations)
                        if j != i
                    ]
                    if (
                        _remaining_motion(
                            motions, _null_space(other_constraints, count)
                        )
                        > LOCKED_MOTION
                    ):
                        blocking.append(other_joint)
            locked.append(LockedJoint(k, tuple(blocking), remaining))
    return locked


def locked_notices(
    rows: IntArray, numbers: FloatArray, names: Sequence[str], bodies: RigidBodies
) -> list[Fault]:
    """Return a warning for each locked joint (SIM172)."""
    start = bodies.start
    frames = np.array(
        [
            _world_frame(start[row[2]], parameters[7:14])
            for row, parameters in zip(rows.tolist(), numbers, strict=True)
        ]
    ).reshape(-1, 7)
    notices = []
    for locked in locked_joints(rows, frames, start[:, :3]):
        name = excerpt(names[locked.joint_index])
        message = (
            f"joint {name} cannot move: {locked.left:.1g} of its motion is left by "
        )
        if locked.by:
            message += "joint" + "s" * (len(locked.by) > 1) + " "
            message += ", ".join(excerpt(names[k]) for k in locked.by[:3])
            if len(locked.by) > 3:
                message += f" and {counted(len(locked.by) - 3, 'more', 'more')}"
        else:
            message += "several other joints"
        hint = "align their axes, or remove one of them"
        notices.append(warning("SIM172", message, hint))
    return notices


def _world_frame(body: FloatArray, local: FloatArray) -> FloatArray:
    """Return a local frame of a body in the world ``(7,)``."""
    origin = body[:3] + so3.rotate(body[3:7], local[:3])
    return np.concatenate([origin, so3.multiply(body[3:7], local[3:])])


def _closed_loops(rows: IntArray, count: int) -> list[list[int]]:
    """Return joints of each closed loop, without dangling branches."""
    ends = [(row[1] if row[1] >= 0 else count, row[2]) for row in rows.tolist()]
    remaining_joints = set(range(len(ends)))
    while True:
        degree = np.bincount(
            [i for k in remaining_joints for i in ends[k]], minlength=count + 1
        )
        dangling = {
            k
            for k in remaining_joints
            if any(degree[i] == 1 and i < count for i in ends[k])
        }
        if not dangling:
            break
        remaining_joints -= dangling
    groups: list[tuple[set[int], list[int]]] = []
    for k in sorted(remaining_joints):
        # Static bodies connect no loops.
        members, joints = {i for i in ends[k] if i < count}, [k]
        for group in [candidate for candidate in groups if candidate[0] & members]:
            groups.remove(group)
            members |= group[0]
            joints = group[1] + joints
        groups.append((members, sorted(joints)))
    return [
        joints
        for members, joints in groups
        if len(joints) > 1 and len(members) <= MAX_LOOP_BODIES
    ]


def _constraint_rows(
    row: IntArray, frame: FloatArray, centres: FloatArray, size: float
) -> tuple[list[tuple[int, int, FloatArray]], list[tuple[int, int, FloatArray]]]:
    """Return a joint's constraint rows, and its free directions.

    Each row has both bodies, and factors ``(2, 6)`` on velocity and scaled spin at the
    centre of the second and of the first.
    """
    kind, first, second = row.tolist()
    axes = so3.to_matrix(frame[3:]).T

    def line(axis: FloatArray, rotates: bool) -> tuple[int, int, FloatArray]:
        factors = np.zeros((2, 6))
        for k, (body, sign) in enumerate(((second, 1.0), (first, -1.0))):
            if body < 0:
                continue
            if rotates:
                factors[k, 3:] = sign * axis
            else:
                arm = (frame[:3] - centres[body]) / size
                factors[k, :3], factors[k, 3:] = sign * axis, sign * np.cross(arm, axis)
        return second, first, factors

    constraints = [line(axes[i], False) for i in _LOCKED_TRANSLATIONS[kind]]
    constraints += [line(axes[i], True) for i in _LOCKED_ROTATIONS[kind]]
    motions = [
        line(axes[i], False) for i in range(3) if i not in _LOCKED_TRANSLATIONS[kind]
    ]
    motions += [
        line(axes[i], True) for i in range(3) if i not in _LOCKED_ROTATIONS[kind]
    ]
    return constraints, motions


def _constraint_matrix(
    lines: Sequence[tuple[int, int, FloatArray]], count: int
) -> FloatArray:
    matrix = np.zeros((len(lines), 6 * count))
    for k, (second, first, factors) in enumerate(lines):
        matrix[k, 6 * second : 6 * second + 6] = factors[0]
        if first >= 0:
            matrix[k, 6 * first : 6 * first + 6] = factors[1]
    return matrix


def _null_space(
    joint_constraints: Sequence[Sequence[tuple[int, int, FloatArray]]], count: int
) -> FloatArray:
    """Return the velocities that satisfy all constraints ``(6N, …)``."""
    lines = [line for joint_lines in joint_constraints for line in joint_lines]
    if not lines:
        return np.eye(6 * count)
    _, singular_values, right_vectors = np.linalg.svd(_constraint_matrix(lines, count))
    rank = int((singular_values > RANK_TOLERANCE * singular_values[0]).sum())
    return np.asarray(right_vectors[rank:].T)


def _remaining_motion(
    motions: Sequence[tuple[int, int, FloatArray]], free: FloatArray
) -> float:
    """Return the largest relative motion that a joint retains."""
    count = len(free) // 6
    return float(
        np.linalg.norm(_constraint_matrix(motions, count) @ free, axis=1).max(
            initial=0.0
        )
    )
