"""Inverse kinematics on limits: long chains with tight ones, and paths beside them.

Chains of 1,000 joints that turn .02 rad each, towards targets in and out of reach.
Paths of an arm that lean on limits of one joint and of two, smoothed, beside the best
that SLSQP finds for the same sum of distances and accelerations.
"""

from __future__ import annotations

import sys

import numpy as np
from clock import Taken, timed
from figures import Bound, Clock, Row
from measuring import begin, on_one_thread, parser
from scipy.optimize import minimize

from animtool import ik
from animtool.core.array_types import FloatArray
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

LINKS, TIGHT = 1000, 0.02
TARGETS = (
    *((-1.9, 0.6, 0.1), (-0.3, -2.9, 0.2), (0.1, 0.2, -2.9), (0.5, 0.4, 0.0)),
    *((-0.2, 0.3, 0.1), (2.5, 1.5, 0.0)),
)
FRAMES, FPS, SECONDS = 28, 24.0, 0.15
BONES = np.array([0.4, 0.35, 0.3, 0.2])


def snake(kind: JointType) -> Rig:
    """Return a chain of 1 m; axes of pins alternate."""
    joints = []
    for i in range(LINKS):
        place = (1 / LINKS if i else 0.0, 0.0, 0.0)
        if kind is JointType.BALL:
            limits = BallLimit((TIGHT, TIGHT), (-TIGHT, TIGHT))
            joints.append(Joint(f"j{i}", i - 1, kind, place, limits=limits))
        else:
            axis = (0.0, 0.0, 1.0) if i % 2 else (0.0, 1.0, 0.0)
            limit = RangeLimit(-TIGHT, TIGHT)
            joints.append(Joint(f"j{i}", i - 1, kind, place, axis=axis, limits=limit))
    return Rig("snake", tuple(joints))


def snake_rows(kind: JointType, runs: int) -> list[Row]:
    """Return what a chain takes for all targets."""
    goal = ik.Goal(f"j{LINKS - 1}", offset=(1 / LINKS, 0.0, 0.0))
    problem = ik.build(snake(kind), [goal])
    taken: list[list[Taken]] = [[] for _ in TARGETS]
    for _ in range(runs):
        for each, place in zip(taken, TARGETS, strict=True):
            targets = ik.Targets(positions=[[place]])
            each.append(timed(lambda t=targets: ik.solve(problem, None, t)))
    least = [min(one.cpu for one in each) for each in taken]
    section = f"{LINKS} joints of {TIGHT} rad"
    most = Bound(at_least=False, bound=1.0)
    share = [float(np.percentile(least, 95))]
    return [
        Row(section, kind.value, "CPU, 95 % [s]", share, most, Clock.CPU),
        Row(section, kind.value, "CPU [s]", least, None, Clock.CPU),
    ]


def points(angles: FloatArray) -> FloatArray:
    """Return the ends of the arm ``(F, 2)`` of angles ``(F, 4)``."""
    total = np.cumsum(angles, axis=1)
    return np.stack([np.cos(total) @ BONES, np.sin(total) @ BONES], axis=1)


def path_rows(seed: int, limited: int) -> list[Row]:
    """Return how a path along limits compares with the best."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 2 * np.pi, FRAMES)
    phases, sizes = rng.uniform(0, 6, 4), rng.uniform(0.1, 0.4, 4)
    angles = np.array([0.2, 0.5, 0.6, 0.4]) + sizes * np.sin(time[:, None] + phases)
    angles += rng.normal(0, 0.03, angles.shape)
    most = np.full(4, 3.0)
    most[:limited] = np.percentile(angles[:, :limited], 60, axis=0)
    angles = np.minimum(angles, most)
    wanted = points(angles)
    places = np.concatenate([[0.0], BONES[:-1]])
    pins = [
        Joint(
            *(f"j{i}", i - 1, JointType.PIN, (place, 0.0, 0.0)),
            axis=(0.0, 0.0, 1.0),
            limits=RangeLimit(-3.0, most[i]),
        )
        for i, place in enumerate(places)
    ]
    goal = ik.Goal("j3", offset=(BONES[-1], 0.0, 0.0))
    problem = ik.build(Rig("arm", tuple(pins)), [goal])
    targets = ik.Targets(np.pad(wanted, ((0, 0), (0, 1)))[:, None])
    solved = ik.solve(problem, angles, targets)
    found = ik.smooth(solved, targets, SECONDS, fps=FPS).coordinates
    start = solved.coordinates
    weight = (SECONDS * FPS) ** 4

    def cost(flat: FloatArray) -> tuple[float, FloatArray]:
        q = flat.reshape(FRAMES, 4)
        bend = np.diff(q, 2, axis=0)
        slope = q - start
        for k, factor in enumerate((1.0, -2.0, 1.0)):
            slope[k : FRAMES - 2 + k] += weight * factor * bend
        total = ((q - start) ** 2).sum() + weight * (bend**2).sum()
        return total / 2, slope.ravel()

    def off(flat: FloatArray) -> FloatArray:
        return (points(flat.reshape(FRAMES, 4)) - wanted).ravel()

    def slopes(flat: FloatArray) -> FloatArray:
        q = flat.reshape(FRAMES, 4)
        total = np.cumsum(q, axis=1)
        sides = np.stack([-np.sin(total), np.cos(total)], 1) * BONES
        behind = np.cumsum(sides[:, :, ::-1], axis=2)[:, :, ::-1]
        out = np.zeros((FRAMES, 2, FRAMES, 4))
        out[np.arange(FRAMES), :, np.arange(FRAMES)] = behind
        return out.reshape(2 * FRAMES, 4 * FRAMES)

    best = minimize(
        *(cost, found.ravel()),
        jac=True,
        method="SLSQP",
        bounds=[(-3.0, high) for _ in range(FRAMES) for high in most],
        constraints={"type": "eq", "fun": off, "jac": slopes},
        options={"maxiter": 300, "ftol": 1e-12},
    )
    section = f"smoothed beside limits of {limited}"
    bound = Bound(at_least=False, bound=1.2)
    name = f"path {seed}"

    def size(q: FloatArray) -> float:
        return float(np.linalg.norm(np.diff(q.reshape(FRAMES, 4), 2, axis=0)))

    return [
        Row(section, name, "acceleration / best", [size(found) / size(best.x)], bound),
        Row(section, name, "sum / best", [cost(found.ravel())[0] / best.fun]),
        Row(
            section,
            name,
            "largest miss of the best [m]",
            [float(abs(off(best.x)).max())],
        ),
    ]


def main() -> None:
    """Measure, print the table, write the CSV."""
    options = parser(__doc__, "ik_limits.csv", runs=3).parse_args()
    on_one_thread()
    session = begin(options, (sys.executable, ["animtool", "numpy", "scipy"]))
    rows = []
    for limited in (1, 2):
        for seed in range(3):
            rows += path_rows(seed, limited)
    for kind in (JointType.PIN, JointType.BALL):
        rows += snake_rows(kind, options.runs)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
