"""How the benchmarks measure: runs in turn, processes, floors, the load of the machine.

Only the standard library is imported here, so that a process which measures stays
small: on Linux a child's peak memory begins at that of its parent.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clock import Taken, now, since, timed
from figures import Row, quotable, tables, verdicts, write_csv

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# What is installed keeps its bytecode, so what is measured does.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
RSS_UNIT = 1 if sys.platform == "darwin" else 1024
# Processors that others may keep busy on a machine that counts as idle.
IDLE = 0.15
# How long the load is looked at before the start [s].
LOOK = 3.0
# Of Linux's prctl: orphans below a process become its children.
SUBREAPER = 36
# What they may take to end [s].
ORPHANED = 10.0
# The flags of `animtool._kernels`.
FLAGS = ["-std=c++20", "-O3", "-DNDEBUG", "-ffp-contract=off", "-shared", "-fPIC"]
FLOOR, NATIVE = "plain C++ loop", "plain C++ loop, -march=native"
# One thread for libraries that read these as they load.
ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PXR_WORK_THREAD_LIMIT": "1",
}

Route = Callable[[], Taken]


@dataclass(frozen=True)
class Run:
    """What one process took, and what it printed.

    Attributes:
        taken: From start to end, and of the processes that it started.
        peak_bytes: Of memory.
        report: What it printed.
    """

    taken: Taken
    peak_bytes: int
    report: dict[str, Any]


def run(command: Sequence[str], *, report: bool = True) -> Run:
    """Run a command to its end, and read the JSON object that it printed last."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        others = _children()
        began = time.perf_counter()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=err
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - began
        orphans = _reaped(others)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            err.seek(0)
            sys.exit(f"{' '.join(command)}\n{err.read().decode(errors='replace')}")
        out.seek(0)
        found = _last_object("\n" + out.read().decode()) if report else {}
    taken = Taken(wall, usage.ru_utime + usage.ru_stime + orphans)
    return Run(taken, usage.ru_maxrss * RSS_UNIT, found)


def _children() -> set[int]:
    """Return the processes below this one, which takes in orphans from now on.

    A server that forks workers may outlive who started it: without this its time, and
    that of its workers, would be nobody's.
    """
    if sys.platform != "linux":
        return set()
    ctypes.CDLL(None).prctl(SUBREAPER, 1, 0, 0, 0)
    tasks = Path("/proc/self/task").glob("*/children")
    return {int(pid) for path in tasks for pid in path.read_text("ascii").split()}


def _reaped(others: set[int]) -> float:
    """Wait for orphans, and return their CPU time and that of their children [s]."""
    spent, until = 0.0, time.perf_counter() + ORPHANED
    while (left := _children() - others) and time.perf_counter() < until:
        for pid in left:
            ended, _, usage = os.wait4(pid, os.WNOHANG)
            if ended:
                spent += usage.ru_utime + usage.ru_stime
        time.sleep(0.001)
    return spent


def _last_object(text: str) -> dict[str, Any]:
    start = text.rindex("\n{") + 1
    found: dict[str, Any] = json.JSONDecoder().raw_decode(text[start:])[0]
    return found


def run_peer(python: str, script: str, *arguments: object) -> dict[str, Any]:
    """Run a script of `peers`, which finds `clock`, and return what it printed."""
    command = [python, str(HERE / "peers" / script), *map(str, arguments)]
    return run(["env", f"PYTHONPATH={HERE}", *command]).report


def taken_of(report: Mapping[str, Any], key: str = "taken") -> list[Taken]:
    """Return the times that a peer printed."""
    return [Taken(*pair) for pair in report[key]]


def in_turn(routes: Mapping[str, Route], runs: int) -> dict[str, list[Taken]]:
    """Return what each route took, A B C A B C, behind a round that warms up."""
    taken: dict[str, list[Taken]] = {name: [] for name in routes}
    for i in range(-1, runs):
        for name, route in routes.items():
            once = route()
            if i >= 0:
                taken[name].append(once)
    for name, runs_of in taken.items():
        shown = sorted(one.wall for one in runs_of)[len(runs_of) // 2]
        print(f"  {name}: {shown:.4g} s", file=sys.stderr)
    return taken


def in_process(work: Callable[[], object]) -> Route:
    """Return work of this process as a route."""
    return lambda: timed(work)


def floors(compiler: str | None, folder: Path) -> dict[str, ctypes.CDLL]:
    """Build the plain loops by the flags of animtool, and for this very processor."""
    found = compiler and shutil.which(compiler)
    if not found:
        print("  plain C++ loops skipped: no --compiler", file=sys.stderr)
        return {}
    made = {}
    for name, more in ((FLOOR, []), (NATIVE, ["-march=native"])):
        library = folder / f"floors{len(made)}.so"
        source = str(HERE / "peers" / "floors.cpp")
        command = [found, *FLAGS, *more, source, "-o", str(library)]
        subprocess.run(command, check=True)
        made[name] = ctypes.CDLL(str(library))
    return made


def floor_work(library: ctypes.CDLL, name: str, *arguments: Any) -> Callable[[], None]:
    """Return a loop of `floors.cpp` on arrays of float64 and int64, and numbers."""
    given: list[Any] = []
    for one in arguments:
        if isinstance(one, int):
            given.append(ctypes.c_int64(one))
        elif isinstance(one, float):
            given.append(ctypes.c_double(one))
        else:
            assert one.flags.c_contiguous
            assert str(one.dtype) in {"float64", "int64"}, (name, one.dtype)
            given.append(ctypes.c_void_p(one.ctypes.data))
    function = getattr(library, name)
    function.restype = None

    def work() -> None:
        # The arrays live as long as this.
        assert arguments
        function(*given)

    return work


def on_one_thread() -> None:
    """Start again with libraries that use one thread, unless they do."""
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)


