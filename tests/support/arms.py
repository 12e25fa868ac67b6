"""Arms of six pins, and where they are to fifty digits."""

from __future__ import annotations

import mpmath
import numpy as np

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# Axes and offsets of each pin from the one before it.
ARMS = {
    "parallel": [
        *((Z, (0.0, 0.0, 0.089)), (Y, (0.0, 0.136, 0.0)), (Y, (0.425, -0.12, 0.0))),
        *((Y, (0.392, 0.0, 0.0)), (Z, (0.0, 0.093, 0.0)), (Y, (0.0, 0.0, 0.095))),
    ],
    "wrist": [
        *((Z, (0.0, 0.0, 0.4)), (Y, (0.15, 0.02, 0.0)), (Y, (0.0, 0.03, 0.6))),
        *((X, (0.1, 0.0, 0.12)), (Y, (0.5, 0.0, 0.0)), (X, (0.0, 0.0, 0.0))),
    ],
    "shoulder": [
        *((Z, (0.0, 0.0, 0.3)), (Y, (0.0, 0.0, 0.0)), (X, (0.3, 0.1, 0.05))),
        *((Z, (0.2, 0.15, 0.3)), (Y, (0.0, 0.0, 0.1)), (Z, (0.0, 0.0, 0.0))),
    ],
    "elbow": [
        *((Z, (0.0, 0.0, 0.3)), (X, (0.1, 0.2, 0.1)), (Y, (0.1, 0.0, 0.0))),
        *((Z, (0.1, 0.0, 0.3)), (Y, (0.0, 0.0, 0.0)), (X, (0.0, 0.0, 0.0))),
    ],
    "scara": [
        *((Z, (0.0, 0.0, 0.3)), (Z, (0.4, 0.0, 0.1)), (Y, (0.3, 0.0, 0.1))),
        *((Z, (0.05, 0.02, 0.25)), (Y, (0.0, 0.0, 0.0)), (Z, (0.0, 0.0, 0.0))),
    ],
}
TOOL = (0.02, 0.05, 0.08)


def arm(name: str, limit: float | None = None) -> Rig:
    """Return one of them on a base that is turned, with a hand at its end."""
    base = tuple(so3.exp([0.4, -0.3, 0.8]).tolist())
    limits = None if limit is None else RangeLimit(-limit, limit)
    pins = [
        Joint(
            f"j{i}", i - 1, JointType.PIN, at, base if i == 0 else (0, 0, 0, 1), axis,
            limits=limits,
        )
        for i, (axis, at) in enumerate(ARMS[name])
    ]  # fmt: skip
    turn = tuple(so3.exp([0.1, 0.5, -0.2]).tolist())
    return Rig(name, (*pins, Joint("hand", 5, JointType.FIXED, TOOL, turn)))


def exact_place(rig: Rig, pose: FloatArray) -> tuple[mpmath.matrix, mpmath.matrix]:
    """Return rotation and position of the last joint, to fifty digits."""
    turn, place = mpmath.eye(3), mpmath.zeros(3, 1)
    for i, joint in enumerate(rig.joints):
        place += turn * mpmath.matrix(joint.translation)
        turn *= _turn(joint.rotation)
        if joint.type is JointType.PIN:
            half = mpmath.mpf(float(pose[i])) / 2
            axis = [mpmath.sin(half) * a for a in joint.axis]
            turn *= _turn([*axis, mpmath.cos(half)])
    return turn, place


def _turn(quaternion: object) -> mpmath.matrix:
    x, y, z, w = (mpmath.mpf(q) for q in quaternion)  # type: ignore[attr-defined]
    cross = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    size = x * x + y * y + z * z + w * w
    return mpmath.eye(3) + 2 * (w * cross + cross * cross) / size


def exact_miss(
    rig: Rig, pose: FloatArray, target: tuple[FloatArray, FloatArray]
) -> float:
    """Return how far the last joint is from a position or rotation [m], [rad]."""
    with mpmath.workdps(50):
        turn, place = exact_place(rig, pose)
        away = place - mpmath.matrix(target[0].tolist())
        rest = turn.T * _turn(target[1].tolist())
        sine = mpmath.norm(
            mpmath.matrix(
                [
                    rest[2, 1] - rest[1, 2],
                    rest[0, 2] - rest[2, 0],
                    rest[1, 0] - rest[0, 1],
                ]
            )
        )
        angle = mpmath.atan2(sine, rest[0, 0] + rest[1, 1] + rest[2, 2] - 1)
        return float(max(mpmath.norm(away), angle))


def place_of(rig: Rig, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and quaternion of the last joint, rounded once."""
    with mpmath.workdps(50):
        turn, place = exact_place(rig, pose)
        position = np.array([float(value) for value in place])
        trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
        values = [turn[0, 0], turn[1, 1], turn[2, 2], trace]
        i = max(range(4), key=lambda k: values[k])
        if i == 3:
            parts = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0]]
            parts += [turn[1, 0] - turn[0, 1], 1 + trace]
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            parts = [mpmath.mpf(0)] * 4
            parts[i] = 1 + turn[i, i] - turn[j, j] - turn[k, k]
            parts[j] = turn[i, j] + turn[j, i]
            parts[k] = turn[i, k] + turn[k, i]
            parts[3] = turn[k, j] - turn[j, k]
        size = mpmath.norm(mpmath.matrix(parts))
        return position, np.array([float(part / size) for part in parts])
