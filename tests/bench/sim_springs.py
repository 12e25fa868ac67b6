"""How fast and how near sheets of springs fall, beside other tools.

Every tool gets the same springs in a process of its own, in turn; see README.md beside
this file.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, draw, floors, parser, run_peer, taken_of

from animtool.systems.springs import Family, Pins, SpringSystem, sheet

FRAMES = 24
EACH = "CPU of a spring and step [ns]"
EARLY, LATE = "RMS at frame 6 [mm]", "RMS at frame 12 [mm]"
# What a ratio needs at both frames: a hundredth of the side of the sheet.
NEAR_ENOUGH = Bound(at_least=False, bound=10.0)
# Steps a second. Explicit ones of the sheet of 20 are stable from 1479 on, by its
# fastest motion at rest; the fewest here are 5 % more. Taichi is given 1704 or more.
OWN = {
    20: [
        *[("symplectic_euler", rate) for rate in (1560, 1704, 2400, 3408, 6816, 9600)],
        *[("xpbd", rate) for rate in (480, 960, 1920, 3840)],
        *[("bdf2", rate) for rate in (240, 960, 1920)],
        ("implicit_euler", 960),
    ],
    100: [
        *[("symplectic_euler", rate) for rate in (8640, 9600, 14400)],
        *[("xpbd", rate) for rate in (480, 960, 1920)],
    ],
}
# The truth of a sheet that the data has none of goes from these, as the error of
# symplectic_euler goes with the step.
FINE = (28800, 57600)
# Its methods, their iterations, and steps a second.
NEWTON = {
    20: [
        *[("vbd", 20, rate) for rate in (240, 480, 1920)],
        *[("semi_implicit", 0, rate) for rate in (1920, 3840, 7680)],
    ],
    100: [("vbd", 10, 240), ("semi_implicit", 0, 14400)],
}
TAICHI = {20: (1704, 3408, 6816), 100: (14400,)}
MUJOCO = {20: (1704, 3408), 100: ()}
# By a call a frame.
ALONE = {20: (1704, 3408), 100: (14400,)}
OWN_ALONE = "animtool, a call a frame"
PLAIN = {20: (1560, 3408, 6816), 100: (8640, 14400)}
WANTED = {
    20: {"taichi": 1.5, "newton": 20.0, "mujoco": 10.0},
    100: {"taichi": 1.5, "newton": 4.0},
}
# The same steps in another order of sums are as near [x].
SAME = 1.001
# A tool that takes this long is not run again [s].
ENOUGH = 5.0
# Of an explicit step of animtool's, at most [ns].
STEP = 1.5 * 7.5
PEERS = {
    "taichi": ["taichi"],
    "newton": ["newton", "warp-lang"],
    "mujoco": ["mujoco"],
}


@dataclass(frozen=True)
class Found:
    """What a tool took, and how far off it was [mm]."""

    tool: str
    rate: int
    taken: list[Taken]
    early: float
    late: float

    @property
    def name(self) -> str:
        """The tool and its steps a second."""
        return f"{self.tool}, {self.rate}/s"

    @property
    def cpu(self) -> float:
        """What its quickest run took of processors [s]."""
        return min(one.cpu for one in self.taken)

    @property
    def slow(self) -> bool:
        """Whether one run of it is enough."""
        return self.taken[0].wall > ENOUGH

    def near(self) -> list[Accuracy]:
        """Return how near it came."""
        return [
            Accuracy(EARLY, self.early, NEAR_ENOUGH),
            Accuracy(LATE, self.late, NEAR_ENOUGH),
        ]


def problem(size: int) -> SpringSystem:
    """Return the sheet of the data, of that many particles a side."""

    def family(stiffness: float) -> Family:
        return Family(stiffness, ratio=0.02)

    body = sheet(
        size, size, mass=0.3 / size**2, structural=family(1000.0),
        diagonals=family(500.0), bend=family(50.0),
    )  # fmt: skip
    return SpringSystem(body, pins=Pins([0, size - 1]), drag=0.02)


def save(system: SpringSystem, path: Path) -> None:
    """Write what tools are given."""
    springs = system.body.springs
    np.savez(
        path, positions=system.body.positions, masses=system.body.masses,
        inverse_masses=system.inverse_masses, ends=springs.ends, rest=springs.rest,
        stiffness=springs.stiffness, damping=springs.damping, drag=system.drag,
    )  # fmt: skip


def reference(data: Path) -> np.ndarray:
    """Return the true places at frames 6 and 12 of 20 by 20."""
    text = (data / "sim/cloth_transient.json").read_text("utf-8")
    found = json.loads(text)["instances"][0]["reference"]
    return np.array([found["positions"][found["frames"].index(f)] for f in (6, 12)])


class Bench:
    """One size of sheet."""

    def __init__(self, size: int, folder: Path, options: argparse.Namespace) -> None:
        self.size, self.options, self.folder = size, options, folder
        self.given, self.made = folder / f"{size}.npz", folder / "made.npy"
        save(problem(size), self.given)
        self.true: np.ndarray | None = None
        self.lost: list[tuple[str, int]] = []

    def ask(self, python: str, peer: str, rate: int, *more: str) -> Taken:
        """Run a peer, and return what it took."""
        told = self.given, rate, FRAMES, self.made, *more
        return taken_of(run_peer(python, peer, *told))[0]

    def found(self, tool: str, rate: int, taken: Taken) -> Found:
        """Return what a tool has just made."""
        assert self.true is not None
        places = np.load(self.made)
        off = [
            1e3 * float(np.sqrt(((place - true) ** 2).sum(axis=1).mean()))
            for place, true in zip(places[[6, 12]], self.true, strict=True)
        ]
        return Found(tool, rate, [taken], *off)

    def settle(self, true: np.ndarray | None) -> None:
        """Take the truth, or what ever finer steps tend to."""
        if true is None:
            made = []
            for rate in FINE:
                print(f"{self.size}: the truth, {rate}", file=sys.stderr)
                peer = "springs_animtool.py"
                self.ask(sys.executable, peer, rate, "symplectic_euler")
                made.append(np.load(self.made)[[6, 12]])
            true = 2 * made[1] - made[0]
        self.true = true

    def plan(self) -> Iterator[tuple[str, str | None, str, int, list[str]]]:
        """Return names, interpreters, scripts, steps a second and what else is told."""
        asked, own = self.options, "springs_animtool.py"
        for solver, rate in OWN[self.size]:
            yield f"animtool {solver}", sys.executable, own, rate, [solver]
        for rate in ALONE[self.size]:
            told = ["symplectic_euler", "frames"]
            yield OWN_ALONE, sys.executable, own, rate, told
        for name, library in floors(asked.compiler, self.folder).items():
            for rate in PLAIN[self.size]:
                told = [library._name]
                yield name, sys.executable, "springs_floor.py", rate, told
        python = asked.taichi_python
        ways = {"fused": "taichi, fused, serial"}
        if self.size > 20:
            count = os.cpu_count() or 1
            ways[str(count)] = f"taichi, {count} threads"
        for how, name in ways.items():
            for rate in TAICHI[self.size]:
                yield name, python, "springs_taichi.py", rate, [how]
        python = asked.newton_python
        for method, often, rate in NEWTON[self.size]:
            name, told = f"newton {method}", [method, str(often)]
            yield name, python, "springs_newton.py", rate, told
        for rate in MUJOCO[self.size]:
            name = "mujoco flex"
            yield name, asked.mujoco_python, "springs_mujoco.py", rate, []

    def run(self) -> list[Found]:
        """Return what every tool made, all in turn, in as many rounds as asked for."""
        every: dict[tuple[str, int], Found] = {}
        plan = [one for one in self.plan() if one[1] is not None]
        for _ in range(self.options.runs):
            for name, python, peer, rate, told in plan:
                known = every.get((name, rate))
                if (name, rate) in self.lost or (known and known.slow):
                    continue
                print(f"{self.size}: {name}, {rate}", file=sys.stderr)
                try:
                    took = self.ask(python, peer, rate, *told)
                except SystemExit as stopped:
                    if python == sys.executable:
                        raise
                    print(stopped, file=sys.stderr)
                    self.lost.append((name, rate))
                    continue
                if known is None:
                    every[name, rate] = self.found(name, rate, took)
                else:
                    known.taken.append(took)
        return list(every.values())


def as_near(found: Found, own: list[Found]) -> Found | None:
    """Return the quickest of some that are as near in both frames, if any."""
    near = [
        one
        for one in own
        if one.early <= SAME * found.early and one.late <= SAME * found.late
    ]
    return min(near, key=lambda one: one.cpu, default=None)


def wanted(size: int, found: Found) -> Bound | None:
    """Return the least ratio that a peer is to have."""
    bound = WANTED[size].get(found.tool.replace(",", " ").split()[0])
    return None if bound is None else Bound(at_least=True, bound=bound)


def rows(size: int, every: list[Found]) -> list[Row]:
    """Return figures of every tool."""
    section, made = f"sheet of {size} x {size}, one second", []
    springs = len(problem(size).body.springs.rest)
    own = [found for found in every if found.tool.startswith("animtool ")]
    alone = [found for found in every if found.tool == OWN_ALONE]
    for found in every:
        made += time_rows(section, found.name, found.taken)
        made += [
            Row(section, found.name, EARLY, [found.early]),
            Row(section, found.name, LATE, [found.late]),
        ]
        bases = [] if found in own else [("animtool", own, wanted(size, found))]
        if found.tool.startswith(("newton", "mujoco")):
            # They are called for every step or frame.
            bases.append((OWN_ALONE, alone, Bound(at_least=True, bound=1.0)))
        for name, others, bound in bases:
            base, near = as_near(found, others), found.near()
            if base is not None or any(one.fault() for one in near):
                made += ratio_rows(
                    section,
                    found.name,
                    found.taken,
                    base.taken if base else [],
                    name=name,
                    wanted=bound,
                    accuracy=near,
                )
        if found.tool == "animtool symplectic_euler":
            each = 1e9 * found.cpu / (springs * found.rate)
            bound = Bound(at_least=False, bound=STEP)
            made.append(Row(section, found.name, EACH, [each], bound, clock=Clock.CPU))
    return made


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "sim_springs.csv", runs=3)
    for name in PEERS:
        made.add_argument(f"--{name}-python")
    made.add_argument("--plot-python", default=sys.executable)
    made.add_argument("--compiler", default="c++", help="of the plain loops")
    made.add_argument("--sizes", type=int, nargs="*", default=[20, 100])
    options = made.parse_args()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        *((getattr(options, f"{name}_python"), PEERS[name]) for name in PEERS),
    )
    every: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for size in options.sizes:
            bench = Bench(size, Path(folder), options)
            data = Path(os.environ["ANIMTOOL_DATA"])
            bench.settle(reference(data) if size == 20 else None)
            every += rows(size, bench.run())
            session.about += [f"{n}, {r}/s, did not run" for n, r in bench.lost]
    session.finish(options.csv, every)
    draw(options.plot_python, options.csv, "RMS at ")


if __name__ == "__main__":
    main()
