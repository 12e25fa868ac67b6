"""What the benchmarks share: figures, their tables, runs of processes, the machine.

Only the standard library is imported here, so that a process which measures stays
small: on Linux a child's peak memory begins at that of its parent.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
# What is installed keeps its bytecode, so what is measured does.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
RSS_UNIT = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class Wanted:
    """A bound on a figure."""

    at_least: bool
    bound: float

    def met(self, value: float) -> bool:
        """Return whether the value keeps it."""
        return value >= self.bound if self.at_least else value <= self.bound

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.bound:g}"


@dataclass(frozen=True)
class Row:
    """One figure: the median of its runs, and how far they spread."""

    section: str
    tool: str
    measure: str
    values: list[float]
    wanted: Wanted | None = None

    @property
    def median(self) -> float:
        """The figure."""
        return statistics.median(self.values)


@dataclass(frozen=True)
class Run:
    """What one process took, and what it printed.

    Attributes:
        seconds: From start to end.
        processor_seconds: Of its own and of the processes that it started, which other
            work on the machine hardly changes.
        peak_bytes: Of memory.
        report: What it printed.
    """

    seconds: float
    processor_seconds: float
    peak_bytes: int
    report: dict[str, Any]


def run(command: list[str], *, report: bool = True) -> Run:
    """Run a command to its end, and read the JSON object that it printed last."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        began = time.perf_counter()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=err
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            err.seek(0)
            sys.exit(f"{' '.join(command)}\n{err.read().decode(errors='replace')}")
        out.seek(0)
        found = _last_object("\n" + out.read().decode()) if report else {}
    spent = usage.ru_utime + usage.ru_stime
    return Run(seconds, spent, usage.ru_maxrss * RSS_UNIT, found)


def _last_object(text: str) -> dict[str, Any]:
    start = text.rindex("\n{") + 1
    found: dict[str, Any] = json.JSONDecoder().raw_decode(text[start:])[0]
    return found


def processor() -> str:
    """Return the model of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def machine(*interpreters: tuple[str | None, list[str]]) -> list[str]:
    """Return what the figures were measured on and with.

    Args:
        interpreters: Each with the packages whose versions count; None is skipped.
    """
    lines = [
        f"processor: {processor()}, {os.cpu_count()} cores",
        f"system: {platform.system()} {platform.machine()}",
    ]
    if hasattr(os, "getloadavg"):
        lines.append(f"load before the run: {os.getloadavg()[0]:.2f}")
    lines += [_versions(python, names) for python, names in interpreters if python]
    return lines


def _versions(python: str, packages: list[str]) -> str:
    code = (
        "import json, platform, sys; from importlib.metadata import version; "
        "found = {'Python': platform.python_version()}; "
        "found.update((name, version(name)) for name in sys.argv[1:]); "
        "print(json.dumps(found))"
    )
    found = run([python, "-c", code, *packages]).report
    names = [*packages, "Python"]
    return ", ".join(f"{name} {found[name]}" for name in names)


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    shown = f"{row.median:.3g}"
    if len(row.values) > 1 and row.measure.endswith("[s]"):
        shown += f" ({min(row.values):.3g}-{max(row.values):.3g})"
    return shown


def table(rows: list[Row]) -> list[str]:
    """Return a table of one section: a line a tool, a column a measure."""
    measures = list(dict.fromkeys(row.measure for row in rows))
    tools = list(dict.fromkeys(row.tool for row in rows))
    cells = {(row.tool, row.measure): row for row in rows}
    grid = [[rows[0].section, *measures]]
    for tool in tools:
        grid.append([tool, *(_cell(cells.get((tool, m))) for m in measures)])
    widths = [max(map(len, column)) for column in zip(*grid, strict=True)]
    return [
        "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True))
        for line in grid
    ]


def verdicts(rows: list[Row]) -> list[str]:
    """Return a line for every figure that has a bound."""
    lines = []
    for row in rows:
        if row.wanted is not None:
            word = "met" if row.wanted.met(row.median) else "MISSED"
            figure = f"{row.section}, {row.tool}, {row.measure}"
            lines.append(f"{word:6}  {figure}: {row.median:.3g} ({row.wanted})")
    return lines


def write_csv(path: Path, about: list[str], rows: list[Row]) -> None:
    """Write one line a figure, below what it was measured on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in about)
        writer = csv.writer(file, lineterminator="\n")
        names = "section tool measure median min max runs wanted met"
        writer.writerow(names.split())
        for row in rows:
            figures = [row.median, min(row.values), max(row.values)]
            met = "" if row.wanted is None else row.wanted.met(row.median)
            writer.writerow(
                [
                    row.section,
                    row.tool,
                    row.measure,
                    *(f"{figure:.5g}" for figure in figures),
                    len(row.values),
                    row.wanted or "",
                    {True: "yes", False: "no", "": ""}[met],
                ]
            )
