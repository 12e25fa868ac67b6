"""What a batch of many small takes costs, and what it loses, when it is killed.

Its processes are killed all at once, early and at half; it is interrupted, run twice at
a time, and run to its end. The outputs are compared with those of a run in peace.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from figures import HERE, Row, Wanted, machine, table, verdicts, write_csv

sys.path.insert(0, str(HERE.parent))
from support.bvh import random_rows, small_bvh

from animtool.batch.manifest import read_manifest

SEED = 0


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

    def start(self, *options: str) -> subprocess.Popen[bytes]:
        """Begin a run in a process group of its own."""
        command = [sys.executable, "-m", "animtool", "batch", str(self.takes)]
        command += ["-o", str(self.out / "{stem}.usdc"), "-j", str(self.jobs), "-q"]
        (self.out.parent / "said").mkdir(exist_ok=True)
        name = self.out.parent / f"said/{len(self.rows)}-{time.monotonic_ns()}"
        with name.open("wb") as said, Path(f"{name}.err").open("wb") as errors:
            return subprocess.Popen(
                [*command, "--format", "jsonl", *options],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=errors,
                start_new_session=True,
            )

    def recorded(self) -> set[str]:
        """Return the items that are recorded as made."""
        found = read_manifest(self.out / ".animtool/batch-batch.jsonl")
        assert not found.damaged
        return set(found.items)

    def size(self) -> int:
        """Return how many outputs there are."""
        if not self.out.is_dir():
            return 0
        with os.scandir(self.out) as entries:
            return sum(entry.name.endswith(".usdc") for entry in entries)

    def ended(
        self, step: str, process: subprocess.Popen[bytes], began: float, code: int
    ) -> None:
        """Wait for a run, and note what it took."""
        ended, peak = 0, 0.0
        while not ended:
            # What the system counts for a child begins with what its parent has.
            peak = max(peak, _peak(process.pid))
            time.sleep(0.01)
            ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        seconds = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == code, (step, process.returncode)
        before = self.made[-1] if self.made else set()
        now = self.recorded()
        self.made.append(now)
        spent = usage.ru_utime + usage.ru_stime
        self.rows += [
            Row(self.section, step, "whole [s]", [seconds]),
            Row(self.section, step, "of processors [s]", [spent]),
            Row(self.section, step, "peak memory [MB]", [peak / 1e6]),
            Row(self.section, step, "items made", [len(now - before)]),
            Row(self.section, step, "items left", [self.count - len(now)]),
        ]
        print("\n".join(table(self.rows[-5:])), flush=True)

    @property
    def count(self) -> int:
        """How many items there are."""
        return sum(1 for _ in self.takes.iterdir())

    def run(self, step: str, *options: str) -> None:
        """Run to the end."""
        began = time.perf_counter()
        self.ended(step, self.start(*options), began, 0)

    def kill(self, step: str, process: subprocess.Popen[bytes], began: float) -> None:
        """End a run, and all of its processes, at once."""
        os.killpg(process.pid, signal.SIGKILL)
        self.ended(step, process, began, -signal.SIGKILL)


def _peak(process: int) -> float:
    """Return the most memory that a process had [bytes]; 0 where it is gone."""
    try:
        text = Path(f"/proc/{process}/status").read_text("utf-8")
    except OSError:
        return 0.0
    found = [line for line in text.splitlines() if line.startswith("VmHWM:")]
    return 1024.0 * int(found[0].split()[1]) if found else 0.0


def killed(here: Folder, seconds: float) -> None:
    """Kill a run early, in a plan that takes so long, and one at half."""
    rng = np.random.default_rng(SEED)
    began = time.perf_counter()
    process = here.start()
    time.sleep(float(rng.uniform(0.4, 0.9)) * seconds)
    here.kill("killed early", process, began)
    began = time.perf_counter()
    process = here.start()
    while here.size() < here.count // 2:
        time.sleep(0.02)
    here.kill("killed at half", process, began)


def interrupted(here: Folder) -> None:
    """Interrupt a run as Ctrl-C does, and note how long it takes to end."""
    began = time.perf_counter()
    process, wanted = here.start(), here.size() + here.count // 10
    while here.size() < wanted:
        time.sleep(0.02)
    asked = time.perf_counter()
    os.killpg(process.pid, signal.SIGINT)
    here.ended("interrupted", process, began, 130)
    took = time.perf_counter() - asked
    here.rows.append(Row(here.section, "interrupted", "to its end [s]", [took]))


def at_once(here: Folder) -> None:
    """Run twice at a time: one is refused, and the other makes the rest."""
    began = time.perf_counter()
    first, second = here.start(), here.start()
    while first.poll() is None and second.poll() is None:
        time.sleep(0.02)
    refused, other = (first, second) if first.poll() is not None else (second, first)
    told = time.perf_counter() - began
    assert refused.returncode == 3
    here.ended("two at once", other, began, 0)
    here.rows.append(Row(here.section, "two at once", "one refused [s]", [told]))


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
    section, tool, none = here.section, "at the end", Wanted(False, 0)
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--takes", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--csv", type=Path, default=HERE / "results/batch_killed.csv")
    given = parser.parse_args()
    about = machine((sys.executable, ["animtool", "numpy", "usd-core", "filelock"]))
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as temporary:
        rows = measured(Path(temporary), given.takes, given.jobs)
    end = [row for row in rows if row.tool == "at the end"]
    print("\n".join([*table([row for row in rows if row not in end]), *table(end)]))
    print("\n".join(verdicts(rows)))
    write_csv(given.csv, about, rows)


if __name__ == "__main__":
    main()
