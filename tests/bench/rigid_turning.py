"""Time against error of a body that nothing twists, over methods and steps.

The body is the wingnut of the reference answers; see README.md beside this file.
"""

from __future__ import annotations

import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from figures import Bound, Clock, Row
from measuring import begin, in_process, in_turn, on_one_thread, parser

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.preview.work_precision import (
    Panel,
    PrecisionCurve,
    PrecisionPoint,
    draw_panels,
)
from animtool.sim.colliders import Colliders
from animtool.systems.rigid.spec import RigidModel

# Between two reference answers there are five frames; small steps a frame.
FRAMES, STEPS = 5, (1, 2, 4, 8, 16, 32, 64, 200)
RATE = 24
ATTITUDE, ENERGY = "attitude is off by [rad]", "energy is off by [1]"
# What the default claims at one small step a frame.
CLAIMED = {ATTITUDE: 2e-4, ENERGY: 1e-9}


class Wingnut:
    """A body with given moments, as the kernel takes it."""

    def __init__(self, instance: dict[str, Any]) -> None:
        """Begin as an instance of the reference answers says."""
        self.moments = np.array(instance["params"]["inertia"])
        self.times = np.array(instance["t"])
        self.attitudes = np.array(instance["reference"]["q_wxyz"])[:, [1, 2, 3, 0]]
        own = self.moments * instance["initial"]["omega_body"]
        zeros, turn = np.zeros(3), self.attitudes[0]
        row = [zeros, turn, zeros, so3.rotate(turn, own), [0.0]]
        self.start = np.concatenate(row)[None]
        whole = np.zeros(0, np.int64)
        self.kernel = _kernels.RigidBodies(
            np.array([[1.0, *self.moments]]), np.zeros(1, np.int64),
            np.array([[1.0, 0, 0]]), np.zeros((1, 3)), np.array([0, 1]),
            np.array([0, 0]), np.zeros(1, np.int64), whole, np.zeros((0, 3), np.int64),
            np.zeros((0, 27)), np.zeros((0, 2), np.int64),
        )  # fmt: skip

    def run(self, method: str, steps: int) -> FloatArray:
        """Return its states at the times of the answers ``(T, 14)``."""
        span, number = FRAMES / RATE, RigidModel.methods.index(method)
        nothing, states = Colliders([]).kernel_arrays(0.0, span), [self.start]
        pairs, contacts = np.zeros((0, 2), np.int64), np.zeros((0, 6))
        for _ in self.times[1:]:
            after = _kernels.step_rigid(
                self.kernel, states[-1], pairs, contacts, np.zeros((0, 12)),
                np.zeros((1, 6)), nothing, np.zeros((0, 2, 7)), span, number,
                FRAMES * steps, 1, 1e-4, 0.0, 1.0,
            )[0]  # fmt: skip
            if not np.isfinite(after).all():
                break
            states.append(after)
        return np.concatenate(states)

    def errors(self, states: FloatArray) -> dict[str, float]:
        """Return the largest errors; of what blew up they are infinite."""
        if len(states) < len(self.times):
            return {ATTITUDE: np.inf, ENERGY: np.inf}
        turns = states[:, 3:7]
        own = so3.rotate(so3.conjugate(turns), states[:, 10:13])
        energies = (own**2 / self.moments).sum(axis=1)
        return {
            ATTITUDE: float(so3.angle_between(turns, self.attitudes).max()),
            ENERGY: float(np.abs(energies / energies[0] - 1).max()),
        }


def measure(nut: Wingnut, runs: int) -> tuple[list[Row], list[Panel]]:
    """Time each method with each step in turn; return figures, and what is drawn."""
    rows: list[Row] = []
    points: dict[tuple[str, str], list[PrecisionPoint]] = {}
    for steps in STEPS:
        section = f"{RATE * steps} small steps a second"
        work = {
            name: in_process(partial(nut.run, name, steps))
            for name in RigidModel.methods
        }
        for name, taken in in_turn(work, runs).items():
            errors = nut.errors(nut.run(name, steps))
            times = [one.cpu for one in taken]
            times_row = Row(
                section, name, "CPU [ms]", [1e3 * t for t in times], clock=Clock.CPU
            )
            rows.append(times_row)
            for measure, error in errors.items():
                claims = name == RigidModel.methods[0] and steps == 1
                bound = Bound(at_least=False, bound=CLAIMED[measure])
                rows.append(
                    Row(section, name, measure, [error], bound if claims else None)
                )
                if 0 < error < np.inf:
                    point = PrecisionPoint(times_row.median / 1e3, error)
                    points.setdefault((measure, name), []).append(point)
    title = f"A wingnut turns freely for {nut.times[-1]:g} s"
    panels = [
        Panel(
            title,
            measure,
            tuple(
                PrecisionCurve(name, tuple(points[measure, name]))
                for name in RigidModel.methods
                if (measure, name) in points
            ),
            time="CPU seconds",
        )
        for measure in CLAIMED
    ]
    return rows, panels


def main() -> None:
    """Measure, print the tables, write the CSV and the plot."""
    made = parser(__doc__, "rigid_turning.csv", runs=5)
    options = made.parse_args()
    on_one_thread()
    path = Path(os.environ["ANIMTOOL_DATA"]) / "sim/dzhanibekov.json"
    instances = json.loads(path.read_text("utf-8"))["instances"]
    (instance,) = (one for one in instances if one["id"] == "wingnut")
    session = begin(options, (sys.executable, ["animtool", "numpy"]))
    rows, panels = measure(Wingnut(instance), options.runs)
    session.finish(options.csv, rows)
    if options.csv is not None:
        draw_panels(panels, options.csv.with_suffix(".svg"))


if __name__ == "__main__":
    main()
