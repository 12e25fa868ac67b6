"""Rigs, goals and targets for tests of inverse kinematics."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.ik import Goal, Problem, Targets
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig


def unit(vector: list[float]) -> tuple[float, float, float]:
    x, y, z = np.array(vector) / np.linalg.norm(vector)
    return (float(x), float(y), float(z))


def mixed_rig() -> Rig:
    """Every type of joint, off the main axes, with a branch and a bystander."""
    turned = so3.exp([0.3, -0.4, 0.2])
    return Rig(
        "mixed",
        (
            Joint("root", -1, JointType.FREE, translation=(0.1, 0.9, 0.2)),
            Joint(
                "spine",
                0,
                JointType.BALL,
                translation=(0.0, 0.3, 0.05),
                rotation=tuple(turned),
                limits=BallLimit((0.9, 0.6), (-0.5, 0.7), unit([1.0, 2.0, 0.5])),
            ),
            Joint(
                "elbow",
                1,
                JointType.PIN,
                translation=(0.3, 0.1, 0.0),
                axis=unit([0.2, -1.0, 0.4]),
                limits=RangeLimit(-0.3, 2.2),
            ),
            Joint("plate", 2, JointType.FIXED, translation=(0.1, 0.0, 0.1)),
            Joint(
                "piston",
                3,
                JointType.PRISMATIC,
                translation=(0.1, 0.0, 0.0),
                axis=unit([1.0, 1.0, 0.0]),
                limits=RangeLimit(0.0, 0.2),
            ),
            Joint("hand", 4, JointType.BALL, translation=(0.15, 0.0, 0.0)),
            Joint("other", 1, JointType.PIN, translation=(-0.3, 0.1, 0.0)),
        ),
    )


def arm(links: int = 3, limit: float | None = None) -> Rig:
    """A chain of pins about axes in turn, links of 0.4 m."""
    axes = [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]
    return Rig(
        "arm",
        tuple(
            Joint(
                f"b{i}",
                i - 1,
                JointType.PIN,
                translation=(0.4 if i else 0.0, 0.0, 0.0),
                axis=axes[i % 2],
                limits=None if limit is None else RangeLimit(-limit, limit),
            )
            for i in range(links)
        ),
    )


def limb() -> Rig:
    """A shoulder and an elbow with bones of 0.32 m and 0.27 m."""
    return Rig(
        "limb",
        (
            Joint("shoulder", -1, JointType.BALL, translation=(0.1, 1.2, 0.0)),
            Joint("elbow", 0, JointType.PIN, translation=(0.32, 0.0, 0.0)),
        ),
    )


def random_pose(problem: Problem, seed: int, frames: int = 1) -> FloatArray:
    """Return coordinates within the limits, by small motions from rest."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(frames):
        row: list[float] = []
        for joint in problem.rig.joints:
            match joint.type:
                case JointType.FREE:
                    row += [*rng.uniform(-0.5, 0.5, 3), *so3.exp(rng.uniform(-1, 1, 3))]
                case JointType.BALL:
                    turn = so3.exp(rng.uniform(-0.6, 0.6, 3))[None]
                    if isinstance(joint.limits, BallLimit):
                        turn = joint.limits.clamped(turn)
                    row += turn[0].tolist()
                case JointType.PIN | JointType.PRISMATIC:
                    low, high = -1.5, 1.5
                    if isinstance(joint.limits, RangeLimit):
                        low, high = joint.limits.low, joint.limits.high
                    row.append(rng.uniform(low, high))
        rows.append(row)
    return np.array(rows)


def reached_by(problem: Problem, coordinates: FloatArray) -> Targets:
    """Return targets that poses reach exactly, aims and poles included."""
    rig = problem.rig
    local = local_from_coordinates(rig, coordinates)
    world = forward_kinematics(rig, local.translations, local.rotations)
    positions, rotations, aims, poles = [], [], [], []
    for goal in problem.goals:
        j = rig.index(goal.joint)
        linear = world.linear[:, j]
        point = world.positions[:, j] + linear @ np.asarray(goal.offset)
        positions.append(point)
        rotations.append(so3.from_matrix(linear))
        aims.append(point + 0.7 * (linear @ np.asarray(goal.aim_axis)))
        poles.append(world.positions[:, max(rig.joints[j].parent, 0)])
    return Targets(*(np.stack(part, 1) for part in (positions, rotations, aims, poles)))


def every_goal() -> list[Goal]:
    """Goals that use every kind of target on the mixed rig."""
    axis = unit([0.1, 0.3, 1.0])
    return [
        Goal("hand", (0.1, 0.02, 0.0), position=1.5, orientation=0.7),
        Goal("other", (0.0, 0.2, 0.0), position=0.8, aim=0.9, aim_axis=axis),
        Goal("piston", (0.05, 0.0, 0.0), position=0.0, pole=0.6),
    ]


def beyond_limits(problem: Problem, coordinates: FloatArray) -> float:
    """Return how far coordinates ``(F, Q)`` are outside of limits at most [rad, m]."""
    worst = 0.0
    rig = problem.rig
    for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True):
        own = coordinates[:, place]
        if isinstance(joint.limits, RangeLimit):
            worst = max(worst, float(np.abs(joint.limits.excess(own[:, 0])).max()))
        elif isinstance(joint.limits, BallLimit):
            worst = max(worst, float(joint.limits.excess(own).max()))
    return worst
