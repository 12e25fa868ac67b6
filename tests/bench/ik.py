"""How fast and how surely animtool's inverse kinematics reaches, beside other tools.

Every tool gets the same problems in a process of its own, in turn, on one thread where
it lets itself be held to one; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from figures import HERE, Row, Wanted, machine, run, table, verdicts, write_csv
from ik_problems import Array, Case, Flags, read_cases
from ik_serve import Asked

OWN, SINGLE = "animtool", "animtool, a call each"
TOOLBOX, TRAC, MINK, PINK = "roboticstoolbox", "TRAC-IK", "mink", "Pink"
BLENDER = "Blender"
SOLVED, MEDIAN, NINETY_FIVE = "solved [%]", "median [us]", "95 % [us]"
MEAN, RATIO, COUNT = "mean [us]", "median / animtool [x]", "problems"
# The success of the data, limits included; hard problems count lengths in chains.
NEAR, LIMITS = Asked(1e-4, 1e-3, 50, 1.0), 1e-6
# Of one pose of a clip.
CLOSE = 1e-6
# Steps of a descent where the best is out of reach.
STEPS, PATIENCE = 100, 10
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
ALL = 10**9
WARM_UP = 30
TRAC_SECONDS = 0.02
# A run of so long is not repeated [s].
SLOW = 3.0


@dataclass(frozen=True)
class Answer:
    """What a tool made of a case: poses ``(B, Q)`` and their seconds ``(B,)``."""

    case: Case
    poses: Array
    seconds: Array

    def missed(self) -> Array:
        """Return the largest miss of each problem ``(B,)``, [m] or [rad]."""
        found = list(self.case.misses(self.poses).values())
        return np.asarray(np.max([rows.max(axis=1) for rows in found], axis=0))

    def solved(self, position: float, angle: float) -> Flags:
        """Return which problems miss what the best pose misses, within limits."""
        good = self.case.beyond_limits(self.poses) <= LIMITS
        good &= np.isfinite(self.poses).all(axis=1)
        for part, rows in self.case.misses(self.poses).items():
            bound = position if part == "pos" else angle
            if part in self.case.expected:
                good &= (np.abs(rows - self.case.expected[part]) <= bound).all(axis=1)
        return good


@dataclass
class Tool:
    """A tool's process, and what it can be asked.

    Attributes:
        name: In the tables.
        command: Starts it.
        trees: Takes models of any shape and goals of a part; else chains to one pose.
        balls: Keeps limits of ball joints.
        aims: Takes goals to aim.
        places: How near its kinematics are to the data's own [m], in matrices too.
        finest: The least tolerance that its numbers allow.
        seconds: Most time for one problem [s].
    """

    name: str
    command: list[str]
    trees: bool = True
    balls: bool = False
    aims: bool = False
    places: float = 1e-9
    finest: float = 0.0
    seconds: float = NEAR.seconds
    jobs: IO[str] = field(init=False, repr=False)
    answers: IO[str] = field(init=False, repr=False)

    def takes(self, case: Case, asked: Asked) -> bool:
        """Return whether it can be asked this."""
        if asked.position < self.finest or asked.angle < self.finest:
            return False
        if "aim" in case.targets and not self.aims:
            return False
        if not self.balls and any(
            joint["type"] == "ball" and joint.get("limits") for joint in case.joints
        ):
            return False
        pose = len(case.effectors) == 1 and set(case.targets) == {"pos", "rot"}
        return self.trees or pose

    def ask(self, file: Path, folder: Path, **job: Any) -> dict[str, Array]:
        """Return the arrays that answer a job."""
        out = folder / "answer.npz"
        job |= {"file": str(file), "out": str(out)}
        try:
            self.jobs.write(json.dumps(job) + "\n")
            self.jobs.flush()
            line = self.answers.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            sys.exit(f"{self.name} ended; what it said is above")
        with np.load(out) as arrays:
            return dict(arrays)


@contextmanager
def started(tool: Tool) -> Iterator[Tool]:
    """Run a tool's process."""
    paths = os.pathsep.join([str(HERE), str(HERE.parent)])
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    pipe = subprocess.PIPE
    environment = os.environ | threads | {"PYTHONPATH": paths}
    command = tool.command
    with subprocess.Popen(
        command, stdin=pipe, stdout=pipe, text=True, env=environment
    ) as process:
        assert process.stdin
        assert process.stdout
        tool.jobs, tool.answers = process.stdin, process.stdout
        yield tool


