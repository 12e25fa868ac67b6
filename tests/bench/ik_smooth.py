"""How long smoothing takes a frame, and how much memory, as a clip grows.

A tree of 160 joints in five chains, 483 degrees of freedom; the ends of the chains have
places and rotations that tremble. With limits, most joints are near one.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from clock import now, since
from figures import Bound, Clock, Row
from measuring import begin, on_one_thread, parser, run

from animtool import ik
from animtool.maths import so3
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Joint, JointType, Rig

CHAINS = (32, 32, 32, 32, 31)
NARROW = 0.05  # [rad]
FPS = 24.0
# Frames, smoothing time [s], and whether there are limits.
CASES = ((300, 0.1, 0), (1200, 0.1, 0), (300, 0.1, 1), (300, 0.3, 1))


def tree(limit: BallLimit | None) -> tuple[Rig, list[str]]:
    """Return the rig and the ends of its chains."""
    joints, ends = [Joint("root", -1, JointType.FREE)], []
    for c, count in enumerate(CHAINS):
        parent = 0
        for k in range(count):
            first = (0.05 * np.cos(1.3 * c), 0.05, 0.05 * np.sin(1.3 * c))
            place = (0.02 * (-1) ** k, 0.05, 0.0) if k else first
            ball = Joint(f"c{c}_{k}", parent, JointType.BALL, place, limits=limit)
            parent = len(joints)
            joints.append(ball)
        ends.append(joints[-1].name)
    return Rig("tree", tuple(joints)), ends


def wander(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> Any:
    """Return noise that is smooth along the first axis."""
    window = np.exp(-0.5 * (np.arange(-20, 21) / 6) ** 2)
    window *= size / np.linalg.norm(window)
    noise = rng.normal(size=shape)
    return np.apply_along_axis(lambda v: np.convolve(v, window, "same"), 0, noise)


def measure(frames: int, seconds: float, limited: int) -> dict[str, float]:
    """Return time a frame, memory and accelerations of a case."""
    narrow = BallLimit((NARROW, NARROW), (-NARROW, NARROW)) if limited else None
    rig, ends = tree(narrow)
    rng = np.random.default_rng(0)
    rotations = so3.exp(wander(rng, (frames, len(rig.joints), 3), 0.03))
    places = np.repeat(rig.rest_translations[None], frames, 0)
    places[:, 0] += wander(rng, (frames, 3), 0.05)
    world, at = (
        forward_kinematics(rig, places, rotations),
        [rig.index(name) for name in ends],
    )
    points = world.positions[:, at] + rng.normal(0, 5e-4, (frames, len(at), 3))
    targets = ik.Targets(points, so3.from_matrix(world.linear[:, at]))
    problem = ik.build(rig, [ik.Goal(name, orientation=1.0) for name in ends])
    result = ik.solve(problem, None, targets)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = now()
    ik.smooth(result, targets, seconds, fps=FPS)
    taken = since(began)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "wall": 1e3 * taken.wall / frames,
        "cpu": 1e3 * taken.cpu / frames,
        "memory": (after - before) * 1024 / 1e6,
    }


def rows_of(case: tuple[int, float, int], runs: int) -> list[Row]:
    """Return the figures of a case, each run a process."""
    frames, seconds, limited = case
    command = [sys.executable, str(Path(__file__)), "--case", json.dumps(case)]
    found = [run(command).report for _ in range(runs)]
    section = f"smooth, {seconds} s, {'near limits' if limited else 'no limits'}"
    name = f"{frames} frames"
    values = {key: [one[key] for one in found] for key in ("wall", "cpu", "memory")}
    bound = Bound(at_least=False, bound=5.0)
    return [
        Row(section, name, "wall [ms/frame]", values["wall"], None, Clock.WALL),
        Row(section, name, "CPU [ms/frame]", values["cpu"], bound, Clock.CPU),
        Row(section, name, "more memory [MB]", values["memory"]),
    ]


def main() -> None:
    """Measure, print the table, write the CSV."""
    made = parser(__doc__, "ik_smooth.csv", runs=3)
    made.add_argument("--case", help="measures one in this process, as JSON")
    options = made.parse_args()
    on_one_thread()
    if options.case:
        print("\n" + json.dumps(measure(*json.loads(options.case))))
        return
    session = begin(options, (sys.executable, ["animtool", "numpy"]))
    rows = [row for case in CASES for row in rows_of(case, options.runs)]
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
