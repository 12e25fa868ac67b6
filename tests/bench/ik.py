"""How fast and how surely animtool's inverse kinematics reaches, beside other tools.

Every tool gets the same problems in a process of its own, in turn, on one thread where
it lets itself be held to one; see README.md beside this file.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Clock, Row, ratio_rows, tables, time_rows
from ik_problems import Array, Case, Flags, read_cases
from ik_serve import Asked
from ik_tools import MINK, NEAR, OWN, PINK, SINGLE, TOOLBOX, TRAC, Tool, started, tools
from measuring import HERE, begin, parser, run

SOLVED, COUNT = "solved [%]", "problems"
MEDIAN, NINETY_FIVE = "median wall [us]", "95 % wall [us]"
# What a ratio needs: a tool that gives up early is quick.
SURE_ENOUGH = Bound(at_least=True, bound=95.0)
# How far beyond its limits a joint may be.
LIMITS = 1e-6
# Of one pose of a clip.
CLOSE = 1e-6
# Steps of a descent where the best is out of reach.
STEPS, TIMEOUT = 100, 10
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
ALL = 10**9
WARM_UP = 30
# A run of so long is not repeated [s].
SLOW = 3.0


@dataclass(frozen=True)
class Answer:
    """What a tool made of a case: poses ``(B, Q)``, and what each took ``(B,)`` [s]."""

    case: Case
    poses: Array
    wall: Array
    cpu: Array

    @property
    def mean(self) -> Taken:
        """What a problem took on average: their sum is the whole call or loop."""
        return Taken(float(self.wall.mean()), float(self.cpu.mean()))

    @property
    def median(self) -> Taken:
        """What the middle problem took."""
        return Taken(float(np.median(self.wall)), float(np.median(self.cpu)))

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
        return Answer(case, found["poses"], found["wall"], found["cpu"])

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

    def timed(
        self, name: str, case: Case, asked: Asked, *, without: str = ""
    ) -> dict[str, list[Answer]]:
        """Return every tool's answers, the tools in turn."""
        found: dict[str, list[Answer]] = {}
        able = [
            tool
            for tool in self.running
            if tool.takes(case, asked) and tool.name != without
        ]
        for _ in range(self.runs):
            for tool in able:
                before = found.get(tool.name)
                if before and before[0].wall.sum() > SLOW:
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
    wanted: dict[tuple[str, str], Bound],
) -> list[Row]:
    """Return the figures of every tool, one value a run.

    Peers take a pose a call. So they are compared with animtool called as they are, by
    the middle problem, and by all problems with one call of animtool's.
    """
    rows = []
    for name, found in answers.items():
        solved = [100 * float(a.solved(*reached).mean()) for a in found]
        rows.append(Row(section, name, SOLVED, solved, wanted.get((name, SOLVED))))
        for measure, share in ((MEDIAN, 50), (NINETY_FIVE, 95)):
            values = [1e6 * float(np.percentile(a.wall, share)) for a in found]
            bound = wanted.get((name, measure))
            rows.append(Row(section, name, measure, values, bound, Clock.WALL))
        rows += time_rows(section, name, [a.mean for a in found], unit="us")
        near = [Accuracy(SOLVED, float(np.median(solved)), SURE_ENOUGH)]
        for own, figure in ((OWN, "mean"), (SINGLE, "median")):
            if name in (OWN, own) or own not in answers:
                continue
            taken, base = (
                [getattr(a, figure) for a in answers[tool]] for tool in (name, own)
            )
            bound = wanted.get((name, own))
            rows += ratio_rows(
                section, name, taken, base, name=own, wanted=bound, accuracy=near
            )
    return rows