def tools(peer_python: str | None, bpy_python: str | None) -> list[Tool]:
    """Return the tools; those of others only with an interpreter that has them."""
    folder = HERE / "peers"
    own = [sys.executable, str(folder / "ik_animtool.py")]
    made = [Tool(OWN, own, balls=True, aims=True), Tool(SINGLE, [*own, "single"])]
    others = {TOOLBOX: "toolbox", TRAC: "trac", MINK: "mink", PINK: "pink"}
    if peer_python is None:
        print(f"  {', '.join(others)} skipped: no --peer-python", file=sys.stderr)
    else:
        for name, script in others.items():
            command = [peer_python, str(folder / f"ik_{script}.py")]
            # TRAC-IK ends by time alone.
            seconds = TRAC_SECONDS if name == TRAC else NEAR.seconds
            trees = name in (MINK, PINK)
            made.append(Tool(name, command, trees=trees, seconds=seconds))
    if bpy_python is None:
        print("  Blender skipped: no --bpy-python", file=sys.stderr)
    else:
        command = [bpy_python, str(folder / "ik_blender.py")]
        # Its poses are float32.
        made.append(Tool(BLENDER, command, trees=False, places=1e-5, finest=1e-5))
    return made


def reference_poses(data: Path, case: Case, poses: Array) -> tuple[Array, Array]:
    """Return effectors as the data's own kinematics have them, a pose at a time."""
    source = data / "reference_fk.py"
    spec = importlib.util.spec_from_file_location(source.stem, source)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    turns, points = [], []
    for pose in poses:
        frames = module.fk(case.model, pose)
        pairs = [
            module.effector_pose(case.model, effector, pose, frames)
            for effector in case.effectors
        ]
        turns.append([turn for turn, _ in pairs])
        points.append([point for _, point in pairs])
    return np.array(turns), np.array(points)


@dataclass
class Bench:
    """The tools, the data, and how much of it is asked.

    Attributes:
        running: Tools whose processes run.
        data: Folder of the problem sets.
        folder: For answers.
        runs: Of each section that is timed.
        most: Problems of a file.
        frames: Of a clip.
        trials: Problems for each tolerance.
        stride: Of the hard models that are asked.
    """

    running: list[Tool]
    data: Path
    folder: Path
    runs: int
    most: int
    frames: int
    trials: int
    stride: int
    checked: set[tuple[str, str, str]] = field(default_factory=set)

    def path(self, name: str) -> Path:
        """Return a file of the data."""
        return self.data / f"{name}.json"

    def cases(self, name: str) -> list[Case]:
        """Return a file's cases."""
        return read_cases(self.path(name))

    def answer(
        self, tool: Tool, name: str, index: int, case: Case, asked: Asked
    ) -> Answer:
        """Return what a tool makes of a case, after a look at its kinematics."""
        self._same_places(tool, name, index, case)
        asked = replace(asked, seconds=tool.seconds)
        clip = len(case.starts) == 1 < case.problems
        found = tool.ask(
            self.path(name),
            self.folder,
            case=index,
            what="follow" if clip else "solve",
            count=case.problems,
            asked=asdict(asked),
        )
        return Answer(case, found["poses"], found["seconds"])

    def _same_places(self, tool: Tool, name: str, index: int, case: Case) -> None:
        """Compare effectors in random poses with the data's own kinematics."""
        if (tool.name, name, case.name) in self.checked:
            return
        found = tool.ask(self.path(name), self.folder, case=index, what="places")
        turns, points = reference_poses(self.data, case, found["poses"])
        own_turns, own_points = case.effector_poses(found["poses"])
        for near, (other_turns, other_points) in (
            (1e-9, (own_turns, own_points)),
            (tool.places, (found["turns"], found["points"])),
        ):
            off = np.abs(other_points - points).max() / max(case.length, 1)
            off = max(off, np.abs(other_turns - turns).max())
            assert off < near, f"{tool.name} has another {case.name}, by {off:g}"
        self.checked.add((tool.name, name, case.name))

    def timed(self, name: str, case: Case, asked: Asked) -> dict[str, list[Answer]]:
        """Return every tool's answers, the tools in turn."""
        found: dict[str, list[Answer]] = {}
        able = [tool for tool in self.running if tool.takes(case, asked)]
        for _ in range(self.runs):
            for tool in able:
                before = found.get(tool.name)
                if before and before[0].seconds.sum() > SLOW:
                    continue
                # A process that slept is slow at first, which short batches show.
                self.answer(tool, name, 0, case.first(WARM_UP), asked)
                answer = self.answer(tool, name, 0, case, asked)
                found.setdefault(tool.name, []).append(answer)
        return found


