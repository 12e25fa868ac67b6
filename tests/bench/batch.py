"""How fast ``animtool batch`` is, what it costs a task, and what a lost process costs.

Whole processes, started fresh, beside pools of the standard library and a process for
each task. The takes are those of ``$ANIMTOOL_DATA/bvh``, as often as it needs.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from clock import Taken, now, since
from figures import Bound, Clock, Row, ratio_rows, time_rows
from measuring import HERE, ROOT, Run, begin, parser, run

from animtool.batch.discover import find_batch
from animtool.batch.ledger import locked_ledger
from animtool.batch.manifest import ItemRecord, record_file
from animtool.batch.plan import Planner
from animtool.batch.spec import BatchSpec, relative_name
from animtool.core.files.reading import FileState

SMALL = ROOT / "samples/batch/takes/left/wave1.bvh"
POOL = HERE / "peers/batch_pool.py"
PLANNED = (1_000, 10_000)
KILLS = 20

Report = dict[str, Any]


def batch(folder: Path, *options: object) -> Run:
    """Run a batch of a folder's takes."""
    command = [sys.executable, "-m", "animtool", "batch", str(folder / "takes")]
    out = ["-o", str(folder / "out/{stem}.usdc"), "--format", "json", "-q"]
    return run([*command, *out, *map(str, options)])


def copies(folder: Path, count: int) -> list[Path]:
    """Return so many real takes, copied."""
    data = Path(os.environ["ANIMTOOL_DATA"]) / "bvh"
    # Some are there because readers refuse them in part, with warnings.
    sources = sorted(data.glob("*.bvh"))
    (folder / "takes").mkdir(parents=True)
    made = []
    for i in range(count):
        path = folder / f"takes/take{i:05}.bvh"
        shutil.copyfile(sources[i % len(sources)], path)
        made.append(path)
    return made


def small(folder: Path, count: int) -> list[Path]:
    """Return so many small takes."""
    (folder / "takes").mkdir(parents=True)
    made = []
    for i in range(count):
        path = folder / f"takes/take{i:05}.bvh"
        shutil.copyfile(SMALL, path)
        made.append(path)
    return made


def spent(done: Run) -> float:
    """Return how long items took, summed [s]."""
    return sum(entry.get("seconds", 0.0) for entry in done.report["items"])


def many(folder: Path, count: int, runs: int) -> list[Row]:
    """Measure many real takes on one core and on two, and again."""
    copies(folder, count)
    section = f"{count} real takes"
    taken: dict[int, list[Taken]] = {1: [], 2: []}
    costs: list[float] = []
    for _ in range(runs):
        for jobs in (1, 2):
            shutil.rmtree(folder / "out", ignore_errors=True)
            done = batch(folder, "-j", jobs)
            assert done.report["done"] == count
            taken[jobs].append(done.taken)
            if jobs == 1:
                costs.append((done.report["seconds"] - spent(done)) / count * 1000)
    again = [batch(folder).taken for _ in range(runs)]
    faster = [one.wall / two.wall for one, two in zip(*taken.values(), strict=True)]
    above, bounds = "wall above the work, an item [ms]", (Bound(False, 5),)
    return [
        *time_rows(section, "-j 1", taken[1]),
        Row(section, "-j 1", above, costs, *bounds, clock=Clock.WALL),
        *time_rows(section, "-j 2", taken[2]),
        Row(section, "-j 2", "times as fast", faster, Bound(True, 1.8), Clock.WALL),
        *time_rows(section, "nothing changed", again, wanted=Bound(False, 1)),
    ]


def planned(folder: Path, count: int, runs: int) -> list[Row]:
    """Measure the plan of a batch in which all is up to date."""
    for path in small(folder, count):
        os.utime(path, ns=(10**18, 10**18))
    out = str(folder / "out/{stem}.usdc")
    found = find_batch(BatchSpec((str(folder / "takes"),), output=out))
    (folder / "out").mkdir()
    with locked_ledger(found.records_folder, found.name) as ledger:
        planner = Planner(found, ledger.history)
        for item in found.items:
            item.output.write_bytes(b"made")
            records = [
                record_file(path, relative_name(path, found.root), FileState.of(path))
                for path in (item.file.path, item.output)
            ]
            key = planner.record_key(item)
            ledger.add(
                ItemRecord(
                    key,
                    planner.settings_digest(item),
                    planner.versions,
                    (records[0],),
                    (records[1],),
                    2 * 10**18,
                )
            )
        ledger.merge_records(lambda _: True)
    size = (found.records_folder / "batch-batch.jsonl").stat().st_size
    done = [batch(folder, "-n") for _ in range(runs)]
    assert all(one.report["skipped"] == count for one in done)
    section, tool = "plan", f"{count} items"
    limit = Bound(False, 5) if count == max(PLANNED) else None
    return [
        *time_rows(section, tool, [one.taken for one in done], wanted=limit),
        Row(section, tool, "peak memory [MB]", [one.peak_bytes / 1e6 for one in done]),
        Row(section, tool, "bytes an item in the manifest", [size / count]),
    ]


