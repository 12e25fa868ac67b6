"""How fast and how near sheets of springs fall, beside other tools.

Every tool gets the same springs in a process of its own, in turn; see README.md beside
this file.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from figures import HERE, Row, Wanted, machine, run, table, verdicts, write_csv

from animtool.sim.springs import Family, Pins, SpringSystem, sheet

FRAMES = 24
SECONDS, EARLY, LATE = "time [s]", "RMS at frame 6 [mm]", "RMS at frame 12 [mm]"
RATIO, EACH = "time / animtool [x]", "a spring and step [ns]"
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
        *[("vbd", 20, rate) for rate in (240, 480)],
        *[("semi_implicit", 0, rate) for rate in (1920, 3840, 7680)],
    ],
    100: [("vbd", 10, 240)],
}
TAICHI = {20: (1704, 3408, 6816), 100: (14400,)}
MUJOCO = {20: (1704, 3408), 100: ()}
WANTED = {20: {"taichi": 10.0, "newton": 20.0}, 100: {"newton": 4.0}}
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
        self.lost: list[str] = []

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
        python = asked.taichi_python
        for threads in sorted({1, os.cpu_count() or 1}):
            for rate in TAICHI[self.size]:
                name, told = f"taichi, {threads} threads", [str(threads)]
                yield name, python, "springs_taichi.py", rate, told
        python = asked.newton_python
        for method, often, rate in NEWTON[self.size]:
            name, told = f"newton {method}", [method, str(often)]
            yield name, python, "springs_newton.py", rate, told
        for rate in MUJOCO[self.size]:
            name = "mujoco flex"
            yield name, asked.mujoco_python, "springs_mujoco.py", rate, []

    def run(self) -> list[Found]:
        """Return what every tool made."""
        every = []
        for name, python, peer, rate, told in self.plan():
            if python is None:
                continue
            print(f"{self.size}: {name}, {rate}", file=sys.stderr)
            try:
                took = self.ask(python, peer, rate, *told)
            except SystemExit as stopped:
                if python == sys.executable:
                    raise
                print(stopped, file=sys.stderr)
                self.lost.append(f"{name}, {rate}/s, did not run")
                continue
            every.append(self.found(name, rate, took))
        return every


def ratio(found: Found, own: list[Found]) -> float | None:
    """Return a peer's time over that of animtool's quickest that is as near, if any."""
    near = [
        min(one.seconds)
        for one in own
        if one.early <= found.early and one.late <= found.late
    ]
    return min(found.seconds) / min(near) if near else None


def wanted(size: int, found: Found) -> Wanted | None:
    """Return the least ratio that a peer is to have."""
    bound = WANTED[size].get(found.tool.replace(",", " ").split()[0])
    return None if bound is None else Wanted(at_least=True, bound=bound)


def rows(size: int, every: list[Found]) -> list[Row]:
    """Return figures of every tool."""
    section, made = f"sheet of {size} x {size}, one second", []
    springs = len(problem(size).body.springs.rest)
    own = [found for found in every if found.tool.startswith("animtool")]
    for found in every:
        made += [
            Row(section, found.name, SECONDS, found.seconds),
            Row(section, found.name, EARLY, [found.early]),
            Row(section, found.name, LATE, [found.late]),
        ]
        slower = None if found in own else ratio(found, own)
        if slower is not None:
            bound = wanted(size, found)
            made.append(Row(section, found.name, RATIO, [slower], bound))
        if found.tool == "animtool symplectic_euler":
            each = 1e9 * min(found.seconds) / (springs * found.rate)
            bound = Wanted(at_least=False, bound=STEP)
            made.append(Row(section, found.name, EACH, [each], bound))
    return made


def draw(python: str, source: Path) -> None:
    """Draw the curves, where the interpreter has matplotlib."""
    known = [python, "-c", "import matplotlib"]
    if subprocess.run(known, capture_output=True, check=False).returncode:
        print(f"no plot was drawn: {python} has no matplotlib", file=sys.stderr)
        return
    script = str(HERE / "peers" / "springs_plot.py")
    plot = str(source.with_suffix(".svg"))
    run([python, script, str(source), plot], report=False)


def main() -> None:
    """Measure, print the tables, write the CSV."""
    about = __doc__.splitlines()[0] if __doc__ else None
    made = argparse.ArgumentParser(description=about)
    for name in PEERS:
        made.add_argument(f"--{name}-python")
    made.add_argument("--plot-python", default=sys.executable)
    made.add_argument("--runs", type=int, default=3)
    made.add_argument("--sizes", type=int, nargs="*", default=[20, 100])
    made.add_argument("--csv", type=Path, default=HERE / "results" / "sim_springs.csv")
    options = made.parse_args()
    pythons = {name: getattr(options, f"{name}_python") for name in PEERS}
    lines = machine(
        (sys.executable, ["animtool", "numpy"]),
        *((pythons[name], packages) for name, packages in PEERS.items()),
    )
    for name, python in pythons.items():
        if python is None:
            lines.append(f"{name} was not run: no interpreter was given")
    sections = []
    with tempfile.TemporaryDirectory() as folder:
        for size in options.sizes:
            bench = Bench(size, Path(folder), options)
            data = Path(os.environ["ANIMTOOL_DATA"])
            bench.settle(reference(data) if size == 20 else None)
            sections.append(rows(size, bench.run()))
            lines += bench.lost
    print("\n".join(lines))
    for section in sections:
        print("\n".join(["", *table(section), "", *verdicts(section)]))
    write_csv(options.csv, lines, [row for section in sections for row in section])
    draw(options.plot_python, options.csv)


if __name__ == "__main__":
    main()