def parser(about: str | None, csv: str, runs: int) -> argparse.ArgumentParser:
    """Return the options that every benchmark has.

    Args:
        about: The docstring of the script.
        csv: Its name below `results`.
        runs: Of each tool.
    """
    made = argparse.ArgumentParser(
        description=about.splitlines()[0] if about else None,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("--runs", type=int, default=runs, help="runs of each tool; the median counts")
    add("--csv", type=Path, default=HERE / "results" / csv)
    add(
        "--under-load",
        action="store_true",
        help="measure on a busy machine; only ratios of CPU time are quoted then",
    )
    return made


def busy() -> float | None:
    """Return CPU seconds of all processes since the start of the machine [s].

    What the host of a virtual machine took away counts too. None where unknown.
    """
    stat = Path("/proc/stat")
    if not stat.exists():
        return None
    user, nice, system, _, _, irq, soft, steal, *_ = map(
        int, stat.read_text("ascii").splitlines()[0].split()[1:]
    )
    return (user + nice + system + irq + soft + steal) / os.sysconf("SC_CLK_TCK")


def load_of_others(began: Taken, before: float | None) -> float:
    """Return how many processors other work kept busy since a moment."""
    after = busy()
    if before is None or after is None:
        return os.getloadavg()[0]
    taken = since(began)
    return max(0.0, (after - before - taken.cpu) / taken.wall)


@dataclass
class Session:
    """One run of a benchmark, on a machine whose load is known.

    Attributes:
        about: What the figures were measured on and with.
        before: Processors that others kept busy before the start.
    """

    about: list[str]
    before: float
    began: Taken = field(default_factory=now)
    ticks: float | None = field(default_factory=busy)

    def finish(self, path: Path | None, rows: Sequence[Row]) -> None:
        """Print tables and verdicts, and write the CSV."""
        during = load_of_others(self.began, self.ticks)
        loaded = max(self.before, during) > IDLE
        rows = quotable(rows, loaded=loaded)
        about = [
            *self.about,
            f"processors that other work kept busy: {self.before:.2f} before the run, "
            f"{during:.2f} in it{', so under load' if loaded else ''}",
        ]
        listed = verdicts(rows, loaded=loaded)
        print("\n".join([*about, "", *tables(rows), *listed]), flush=True)
        if path is not None:
            write_csv(path, about, rows, loaded=loaded)


def draw(python: str, source: Path, *measures: str) -> None:
    """Draw time against errors from a CSV, where the interpreter has matplotlib.

    Args:
        python: Its path.
        source: The CSV; the plot is written beside it.
        measures: What the names of the errors begin with.
    """
    known = [python, "-c", "import matplotlib"]
    if subprocess.run(known, capture_output=True, check=False).returncode:
        print(f"no plot was drawn: {python} has no matplotlib", file=sys.stderr)
        return
    script, plot = HERE / "peers" / "error_plot.py", source.with_suffix(".svg")
    run([python, str(script), str(source), str(plot), *measures], report=False)


def begin(
    options: argparse.Namespace,
    *interpreters: tuple[str | None, list[str]],
    notes: Sequence[str] = (),
    clocked: bool = True,
) -> Session:
    """Look at the load and the versions; leave where the machine is busy.

    Args:
        options: Of `parser`.
        interpreters: Each with the packages whose versions count; without one, the
            first of them is said to be left out.
        notes: What else the CSV is to say.
        clocked: Whether anything is timed, so that the load matters.
    """
    began, before = now(), busy()
    time.sleep(LOOK if clocked else 0.1)
    load = load_of_others(began, before)
    if clocked and load > IDLE and not options.under_load:
        sys.exit(
            f"other work keeps {load:.2f} processors busy, more than {IDLE}: wait "
            "until it ends, or give --under-load to compare CPU times alone"
        )
    lines = [
        f"processor: {_processor()}, {os.cpu_count()} cores",
        f"system: {platform.system()} {platform.machine()}",
        f"date: {datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        f"commit: {_commit()}",
        *(["ANIMTOOL_PORTABLE is set"] if "ANIMTOOL_PORTABLE" in os.environ else []),
        *(_versions(python, names) for python, names in interpreters),
        *notes,
    ]
    return Session(lines, load)


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str:
    """Return the last commit that changed the library, and whether it was changed."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(ROOT), *arguments, "--", "animtool"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    changed = " with changes" if git("status", "--porcelain") else ""
    return f"{git('log', '-1', '--format=%h') or 'unknown'} of animtool/{changed}"


def _versions(python: str | None, packages: list[str]) -> str:
    if not python:
        return f"left out, no interpreter was given: {packages[0]}"
    code = (
        "import json, platform, sys; from importlib.metadata import version; "
        "found = {'Python': platform.python_version()}; "
        "found.update((name, version(name)) for name in sys.argv[1:]); "
        "print(json.dumps(found))"
    )
    found = run([python, "-c", code, *packages]).report
    names = [*packages, "Python"]
    return ", ".join(f"{name} {found[name]}" for name in names)