def starts(folder: Path, count: int, runs: int) -> list[Row]:
    """Measure what small tasks cost beside pools and a process for each."""
    inputs = [str(path) for path in small(folder, count)]
    section, out = f"{count} small takes, 2 processes", str(folder / "out")
    command = [sys.executable, "-m", "animtool", "batch", str(folder / "takes")]
    pattern = ["-o", f"{out}/{{stem}}.usdc", "-q", "--format", "json", "-j", "2"]
    own = "animtool batch"
    tools = {
        own: [*command, *pattern],
        "animtool batch, one item": [*command, *pattern, "--items", "1"],
    }
    peers = {
        f"multiprocessing.Pool, {method}": [
            *(sys.executable, str(POOL), "pool", method, "2", out, "-1"),
            *inputs,
        ]
        for method in ("spawn", "forkserver", "fork")
    }
    taken: dict[str, list[Taken]] = {}
    for _ in range(runs):
        for tool, asked in (tools | peers).items():
            shutil.rmtree(out, ignore_errors=True)
            Path(out).mkdir()
            taken.setdefault(tool, []).append(run(asked).taken)
    rows = []
    for tool, runs_of in taken.items():
        rows += time_rows(section, tool, runs_of)
        rows += time_rows(section, tool, runs_of, unit="ms/task", per=count)
    for tool in peers:
        rows += ratio_rows(section, tool, taken[tool], taken[own])
    bake = [sys.executable, "-m", "animtool", "bake"]
    each = [run([*bake, p, "-o", f"{out}/alone{i}.usdc", "-q"], report=False).taken
            for i, p in enumerate(inputs[:5])]  # fmt: skip
    return rows + time_rows(section, "a process for each task", each, unit="ms/task")


READER = """
import os, signal, threading
from pathlib import Path
from animtool.core.readers import Reader
READER = Reader("takes in trouble", source="trouble_reader:open_trouble")
def open_trouble(path):
    word = Path(path).stem
    if word == "hang":
        threading.Event().wait()
    if word == "fill":
        held = []
        while True:
            held.append(bytearray(b"x" * 1_000_000))
    os.kill(os.getpid(), signal.SIGKILL if word == "kill" else signal.SIGSEGV)
"""


def plug_in(folder: Path) -> dict[str, str]:
    """Make a reader of takes that bring who opens them into trouble."""
    info = folder / "trouble_reader-1.dist-info"
    info.mkdir(parents=True)
    (folder / "trouble_reader.py").write_text(READER)
    head = "Metadata-Version: 2.1\nName: trouble-reader\nVersion: 1\n"
    (info / "METADATA").write_text(head)
    points = "[animtool.readers]\ntrouble = trouble_reader:READER\n"
    (info / "entry_points.txt").write_text(points)
    return {**os.environ, "PYTHONPATH": str(folder)}


def reported(folder: Path, environment: dict[str, str], *options: str) -> Report:
    """Run a batch of all that is in a folder's takes, and return its report."""
    command = [
        sys.executable,
        "-m",
        "animtool",
        "batch",
        f"{folder}/takes/*",
        "-j",
        "2",
    ]
    tail = ["-o", f"{folder}/made/{{stem}}.usdc", "--format", "json", "-q", *options]
    done = subprocess.run(
        [*command, *tail], capture_output=True, text=True, check=False, env=environment
    )
    found: Report = json.loads(done.stdout)
    return found


def accidents(folder: Path, count: int) -> list[Row]:
    """Count what is made where one crashes, one hangs, one fills, one is malformed."""
    for path in small(folder, count)[:4]:
        path.unlink()
    for word in ("crash", "hang", "fill"):
        (folder / f"takes/{word}.trouble").touch()
    (folder / "takes/malformed.bvh").write_text("HIERARCHY\n")
    environment = plug_in(folder / "plug")
    limits = ("--time-limit", "20", "--memory-limit", "700MB")
    first = reported(folder, environment, *limits)
    again = reported(folder, environment, *limits)
    section, tool = f"{count} items, 4 of them bad", "animtool batch"
    made, bad = Bound(True, count - 4), Bound(False, 4)
    redone = again["done"] + again["failed"]
    return [
        Row(section, tool, "made", [first["done"]], made),
        Row(section, tool, "failed", [first["failed"]], bad),
        Row(section, tool, "begun by the next run", [redone], bad),
    ]


