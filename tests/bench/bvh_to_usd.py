"""How fast animtool bakes BVH to USD, beside Blender, pybvh and np.loadtxt.

Every tool runs as a process of its own, in turn, and is timed from outside; see
README.md beside this file. Only the standard library is imported here, so that this
process stays small: on Linux a child's peak memory begins at that of its parent.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clock import Taken
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import HERE, ROOT, Run, begin, parser, run, taken_of

PEAK = "peak memory [MB]"
PEAK_PER_FILE = "peak / file [x]"
ERROR = "largest error [cm]"
# What a ratio needs of a tool that gives positions.
NEAR_ENOUGH = Bound(at_least=False, bound=0.1)
INNER = "wall without start-up [s]"
SPEED = "CPU speed [MB/s]"
BLENDER = "Blender"
START_UP = "start-up"


@dataclass
class Tool:
    """A command to time, made for its output file.

    Attributes:
        name: For the table.
        command: Returns the command, given a path without suffix for its output.
        runs: How many.
        output: Suffix of what it writes, if anything.
    """

    name: str
    command: Callable[[Path], list[str]]
    runs: int
    output: str = ""
    runs_of: list[Run] = field(default_factory=list)

    @property
    def taken(self) -> list[Taken]:
        """What its processes took from start to end."""
        return [run.taken for run in self.runs_of]


def in_turn(tools: list[Tool], work: Path, *, warm_up: bool) -> None:
    """Run the tools A B C A B C, each as often as it asks for.

    A warm-up is a first round that does not count.
    """
    for i in range(-1 if warm_up else 0, max(tool.runs for tool in tools)):
        for tool in tools:
            if i >= tool.runs:
                continue
            stem = work / tool.name
            if tool.output:
                stem.with_suffix(tool.output).unlink(missing_ok=True)
            once = run(tool.command(stem))
            if i >= 0:
                tool.runs_of.append(once)
            print(f"  {tool.name}: {once.taken.wall:.2f} s", file=sys.stderr)


class Bench:
    """The sections, and the figures that they found."""

    def __init__(self, options: argparse.Namespace, work: Path) -> None:
        self.options = options
        self.work = work
        self.rows: list[Row] = []

    def add(
        self,
        section: str,
        tool: str,
        measure: str,
        values: list[float] | float,
        wanted: Bound | None = None,
    ) -> None:
        """Keep a figure."""
        values = values if isinstance(values, list) else [values]
        self.rows.append(Row(section, tool, measure, values, wanted))

    def part(self, *arguments: object) -> dict[str, Any]:
        """Run one of `parts.py` and return its result."""
        command = [self.options.python, str(HERE / "parts.py"), *map(str, arguments)]
        return run(command).report

    def start_up(self) -> None:
        """Time what a user waits for before anything happens."""
        options, python = self.options, self.options.python
        small = options.small
        commands = {
            "animtool --help": [options.animtool, "--help"],
            "python, import animtool": [python, "-c", "import animtool"],
            "python, pass": [python, "-c", "pass"],
            "animtool bake": self._bake(small, self.work / "small"),
        }
        bounds = {"animtool --help": 0.1, "animtool bake": 0.6}
        taken: dict[str, list[Taken]] = {name: [] for name in commands}
        for i in range(options.start_up_runs + 1):
            for name, command in commands.items():
                once = run(command, report=False).taken
                if i:  # The first warms the caches.
                    taken[name].append(once)
        for name, runs in taken.items():
            wanted = Bound(False, bounds[name]) if name in bounds else None
            shown = f"{name} {small.name}" if name == "animtool bake" else name
            self.rows += time_rows(START_UP, shown, runs, wanted=wanted)
        pairs = zip(
            taken["python, import animtool"], taken["python, pass"], strict=True
        )
        own = [Taken(*(a - b for a, b in zip(*pair, strict=True))) for pair in pairs]
        self.rows += time_rows(
            START_UP, "import animtool alone", own, wanted=Bound(False, 0.03)
        )

    def _bake(self, source: Path, stem: Path) -> list[str]:
        output = stem.with_suffix(".usdc")
        command = [self.options.animtool, "bake", str(source), "-o", str(output)]
        return [*command, "--overwrite", "--format", "json"]

    def file(
        self, section: str, source: Path, every: int, wanted: dict[str, Bound]
    ) -> None:
        """Time every tool on one file, and measure what each got wrong."""
        options, long, size = self.options, section == "long", source.stat().st_size
        tools = list(self._tools(source, options.bpy_runs if long else options.runs))
        print(f"{section}: {size / 1e6:.1f} MB", file=sys.stderr)
        in_turn(tools, self.work, warm_up=not long)
        errors = self._errors(source, every, tools)
        own = tools[0]
        for tool in tools:
            name, error = tool.name, errors.get(tool.name, {}).get("error")
            peaks = [run.peak_bytes / 1e6 for run in tool.runs_of]
            self.rows += time_rows(section, name, tool.taken)
            inner = [run.report["seconds"]["total"] for run in tool.runs_of]
            self.rows.append(Row(section, name, INNER, inner, clock=Clock.WALL))
            if tool is not own:
                near = [] if error is None else [Accuracy(ERROR, error, NEAR_ENOUGH)]
                bound = wanted.get(name)
                self.rows += ratio_rows(
                    section, name, tool.taken, own.taken, wanted=bound, accuracy=near
                )
            self.add(section, name, PEAK, peaks)
            per_file = [peak * 1e6 / size for peak in peaks]
            bound = wanted.get(PEAK_PER_FILE) if tool is own else None
            self.add(section, name, PEAK_PER_FILE, per_file, bound)
            if error is not None:
                self.add(section, name, ERROR, error)

    def _tools(self, source: Path, bpy_runs: int) -> Iterator[Tool]:
        options, peers, runs = self.options, HERE / "peers", self.options.runs
        yield Tool("animtool", lambda stem: self._bake(source, stem), runs, ".usdc")
        load = [options.python, str(peers / "loadtxt.py"), str(source)]
        yield Tool("np.loadtxt", lambda _: load, runs)
        if options.pybvh_python:
            positions = str(peers / "pybvh_positions.py")
            command = [options.pybvh_python, positions, str(source)]
            yield Tool("pybvh", lambda _: command, runs)
        else:
            print("  pybvh skipped: no --pybvh-python", file=sys.stderr)
        if options.bpy_python:
            blender = [options.bpy_python, str(peers / "blender.py"), str(source)]
            yield Tool(
                BLENDER,
                lambda stem: [*blender, str(stem.with_suffix(".usdc"))],
                bpy_runs,
                ".usdc",
            )
        else:
            print("  Blender skipped: no --bpy-python", file=sys.stderr)

    def _errors(self, source: Path, every: int, tools: list[Tool]) -> dict[str, Any]:
        """Return what `parts.errors` says of each tool's last output."""
        outputs = []
        for tool in tools:
            stem = self.work / tool.name
            if tool.output:
                outputs.append(f"{tool.name}={stem.with_suffix(tool.output)}")
            elif tool.name == "pybvh":
                stored = stem.with_suffix(".npz")
                run([*tool.command(stem), str(stored), str(every)])
                outputs.append(f"{tool.name}={stored}")
        found = self.part("errors", source, every, *outputs)
        for name, entry in found.items():
            print(f"  {name}: {entry}", file=sys.stderr)
        return found

    def kernel(self, source: Path) -> None:
        """Time the row parser against np.loadtxt."""
        options = self.options
        found = self.part("kernel", source, self.work, options.kernel_mb, options.runs)
        wanted = Bound(True, 4)
        self._parts("row parser", found, "np.loadtxt", "parse_bvh_rows", wanted)
        for name in found["taken"]:
            speeds = [
                found["bytes"] / 1e6 / one.cpu for one in taken_of(found["taken"], name)
            ]
            row = Row("row parser", name, SPEED, speeds, clock=Clock.CPU)
            self.rows.append(row)

    def authoring(self) -> None:
        """Time the authoring of samples against a bare loop."""
        frames, joints = self.options.authoring_frames, 60
        found = self.part("authoring", self.work, frames, joints, self.options.runs)
        wanted = Bound(False, 1.5)
        self._parts("authoring", found, "AnimationWriter", "layer route", wanted)

    def _parts(
        self,
        section: str,
        found: dict[str, Any],
        tool: str,
        base: str,
        wanted: Bound,
    ) -> None:
        """Add what the routes of `parts.py` took, and one over the other."""
        taken = {name: taken_of(found["taken"], name) for name in found["taken"]}
        for name, runs in taken.items():
            self.rows += time_rows(section, name, runs)
        self.rows += ratio_rows(
            section, tool, taken[tool], taken[base], name=base, wanted=wanted
        )

    def run(self) -> None:
        """Run every section that was asked for."""
        sections = self.options.sections
        long = self.work / f"long-{self.options.frames}.bvh"
        if {"long", "kernel"} & set(sections) and not long.exists():
            self.part("make-long", self.options.long_from, long, self.options.frames)
        if "start-up" in sections:
            self.start_up()
        if "kernel" in sections:
            self.kernel(long)
        if "authoring" in sections:
            self.authoring()
        if "medium" in sections:
            bounds = {BLENDER: Bound(True, 5)}
            self.file("medium", self.options.medium, 1, bounds)
        if "long" in sections:
            bounds = {
                BLENDER: Bound(True, 25),
                "np.loadtxt": Bound(True, 0.4),
                PEAK_PER_FILE: Bound(False, 3),
            }
            self.file("long", long, self.options.every, bounds)