def arms(bench: Bench) -> Iterator[list[Row]]:
    """Poses of arms, from a start that has nothing to do with them."""
    wanted = {(OWN, SOLVED): Bound(True, 100)}
    ahead, same = Bound(True, 1), (TOOLBOX, TRAC)
    wanted |= {(name, own): ahead for name in same for own in (OWN, SINGLE)}
    for path in sorted(bench.data.glob("arm_*.json")):
        case = bench.cases(path.stem)[0].first(bench.most)
        answers = bench.timed(path.stem, case, NEAR)
        section = f"{path.stem.removeprefix('arm_')}, far start"
        yield rows_of(section, answers, (NEAR.position, NEAR.angle), wanted)


def bodies(bench: Bench) -> Iterator[list[Row]]:
    """Five effectors of a body, from a T pose."""
    wanted = {
        (OWN, SOLVED): Bound(True, 100),
        (OWN, MEDIAN): Bound(False, 500),
    }
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
        wanted = {(tool, OWN): Bound(True, times) for tool in (MINK, PINK)}
        wanted |= {(tool, SINGLE): Bound(True, 1) for tool in (TOOLBOX, MINK, PINK)}
        wanted[OWN, SOLVED] = Bound(True, 100)
        case = bench.cases(name)[0].first(bench.frames)
        asked = replace(NEAR, position=CLOSE, angle=CLOSE)
        answers = bench.timed(name, case, asked)
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
            asked = replace(NEAR, position=near, steps=STEPS, timeout=TIMEOUT)
            for tool in able:
                if tool.takes(case, asked):
                    answer = bench.answer(tool, name, index, case, asked)
                    good = answer.solved(near, NEAR.angle).tolist()
                    found.setdefault(tool.name, []).extend(good)
        rows = []
        for tool_name, good in found.items():
            wanted = Bound(True, 100) if tool_name == OWN else None
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
            asked = replace(NEAR, position=near, angle=near)
            answers = bench.timed(name, case, asked, without=SINGLE)
            for tool, found in answers.items():
                for part, figure in PARTS.items():
                    values = [figure(answer, near) for answer in found]
                    measure = f"{near:.0e}"
                    row = Row(
                        f"{title}: {part}", tool, measure, values, clock=CLOCKS[part]
                    )
                    rows[part].append(row)
        yield from rows.values()


PARTS: dict[str, Callable[[Answer, float], float]] = {
    "wall [us]": lambda answer, _: 1e6 * answer.median.wall,
    "CPU [us]": lambda answer, _: 1e6 * answer.median.cpu,
    "error": lambda answer, _: float(np.median(answer.missed())),
    "within [%]": lambda answer, near: 100 * float(answer.solved(near, near).mean()),
}
CLOCKS = dict(zip(PARTS, (Clock.WALL, Clock.CPU, Clock.NONE, Clock.NONE), strict=True))
SECTIONS = {
    "arms": arms,
    "bodies": bodies,
    "clips": clips,
    "hard": hard,
    "tolerances": tolerances,
}


def main() -> None:
    """Measure, print the tables, write the CSV and the plot."""
    made = parser(__doc__, "ik.csv", runs=3)
    add = made.add_argument
    add("--peer-python", help="interpreter with the other tools, else they are skipped")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    add("--sections", nargs="+", choices=list(SECTIONS), default=list(SECTIONS))
    add("--quick", action="store_true", help="a part of the problems, once; no files")
    options = made.parse_args()
    if "ANIMTOOL_DATA" not in os.environ:
        sys.exit("ANIMTOOL_DATA names no folder")
    peers = "mink mujoco pin-pink pin daqp qpsolvers roboticstoolbox-python pytracik"
    session = begin(
        options,
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
                print("\n".join(tables(found)), file=sys.stderr, flush=True)
                rows += found
    session.finish(None if options.quick else options.csv, rows)
    if not options.quick and options.peer_python and "tolerances" in options.sections:
        plot = options.csv.with_suffix(".svg")
        script = str(HERE / "peers" / "ik_plot.py")
        command = [options.peer_python, script, str(options.csv), str(plot)]
        run(command, report=False)


if __name__ == "__main__":
    main()
