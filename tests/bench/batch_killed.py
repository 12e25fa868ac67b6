"""What a batch of many small takes costs, and what it loses, when it is killed.

Its processes are killed all at once, early and at half; it is interrupted, run twice at
a time, and run to its end. The outputs are compared with those of a run in peace.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Bound, Clock, Row, tables, time_rows
from measuring import HERE, begin, parser

sys.path.insert(0, str(HERE.parent))
from support.bvh import random_rows, small_bvh

from animtool.batch.manifest import read_manifest

SEED = 0
# How often the processes of a run are looked at [s].
LOOKED = 0.1


@dataclass
class Going:
    """A run that goes on.

    Attributes:
        process: The leader of its processes.
        began: When.
        peaks: The most memory that each of its processes had [bytes].
        spent: Time of processors that each took [s].
    """

    process: subprocess.Popen[bytes]
    began: float = field(default_factory=time.perf_counter)
    peaks: dict[int, float] = field(default_factory=dict)
    spent: dict[int, float] = field(default_factory=dict)

    def watch(self, until: Callable[[], bool]) -> None:
        """Look at its processes until something is so."""
        looked = 0.0
        while not until():
            if time.perf_counter() - looked > LOOKED:
                self._look()
                looked = time.perf_counter()
            time.sleep(0.01)

    def _look(self) -> None:
        for place in Path("/proc").glob("[0-9]*"):
            try:
                stat = (place / "stat").read_text("utf-8").rpartition(")")[2].split()
                lines = (place / "status").read_text("utf-8").splitlines()
            except OSError:
                continue
            if int(stat[2]) != self.process.pid:
                continue
            number, ticks = int(place.name), int(stat[11]) + int(stat[12])
            self.spent[number] = ticks / os.sysconf("SC_CLK_TCK")
            found = [line for line in lines if line.startswith("VmHWM:")]
            if found:
                self.peaks[number] = 1024.0 * int(found[0].split()[1])

    def has_ended(self) -> bool:
        """Return whether it has."""
        return self.process.poll() is not None


@dataclass
class Folder:
    """Takes, and where they are baked to.

    Attributes:
        takes: The folder of the inputs.
        out: That of the outputs.
        jobs: How many processes make them.
        made: Of each run, the items that it recorded as made.
        rows: The figures.
    """

    takes: Path
    out: Path
    jobs: int
    section: str
    made: list[set[str]] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)

    def start(self, *options: str) -> Going:
        """Begin a run in a process group of its own."""
        command = [sys.executable, "-m", "animtool", "batch", str(self.takes)]
        command += ["-o", str(self.out / "{stem}.usdc"), "-j", str(self.jobs), "-q"]
        (self.out.parent / "said").mkdir(exist_ok=True)
        name = self.out.parent / f"said/{len(self.rows)}-{time.monotonic_ns()}"
        with name.open("wb") as said, Path(f"{name}.err").open("wb") as errors:
            process = subprocess.Popen(
                [*command, "--format", "jsonl", *options],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=errors,
                start_new_session=True,
            )
        return Going(process)

    def recorded(self) -> set[str]:
        """Return the items that are recorded as made."""
        found = read_manifest(self.out / ".animtool/batch-batch.jsonl")
        assert not found.damage_warnings
        return set(found.items)

    def size(self) -> int:
        """Return how many outputs there are."""
        if not self.out.is_dir():
            return 0
        with os.scandir(self.out) as entries:
            return sum(entry.name.endswith(".usdc") for entry in entries)

    def ended(self, step: str, going: Going, code: int) -> None:
        """Wait for a run, and note what it took."""
        going.watch(going.has_ended)
        seconds = time.perf_counter() - going.began
        assert going.process.returncode == code, (step, going.process.returncode)
        before = self.made[-1] if self.made else set()
        now = self.recorded()
        self.made.append(now)
        spent = sum(going.spent.values())
        peak = max(going.peaks.values(), default=0.0)
        self.rows += [
            *time_rows(self.section, step, [Taken(seconds, spent)]),
            Row(self.section, step, "peak memory [MB]", [peak / 1e6]),
            Row(self.section, step, "items made", [len(now - before)]),
            Row(self.section, step, "items left", [self.count - len(now)]),
        ]
        print("\n".join(tables(self.rows[-5:])), file=sys.stderr, flush=True)

    @property
    def count(self) -> int:
        """How many items there are."""
        return sum(1 for _ in self.takes.iterdir())

    def run(self, step: str, *options: str) -> None:
        """Run to the end."""
        self.ended(step, self.start(*options), 0)


def killed(here: Folder, seconds: float) -> None:
    """Kill all processes of a run early, in a plan that takes so long, and at half."""
    moment = float(np.random.default_rng(SEED).uniform(0.4, 0.9)) * seconds
    going = here.start()
    going.watch(lambda: time.perf_counter() - going.began > moment)
    os.killpg(going.process.pid, signal.SIGKILL)
    here.ended("killed early", going, -signal.SIGKILL)
    half = here.start()
    half.watch(lambda: here.size() >= here.count // 2)
    os.killpg(half.process.pid, signal.SIGKILL)
    here.ended("killed at half", half, -signal.SIGKILL)


def interrupted(here: Folder) -> None:
    """Interrupt a run as Ctrl-C does, and note how long it takes to end."""
    going, wanted = here.start(), here.size() + here.count // 10
    going.watch(lambda: here.size() >= wanted)
    asked = time.perf_counter()
    os.killpg(going.process.pid, signal.SIGINT)
    here.ended("interrupted", going, 130)
    took = time.perf_counter() - asked
    here.rows.append(
        Row(here.section, "interrupted", "to its end [s]", [took], clock=Clock.WALL)
    )


def at_once(here: Folder) -> None:
    """Run twice at a time: one is refused, and the other makes the rest."""
    both = [here.start(), here.start()]
    both[0].watch(lambda: any(going.has_ended() for going in both))
    told = time.perf_counter() - both[0].began
    both.sort(key=lambda going: not going.has_ended())
    assert both[0].process.returncode == 3
    here.ended("two at once", both[1], 0)
    here.rows.append(
        Row(here.section, "two at once", "one refused [s]", [told], clock=Clock.WALL)
    )


def checked(here: Folder, clean: Folder) -> list[Row]:
    """Return how many outputs and records of runs that were ended are wrong."""
    names = [{path.name for path in f.out.glob("*.usdc")} for f in (clean, here)]
    differing = sum(
        (clean.out / name).read_bytes() != (here.out / name).read_bytes()
        for name in names[0] & names[1]
    )
    lost = sum(len(a - b) for a, b in zip(here.made, here.made[1:], strict=False))
    # An item is told when it is recorded; the last line of a killed run may be torn.
    done = [
        json.loads(line)["output"]
        for path in (here.out.parent / "said").glob("*[0-9]")
        for line in path.read_text("utf-8").splitlines()
        if '"status": "done"' in line and line.endswith("}")
    ]
    twice = len(done) - len(set(done))
    left = [path for path in here.out.rglob(".animtool-*") if path.is_file()]
    section, tool, none = here.section, "at the end", Bound(False, 0)
    return [
        Row(section, tool, "outputs missing", [here.count - len(names[1])], none),
        Row(section, tool, "outputs that differ", [differing], none),
        Row(section, tool, "records lost", [lost], none),
        Row(section, tool, "items made twice", [twice], none),
        Row(section, tool, "files left over", [len(left)], none),
    ]


def measured(folder: Path, count: int, jobs: int) -> list[Row]:
    """Return the figures of so many takes."""
    takes = folder / "takes"
    takes.mkdir()
    for i in range(count):
        text = small_bvh(random_rows(2, seed=i))
        (takes / f"take{i:05}.bvh").write_text(text, "utf-8")
    section = f"{count} takes of 2 frames, -j {jobs}"
    places = [folder / name / "out" for name in ("clean", "killed")]
    for place in places:
        place.parent.mkdir()
    clean, here = (Folder(takes, place, jobs, section) for place in places)
    clean.out.mkdir()
    clean.run("planned, nothing made", "-n")
    planning = clean.rows[0].median
    clean.run("in peace")
    clean.run("nothing changed")
    killed(here, planning)
    interrupted(here)
    at_once(here)
    here.run("nothing changed, after that")
    return [*clean.rows, *here.rows, *checked(here, clean)]


def main() -> None:
    """Measure, print and store."""
    made = parser(__doc__, "batch_killed.csv", runs=1)
    made.add_argument("--takes", type=int, default=10_000)
    made.add_argument("--jobs", type=int, default=2)
    options = made.parse_args()
    # Shells let what they start in the background ignore it, and so would the runs.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    versions = ["animtool", "numpy", "usd-core", "filelock"]
    session = begin(options, (sys.executable, versions))
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as temporary:
        rows = measured(Path(temporary), options.takes, options.jobs)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