def keep_bytecode(folder: Path) -> None:
    """Let every tool keep its compiled modules, as an installed one does."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = str(folder)


SECTIONS = ("start-up", "kernel", "authoring", "medium", "long")


def options_of() -> argparse.Namespace:
    """Return the options."""
    data = Path(os.environ.get("ANIMTOOL_DATA", "data")) / "bvh"
    walk = ROOT / "samples" / "walk" / "walk.bvh"
    made = parser(__doc__, "bvh_to_usd.csv", runs=5)
    add = made.add_argument
    add("--sections", nargs="+", choices=SECTIONS, default=SECTIONS)
    add("--bpy-runs", type=int, default=1, help="runs of Blender on the long file")
    add("--start-up-runs", type=int, default=15)
    add("--frames", type=int, default=100_000, help="frames of the long file")
    add("--every", type=int, default=50, help="compare every nth frame of it")
    add("--kernel-mb", type=float, default=20, help="text for the row parser")
    add("--authoring-frames", type=int, default=10_000)
    add("--long-from", type=Path, default=data / "ad_jesse_dance.bvh")
    add("--medium", type=Path, default=data / "assimp_cmu_01_03.bvh")
    small = walk if walk.exists() else data / "ad_zombie.bvh"
    add("--small", type=Path, default=small)
    add("--python", default=sys.executable, help="interpreter with animtool")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    add("--pybvh-python", help="interpreter with pybvh; without it pybvh is skipped")
    add("--animtool", help="the command; by default the one beside --python")
    add("--work", type=Path, help="keep work files here instead of a temporary folder")
    options = made.parse_args()
    if options.animtool is None:
        options.animtool = str(Path(options.python).with_name("animtool"))
    return options


def main() -> None:
    """Measure, print the tables, write the CSV."""
    options = options_of()
    session = begin(
        options,
        (options.python, ["animtool", "usd-core", "numpy"]),
        (options.pybvh_python, ["pybvh", "numpy"]),
        (options.bpy_python, ["bpy", "numpy"]),
    )
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as temporary:
        work = (options.work or Path(temporary)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        keep_bytecode(work / "bytecode")
        bench = Bench(options, work)
        bench.run()
    session.finish(options.csv, bench.rows)


if __name__ == "__main__":
    main()