def lost(folder: Path, count: int) -> list[Row]:
    """Count the tasks that are lost where one of them ends its process."""
    inputs = [str(path) for path in small(folder, count)]
    out = str(folder / "out")
    Path(out).mkdir()
    killed = str(count // 3)
    rows = []
    for kind in ("pool", "futures"):
        command = [sys.executable, str(POOL), kind, "spawn", "2", out, killed, *inputs]
        done = run(command).report["done"]
        rows.append(Row("one task kills its process", kind, "lost", [count - done]))
    environment = plug_in(folder / "plug")
    Path(inputs[count // 3]).rename(folder / "takes/kill.trouble")
    failed = reported(folder, environment)["failed"]
    tool = "animtool batch"
    wanted = Bound(False, 1)
    rows.append(Row("one task kills its process", tool, "lost", [failed], wanted))
    return rows


def resumed(folder: Path, count: int) -> list[Row]:
    """Kill a run at random moments, and count outputs that differ at the end."""
    small(folder, count)
    whole = folder / "whole"
    shutil.copytree(folder / "takes", whole / "takes")
    seconds = batch(whole, "-j", 2).taken.wall
    rng = np.random.default_rng(0)
    command = [sys.executable, "-m", "animtool", "batch", str(folder / "takes")]
    command += ["-o", str(folder / "out/{stem}.usdc"), "-q", "-j", "2"]
    stopped = 0
    for moment in rng.uniform(0.3, 1.0, KILLS) * seconds:
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            process.wait(moment)
            shutil.rmtree(folder / "out")
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            stopped += 1
        # The next run begins while processes of this one may still end.
    batch(folder, "-j", 2)
    names = {p.relative_to(whole / "out") for p in (whole / "out").rglob("*.usdc")}
    found = {p.relative_to(folder / "out") for p in (folder / "out").rglob("*")
             if p.is_file() and p.parent.name != ".animtool"}  # fmt: skip
    wrong = len(names ^ found) + sum(
        (whole / "out" / name).read_bytes() != (folder / "out" / name).read_bytes()
        for name in names & found
    )
    section = f"killed at random moments, {count} takes"
    return [
        Row(section, "animtool batch", "runs killed", [stopped]),
        Row(section, "animtool batch", "files wrong", [wrong], Bound(False, 0)),
    ]


def farmed(folder: Path, count: int, chunk: int) -> list[Row]:
    """Measure chunks of one batch: alone, after others, and several at once."""
    small(folder, count)
    section = f"{count} small takes in chunks of {chunk}"
    starts = range(1, count + 1, chunk)
    command = [sys.executable, "-m", "animtool", "batch", str(folder / "takes")]
    command += ["-o", str(folder / "out/{stem}.usdc"), "-q", "-j", "1", "--items"]
    alone = [
        run([*command, f"{first}+{chunk}", "--format", "json"]).taken
        for first in starts
    ]
    shutil.rmtree(folder / "out")
    began = now()
    together = [subprocess.Popen([*command, f"{first}+{chunk}"]) for first in starts]
    refused = sum(process.wait() != 0 for process in together)
    every = since(began)
    settled = batch(folder)
    assert settled.report["skipped"] == count
    return [
        *time_rows(section, "the first", alone[:1]),
        *time_rows(section, "the last", alone[-1:]),
        *time_rows(section, "all at once", [every]),
        Row(section, "all at once", "refused", [refused], Bound(False, 0)),
        *time_rows(section, "the whole, after", [settled.taken]),
    ]


def clustered(folder: Path, count: int) -> list[Row]:
    """Measure what a task costs by dask, beside processes of our own."""
    try:
        from distributed import LocalCluster
    except ModuleNotFoundError:
        print("dask is not measured: distributed is not installed")
        return []
    small(folder, count)
    section, rows = f"{count} small takes, 2 workers", list[Row]()
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as one:
        for executor in ("processes", f"dask={one.scheduler_address}"):
            shutil.rmtree(folder / "out", ignore_errors=True)
            done = batch(folder, "--executor", executor, "-j", "2")
            assert done.report["done"] == count
            each = (2 * done.report["seconds"] - spent(done)) / count * 1000
            tool = executor.partition("=")[0]
            measure = "wall above the work, an item [ms]"
            rows += time_rows(section, tool, [done.taken])
            rows.append(Row(section, tool, measure, [each], clock=Clock.WALL))
    return rows


def main() -> None:
    """Measure, print and store."""
    made = parser(__doc__, "batch.csv", runs=5)
    made.add_argument("--takes", type=int, default=200)
    options = made.parse_args()
    versions = ["animtool", "numpy", "usd-core", "filelock"]
    session = begin(options, (sys.executable, versions))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as temporary:
        folder = Path(temporary)
        some = max(1, options.runs // 2)
        rows += many(folder / "many", options.takes, options.runs)
        for count in PLANNED:
            rows += planned(folder / f"plan{count}", count, some)
        rows += starts(folder / "start", 20, options.runs)
        rows += lost(folder / "lost", 20)
        rows += farmed(folder / "farm", 2_000, 500)
        rows += clustered(folder / "cluster", 500)
        rows += accidents(folder / "bad", 200)
        rows += resumed(folder / "killed", 200)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