def rows_of(
    section: str,
    answers: dict[str, list[Answer]],
    reached: tuple[float, float],
    wanted: dict[tuple[str, str], Wanted],
) -> list[Row]:
    """Return the figures of every tool, one value a run."""
    rows = []
    medians = {
        name: statistics.median(np.median(a.seconds) for a in found)
        for name, found in answers.items()
    }
    for name, found in answers.items():
        values: dict[str, list[float]] = {
            SOLVED: [100 * float(a.solved(*reached).mean()) for a in found],
            MEDIAN: [1e6 * float(np.median(a.seconds)) for a in found],
            NINETY_FIVE: [1e6 * float(np.percentile(a.seconds, 95)) for a in found],
            MEAN: [1e6 * float(a.seconds.mean()) for a in found],
            RATIO: [medians[name] / medians[OWN]],
        }
        rows += [
            Row(section, name, measure, figures, wanted.get((name, measure)))
            for measure, figures in values.items()
        ]
    return rows


def arms(bench: Bench) -> Iterator[list[Row]]:
    """Poses of arms, from a start that has nothing to do with them."""
    wanted = {(OWN, SOLVED): Wanted(True, 100)}
    wanted |= {(name, RATIO): Wanted(True, 1) for name in (TOOLBOX, TRAC)}
    for path in sorted(bench.data.glob("arm_*.json")):
        case = bench.cases(path.stem)[0].first(bench.most)
        answers = bench.timed(path.stem, case, NEAR)
        section = f"{path.stem.removeprefix('arm_')}, far start"
        yield rows_of(section, answers, (NEAR.position, NEAR.angle), wanted)


def bodies(bench: Bench) -> Iterator[list[Row]]:
    """Five effectors of a body, from a T pose."""
    wanted = {(OWN, SOLVED): Wanted(True, 100), (OWN, MEDIAN): Wanted(False, 500)}
    for kind in ("pin3", "ball"):
        name = f"humanoid_{kind}"
        case = bench.cases(name)[0].first(bench.most)
        answers = bench.timed(name, case, NEAR)
        reached = (NEAR.position, NEAR.angle)
        yield rows_of(f"humanoid, {kind}", answers, reached, wanted)


def clips(bench: Bench) -> Iterator[list[Row]]:
    """Frames of clips, each from the one before."""
    for section, name, times in (
        ("clip of panda", "clip_panda", 30),
        ("clip of humanoid, pin3", "clip_humanoid_pin3", 12),
    ):
        wanted = {(tool, RATIO): Wanted(True, times) for tool in (MINK, PINK)}
        wanted[OWN, SOLVED] = Wanted(True, 100)
        case = bench.cases(name)[0].first(bench.frames)
        asked = replace(NEAR, position=CLOSE, angle=CLOSE)
        answers = bench.timed(name, case, asked)
        answers.pop(SINGLE, None)
        yield rows_of(section, answers, (CLOSE, CLOSE), wanted)


def hard(bench: Bench) -> Iterator[list[Row]]:
    """Singular, unreachable, contradictory problems and long chains, once."""
    for name in ("hard", "hard_arm_limits", "hard_snake1000"):
        # A step of a quadratic program over a thousand joints takes seconds.
        names = {OWN} if name == "hard_snake1000" else {OWN, MINK, PINK}
        able = [tool for tool in bench.running if tool.name in names]
        found: dict[str, list[bool]] = {}
        for index, whole in [*enumerate(bench.cases(name))][:: bench.stride]:
            case = whole.first(bench.most)
            # A chain that only turns in place has no length.
            near = NEAR.position * (case.length or 1.0)
            asked = replace(NEAR, position=near, steps=STEPS, patience=PATIENCE)
            for tool in able:
                if tool.takes(case, asked):
                    answer = bench.answer(tool, name, index, case, asked)
                    good = answer.solved(near, NEAR.angle).tolist()
                    found.setdefault(tool.name, []).extend(good)
        rows = []
        for tool_name, good in found.items():
            wanted = Wanted(True, 100) if tool_name == OWN else None
            share = 100 * float(np.mean(good))
            rows.append(Row(name, tool_name, SOLVED, [share], wanted))
            rows.append(Row(name, tool_name, COUNT, [len(good)]))
        yield rows


