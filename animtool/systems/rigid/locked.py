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
NONE = 1e-6
# Smaller singular values, over the largest, count as 0.
RANK = 1e-9
# Largest number of bodies in a loop that is analysed.
MOST = 64
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
class Locked:
    """A joint that cannot move.

    Attributes:
        joint_index: Its number.
        by: Of the joints without any one of which it could; empty where several hold.
        left: How much of its motion is left, of 1.
    """

    joint_index: int
    by: tuple[int, ...]
    left: float


def locked_joints(
    rows: IntArray, frames: FloatArray, centres: FloatArray
) -> list[Locked]:
    """Return joints of closed loops that cannot move from their start.

    Args:
        rows: Kind and both bodies of K joints ``(K, 3)``; -1 is what does not move.
        frames: Of each the first frame in the world ``(K, 7)`` [m].
        centres: Of N bodies ``(N, 3)`` [m].
    """
    locked = []
    for loop in _loops(rows, len(centres)):
        loop_bodies = np.setdiff1d(rows[loop, 1:], [-1])
        loop_rows, count = rows[loop], len(loop_bodies)
        numbers = np.searchsorted(loop_bodies, loop_rows[:, 1:])
        loop_rows[:, 1:] = np.where(loop_rows[:, 1:] < 0, -1, numbers)
        around = centres[loop_bodies]
        size = float(np.ptp(np.concatenate([around, frames[loop, :3]]), axis=0).max())
        ones = [
            _equations(row, frames[k], around, size or 1.0)
            for row, k in zip(loop_rows, loop, strict=True)
        ]
        free = _null_space([constraints for constraints, _ in ones], count)
        for k, (_, motions) in zip(loop, ones, strict=True):
            left = _left(motions, free)
            if not len(motions) or left > NONE:
                continue
            by = []
            for i, other in enumerate(loop):
                if other != k:
                    rest = [
                        constraints for j, (constraints, _) in enumerate(ones) if j != i
                    ]
                    if _left(motions, _null_space(rest, count)) > NONE:
                        by.append(other)
            locked.append(Locked(k, tuple(by), left))
    return locked


def locked_notices(
    rows: IntArray, numbers: FloatArray, names: Sequence[str], bodies: RigidBodies
) -> list[Fault]:
    """Return a warning for each locked joint (SIM172)."""
    start = bodies.start
    frames = np.array([_frame(start[row[2]], entry[7:14]) for row, entry in zip(
        rows.tolist(), numbers, strict=True)]).reshape(-1, 7)  # fmt: skip
    notices = []
    for one in locked_joints(rows, frames, start[:, :3]):
        name = excerpt(names[one.joint_index])
        message = f"joint {name} cannot move: {one.left:.1g} of its motion is left by "
        if one.by:
            message += "joint" + "s" * (len(one.by) > 1) + " "
            message += ", ".join(excerpt(names[k]) for k in one.by[:3])
            if len(one.by) > 3:
                message += f" and {counted(len(one.by) - 3, 'more', 'more')}"
        else:
            message += "several other joints"
        hint = "align their axes, or remove one of them"
        notices.append(warning("SIM172", message, hint))
    return notices


def _frame(body: FloatArray, local: FloatArray) -> FloatArray:
    """Return a local frame of a body in the world ``(7,)``."""
    at = body[:3] + so3.rotate(body[3:7], local[:3])
    return np.concatenate([at, so3.multiply(body[3:7], local[3:])])


def _loops(rows: IntArray, count: int) -> list[list[int]]:
    """Return joints of each closed loop, without dangling branches."""
    ends = [(row[1] if row[1] >= 0 else count, row[2]) for row in rows.tolist()]
    left = set(range(len(ends)))
    while True:
        degree = np.bincount([i for k in left for i in ends[k]], minlength=count + 1)
        open_ends = {
            k for k in left if any(degree[i] == 1 and i < count for i in ends[k])
        }
        if not open_ends:
            break
        left -= open_ends
    groups: list[tuple[set[int], list[int]]] = []
    for k in sorted(left):
        # A body that never moves connects nothing.
        members, joints = {i for i in ends[k] if i < count}, [k]
        for group in [one for one in groups if one[0] & members]:
            groups.remove(group)
            members |= group[0]
            joints = group[1] + joints
        groups.append((members, sorted(joints)))
    return [
        joints for members, joints in groups if len(joints) > 1 and len(members) <= MOST
    ]


def _equations(
    row: IntArray, frame: FloatArray, centres: FloatArray, size: float
) -> tuple[list[tuple[int, int, FloatArray]], list[tuple[int, int, FloatArray]]]:
    """Return a joint's constraint rows, and its free directions.

    Each as both bodies, and factors on the velocity and, over a size, the spin of the
    second at its centre and of the first at its own ``(2, 6)``.
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


def _matrix(lines: Sequence[tuple[int, int, FloatArray]], count: int) -> FloatArray:
    matrix = np.zeros((len(lines), 6 * count))
    for k, (second, first, factors) in enumerate(lines):
        matrix[k, 6 * second : 6 * second + 6] = factors[0]
        if first >= 0:
            matrix[k, 6 * first : 6 * first + 6] = factors[1]
    return matrix


def _null_space(
    several: Sequence[Sequence[tuple[int, int, FloatArray]]], count: int
) -> FloatArray:
    """Return the velocities that satisfy all constraints ``(6N, …)``."""
    lines = [one for joint_lines in several for one in joint_lines]
    if not lines:
        return np.eye(6 * count)
    _, sizes, turned = np.linalg.svd(_matrix(lines, count))
    rank = int((sizes > RANK * sizes[0]).sum())
    return np.asarray(turned[rank:].T)


def _left(motions: Sequence[tuple[int, int, FloatArray]], free: FloatArray) -> float:
    """Return the largest relative motion that a joint retains."""
    count = len(free) // 6
    return float(
        np.linalg.norm(_matrix(motions, count) @ free, axis=1).max(initial=0.0)
    )
