"""Heights, energy and spin of what bounces, beside MuJoCo and pybullet.

    python tests/bench/rigid_impacts.py --peers-python ../peers/bin/python

Boxes, slabs, balls and lying capsules fall flat from a metre, at four restitutions and
four steps; a box tumbles; a row of touching balls is hit. What is right is known in
closed form.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from figures import Bound, Row
from measuring import begin, parser, run_peer

OWN, BULLET, MUJOCO = "animtool", "pybullet", "MuJoCo"
SCRIPTS = {
    OWN: "rigid_impacts_animtool.py",
    BULLET: "rigid_impacts_pybullet.py",
    MUJOCO: "rigid_impacts_mujoco.py",
}
SHAPES = {
    "box": [0.4, 0.4, 0.4],
    "slab": [0.6, 0.2, 0.9],
    "ball": [0.2],
    "capsule": [0.1, 0.4],
}
RESTITUTIONS, STEPS = (0.2, 0.5, 0.8, 1.0), (1 / 60, 1 / 120, 1 / 240, 1 / 1000)
GRAVITY = 9.81
# What is owed: heights, of e² of the fall; energy at e = 1 without friction; spin
# [rad/s].
HEIGHT, GAIN, KEPT, SPIN = 0.01, 1.001, 0.98, 1e-3


def problems() -> list[dict]:
    """Return what each tool simulates: one entry a run."""
    found = []
    for step in STEPS:
        for name, size in SHAPES.items():
            for e in RESTITUTIONS:
                one = {"kind": "drop", "shape": name, "size": size, "e": e}
                found.append(one | {"step": step, "seconds": 1.2})
        found.append(
            {"kind": "tumble", "size": [0.4, 0.3, 0.2], "step": step, "e": 1.0}
        )
        found.append({"kind": "row", "count": 5, "radius": 0.1, "step": step, "e": 1.0})
    return found


def scores(problem: dict, path: dict) -> dict[str, float]:
    """Return how far a tool is off, by what is known of a run."""
    heights, energy = np.array(path["heights"]), np.array(path["energy"])
    if problem["kind"] == "drop":
        e, lands = problem["e"], np.sqrt(2 / GRAVITY)
        times = np.array(path["times"])
        after = (times > lands + 0.02) & (times < lands * (1 + 2 * e) - 0.02)
        rise = float(heights[after].max()) if after.any() else 0.0
        off = abs(rise - e * e) / (e * e)
        return {"height is off by [1]": off, "spin [rad/s]": max(path["spins"])}
    if problem["kind"] == "tumble":
        share = energy / energy[0]
        return {"most energy [1]": share.max(), "least energy [1]": share.min()}
    wanted = np.zeros(problem["count"])
    wanted[-1] = 2.0
    off = np.abs(np.array(path["velocities"]) - wanted).max() / 2.0
    return {"speeds are off by [1]": float(off)}


BOUNDS = {
    "height is off by [1]": Bound(at_least=False, bound=HEIGHT),
    "spin [rad/s]": Bound(at_least=False, bound=SPIN),
    "most energy [1]": Bound(at_least=False, bound=GAIN),
    "least energy [1]": Bound(at_least=True, bound=KEPT),
    "speeds are off by [1]": Bound(at_least=False, bound=HEIGHT),
}


def main() -> None:
    """Simulate all, print the tables, write the CSV."""
    made = parser(__doc__, "rigid_impacts.csv", runs=1)
    made.add_argument("--peers-python", help="interpreter with mujoco and pybullet")
    options = made.parse_args()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peers_python, ["mujoco", "pybullet", "numpy"]),
        clocked=False,
    )
    given, rows = problems(), []
    for name in SCRIPTS if options.peers_python else [OWN]:
        python = sys.executable if name == OWN else options.peers_python
        paths = run_peer(python, SCRIPTS[name], json.dumps(given))["paths"]
        worst: dict[tuple[str, str], list[float]] = {}
        for problem, path in zip(given, paths, strict=True):
            section = f"{problem['kind']}, {1 / problem['step']:.0f} steps a second"
            for measure, value in scores(problem, path).items():
                worst.setdefault((section, measure), []).append(value)
        for (section, measure), values in worst.items():
            least = measure.startswith("least")
            value = min(values) if least else max(values)
            bound = BOUNDS[measure] if name == OWN else None
            rows.append(Row(section, name, measure, [value], bound))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