def tolerances(bench: Bench) -> Iterator[list[Row]]:
    """Time and error over tolerances: what the plot shows."""
    for title, name in (
        ("panda", "arm_panda"),
        ("humanoid", "humanoid_pin3"),
        ("clip of panda", "clip_panda"),
        ("clip of humanoid", "clip_humanoid_pin3"),
    ):
        whole = bench.cases(name)[0]
        case = whole.first(bench.trials * (4 if len(whole.starts) == 1 else 1))
        rows: dict[str, list[Row]] = {part: [] for part in PARTS}
        for near in TOLERANCES:
            answers = bench.timed(name, case, replace(NEAR, position=near, angle=near))
            answers.pop(SINGLE, None)
            for tool, found in answers.items():
                for part, figure in PARTS.items():
                    values = [figure(answer, near) for answer in found]
                    row = Row(f"{title}: {part}", tool, f"{near:.0e}", values)
                    rows[part].append(row)
        yield from rows.values()


PARTS: dict[str, Callable[[Answer, float], float]] = {
    "time [us]": lambda answer, _: 1e6 * float(np.median(answer.seconds)),
    "error": lambda answer, _: float(np.median(answer.missed())),
    "within [%]": lambda answer, near: 100 * float(answer.solved(near, near).mean()),
}
SECTIONS = {
    "arms": arms,
    "bodies": bodies,
    "clips": clips,
    "hard": hard,
    "tolerances": tolerances,
}


def parser() -> argparse.ArgumentParser:
    """Return the options."""
    made = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("--peer-python", help="interpreter with the other tools, else they are skipped")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    add("--runs", type=int, default=3, help="runs of each tool; the median counts")
    add("--sections", nargs="+", choices=list(SECTIONS), default=list(SECTIONS))
    add("--quick", action="store_true", help="a part of the problems, once; no files")
    add("--csv", type=Path, default=HERE / "results" / "ik.csv")
    return made


def main() -> None:
    """Measure, print the tables, write the CSV and the plot."""
    options = parser().parse_args()
    if "ANIMTOOL_DATA" not in os.environ:
        sys.exit("ANIMTOOL_DATA names no folder")
    peers = "mink mujoco pin-pink pin daqp qpsolvers roboticstoolbox-python pytracik"
    about = machine(
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, [*peers.split(), "numpy"]),
        (options.bpy_python, ["bpy", "numpy"]),
    )
    rows: list[Row] = []
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory("animtool-bench"))
        running = [
            stack.enter_context(started(tool))
            for tool in tools(options.peer_python, options.bpy_python)
        ]
        bench = Bench(
            running,
            Path(os.environ["ANIMTOOL_DATA"]) / "ik",
            Path(folder),
            runs=1 if options.quick else options.runs,
            most=40 if options.quick else ALL,
            frames=200 if options.quick else ALL,
            trials=20 if options.quick else 100,
            stride=4 if options.quick else 1,
        )
        for name in options.sections:
            for found in SECTIONS[name](bench):
                print("\n".join([*table(found), ""]), flush=True)
                rows += found
    print("\n".join([*about, "", *verdicts(rows)]))
    if not options.quick:
        write_csv(options.csv, about, rows)
        draw(options)


def draw(options: argparse.Namespace) -> None:
    """Draw the curves of the CSV, where a peer brings what that needs."""
    if options.peer_python and "tolerances" in options.sections:
        plot = options.csv.with_suffix(".svg")
        script = str(HERE / "peers" / "ik_plot.py")
        command = [options.peer_python, script, str(options.csv), str(plot)]
        run(command, report=False)


if __name__ == "__main__":
    main()
