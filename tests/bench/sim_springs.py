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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from figures import HERE, Row, Wanted, machine, run, table, verdicts, write_csv

from animtool.sim.springs import Family, Pins, SpringSystem, sheet

FRAMES = 24
FILM = 24
SECONDS, EARLY, LATE = "time [s]", "RMS at frame 6 [mm]", "RMS at frame 12 [mm]"
RATIO = "time / animtool [x]"
# Steps a second; the fewest are those that taichi is given.
OWN = {
    20: [
        *[("symplectic_euler", rate) for rate in (1704, 1920, 2400, 4800, 9600)],
        *[("xpbd", rate) for rate in (480, 960, 1920, 3840)],
        *[("bdf2", rate) for rate in (240, 480, 960, 1920)],
        ("implicit_euler", 960),
    ],
    100: [
        ("symplectic_euler", 14400),
        *[("xpbd", rate) for rate in (480, 960, 1920)],
    ],
}
FINE = {20: None, 100: 28800}
# Newton's method, steps a second and iterations.
NEWTON = {
    20: [("vbd", 480, 20), ("semi_implicit", 1920, 0)],
    100: [("vbd", 240, 10)],
}
TAICHI = {20: 1704, 100: 14400}
WANTED = {"taichi": 10.0, "newton": 20.0}
WANTED_LARGE = {"newton": 4.0}


@dataclass(frozen=True)
class Found:
    """What a tool took, and how far off it was [mm]."""

    tool: str
    rate: int
    seconds: list[float]
    early: float
    late: float

    @property
    def name(self) -> str:
        """The tool and its steps a second."""
        return f"{self.tool}, {self.rate}/s"


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
        self.size, self.options = size, options
        self.given, self.made = folder / f"{size}.npz", folder / "made.npy"
        save(problem(size), self.given)
        self.true: np.ndarray | None = None

    def ask(self, python: str, peer: str, rate: int, *more: str) -> list[float]:
        """Run a peer, and return its seconds."""
        command = [
            python, str(HERE / "peers" / peer), str(self.given), str(rate),
            str(FRAMES), str(self.options.runs), str(self.made), *more,
        ]  # fmt: skip
        seconds: list[float] = run(command).report["seconds"]
        return seconds

    def found(self, tool: str, rate: int, seconds: list[float]) -> Found:
        """Return what a tool has just made."""
        assert self.true is not None
        places = np.load(self.made)
        off = [
            1e3 * float(np.sqrt(((place - true) ** 2).sum(axis=1).mean()))
            for place, true in zip(places[[6, 12]], self.true, strict=True)
        ]
        return Found(tool, rate, seconds, *off)

    def settle(self, true: np.ndarray | None) -> None:
        """Take the truth, or finer steps for it."""
        if true is None:
            rate = FINE[self.size]
            assert rate is not None
            self.ask(sys.executable, "springs_animtool.py", rate, "symplectic_euler")
            places = np.load(self.made)
            true = places[[6, 12]]
        self.true = true

    def run(self) -> list[Found]:
        """Return what every tool made."""
        asked, every = self.options, []
        for solver, rate in OWN[self.size]:
            print(f"{self.size}: {solver} {rate}", file=sys.stderr)
            took = self.ask(sys.executable, "springs_animtool.py", rate, solver)
            every.append(self.found(f"animtool {solver}", rate, took))
        if asked.taichi_python:
            for threads in ("1", str(os.cpu_count())):
                rate = TAICHI[self.size]
                print(f"{self.size}: taichi {rate}", file=sys.stderr)
                took = self.ask(asked.taichi_python, "springs_taichi.py", rate, threads)
                every.append(self.found(f"taichi, {threads} threads", rate, took))
        if asked.newton_python:
            for method, rate, iterations in NEWTON[self.size]:
                print(f"{self.size}: newton {method} {rate}", file=sys.stderr)
                more = (method, str(iterations))
                took = self.ask(asked.newton_python, "springs_newton.py", rate, *more)
                every.append(self.found(f"newton {method}", rate, took))
        return every


def rows(size: int, every: list[Found]) -> list[Row]:
    """Return figures: of each peer, against animtool's quickest that is as near."""
    section, made = f"sheet of {size} x {size}, one second", []
    own = [found for found in every if found.tool.startswith("animtool")]
    for found in every:
        made += [
            Row(section, found.name, SECONDS, found.seconds),
            Row(section, found.name, EARLY, [found.early]),
            Row(section, found.name, LATE, [found.late]),
        ]
        near = [
            min(one.seconds)
            for one in own
            if one.early <= found.early and one.late <= found.late
        ]
        if found in own or not near:
            continue
        wanted = (WANTED if size == 20 else WANTED_LARGE).get(
            found.tool.replace(",", " ").split()[0]
        )
        bound = None if wanted is None else Wanted(at_least=True, bound=wanted)
        made.append(
            Row(section, found.name, RATIO, [min(found.seconds) / min(near)], bound)
        )
    return made


def main() -> None:
    """Measure, print the tables, write the CSV."""
    about = __doc__.splitlines()[0] if __doc__ else None
    made = argparse.ArgumentParser(description=about)
    made.add_argument("--taichi-python")
    made.add_argument("--newton-python")
    made.add_argument("--runs", type=int, default=5)
    made.add_argument("--sizes", type=int, nargs="*", default=[20, 100])
    made.add_argument("--csv", type=Path, default=HERE / "results" / "sim_springs.csv")
    options = made.parse_args()
    lines = machine(
        (sys.executable, ["animtool", "numpy"]),
        (options.taichi_python, ["taichi"]),
        (options.newton_python, ["newton", "warp-lang"]),
    )
    for name in ("taichi", "newton"):
        if getattr(options, f"{name}_python") is None:
            lines.append(f"{name} was not run: no interpreter was given")
    sections = []
    with tempfile.TemporaryDirectory() as folder:
        for size in options.sizes:
            bench = Bench(size, Path(folder), options)
            data = Path(os.environ["ANIMTOOL_DATA"])
            bench.settle(reference(data) if size == 20 else None)
            sections.append(rows(size, bench.run()))
    print("\n".join(lines))
    for section in sections:
        print("\n".join(["", *table(section), "", *verdicts(section)]))
    write_csv(options.csv, lines, [row for section in sections for row in section])


if __name__ == "__main__":
    main()
