"""Figures of the benchmarks: what they are compared by, their tables and CSV.

`measuring.py` makes them. Only the standard library is imported here, so that a process
which measures stays small: on Linux a child's peak memory begins at that of its parent.
"""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from clock import Taken

COLUMNS = "section tool measure clock median min max runs wanted met load note"


class Clock(StrEnum):
    """What a figure was timed by; other work on a machine changes wall time most."""

    NONE = ""
    WALL = "wall"
    CPU = "cpu"


@dataclass(frozen=True)
class Bound:
    """A bound on a figure."""

    at_least: bool
    bound: float

    def met(self, value: float) -> bool:
        """Return whether the value keeps it; one that is no number does not."""
        return value >= self.bound if self.at_least else value <= self.bound

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.bound:g}"


@dataclass(frozen=True)
class Accuracy:
    """How near a tool came, and how near it must come to be compared in speed.

    Attributes:
        measure: What was measured, with its unit.
        value: Of the tool.
        needed: What a ratio needs.
    """

    measure: str
    value: float
    needed: Bound

    def fault(self) -> str:
        """Return why the tool is not compared, or nothing where it is.

        The one place that decides it for all benchmarks: a run that diverged or is
        further off than `needed` did other work, and its time says nothing.
        """
        if not math.isfinite(self.value):
            return f"diverged: {self.measure} is {self.value}"
        if not self.needed.met(self.value):
            return f"{self.measure} is {self.value:.4g}, a ratio needs {self.needed}"
        return ""


@dataclass(frozen=True)
class Row:
    """One figure: the median of its runs, and how far they spread.

    Attributes:
        section: Of the table.
        tool: A line of it.
        measure: A column of it, with its unit.
        values: One a run; none where there is no figure.
        wanted: A bound.
        clock: What it was timed by.
        ratio: Whether it compares two tools.
        note: Why there is no figure.
    """

    section: str
    tool: str
    measure: str
    values: Sequence[float]
    wanted: Bound | None = None
    clock: Clock = Clock.NONE
    ratio: bool = False
    note: str = ""

    @property
    def median(self) -> float:
        """The figure; NaN where there is none."""
        return statistics.median(self.values) if self.values else math.nan

    def met(self, *, loaded: bool) -> str:
        """Return whether its bound is met, in a word; of wall time only when idle."""
        if not self.values:
            return "no ratio"
        if self.wanted is None:
            return ""
        if loaded and self.clock is Clock.WALL:
            return "under load"
        return "yes" if self.wanted.met(self.median) else "no"


def time_rows(
    section: str,
    tool: str,
    taken: Sequence[Taken],
    *,
    unit: str = "s",
    per: float = 1.0,
    wanted: Bound | None = None,
) -> list[Row]:
    """Return wall and CPU time beside each other.

    Args:
        section: Of the table.
        tool: A line of it.
        taken: What each run took.
        unit: Of the figures: s, ms, us or ns, and what it is a share of.
        per: How many shares of that kind a run has.
        wanted: A bound on wall time.
    """
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit.partition("/")[0]] / per
    walls = [one.wall * scale for one in taken]
    cpus = [one.cpu * scale for one in taken]
    return [
        Row(section, tool, f"wall [{unit}]", walls, wanted, Clock.WALL),
        Row(section, tool, f"CPU [{unit}]", cpus, clock=Clock.CPU),
    ]


def ratio_rows(
    section: str,
    tool: str,
    taken: Sequence[Taken],
    base: Sequence[Taken],
    *,
    name: str = "animtool",
    wanted: Bound | None = None,
    accuracy: Iterable[Accuracy] = (),
) -> list[Row]:
    """Return how many times as long a tool takes as another, run by run in turn.

    Args:
        section: Of the table.
        tool: A line of it.
        taken: What each of its runs took.
        base: What the runs of the other took, each after or before the same run.
        name: Of the other.
        wanted: A bound on both ratios.
        accuracy: How near the tool came; where that is not near enough, no ratio.
    """
    faults = "; ".join(filter(None, (one.fault() for one in accuracy)))
    pairs = [] if faults else list(zip(taken, base, strict=False))
    made = []
    for title, clock in (("wall", Clock.WALL), ("CPU", Clock.CPU)):
        values = [getattr(a, clock) / getattr(b, clock) for a, b in pairs]
        measure, bound = f"{title} / {name} [x]", None if faults else wanted
        row = Row(section, tool, measure, values, bound, clock, ratio=True, note=faults)
        made.append(row)
    return made


def quotable(rows: Sequence[Row], *, loaded: bool) -> list[Row]:
    """Return the rows without ratios of wall time under load."""
    return [
        row
        for row in rows
        if not (loaded and row.ratio and row.clock is Clock.WALL and row.values)
    ]


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    if not row.values:
        return "none"
    shown = f"{row.median:.3g}"
    if len(row.values) > 1 and (row.clock or row.ratio):
        shown += f" ({min(row.values):.3g}-{max(row.values):.3g})"
    return shown


def tables(rows: Sequence[Row]) -> list[str]:
    """Return a table a section: a line a tool, a column a measure."""
    lines: list[str] = []
    for section in dict.fromkeys(row.section for row in rows):
        lines += [*_table([row for row in rows if row.section == section]), ""]
    return lines


def _table(rows: Sequence[Row]) -> list[str]:
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


def verdicts(rows: Sequence[Row], *, loaded: bool) -> list[str]:
    """Return a line for every figure that has a bound, and for each that is missing."""
    words = {"yes": "met", "no": "MISSED"}
    lines = []
    for row in rows:
        met = row.met(loaded=loaded)
        if met:
            figure = f"{row.section}, {row.tool}, {row.measure}"
            said = f"{row.median:.3g} ({row.wanted})" if row.values else row.note
            lines.append(f"{words.get(met, met):10}  {figure}: {said}")
    return lines


def write_csv(
    path: Path, about: Sequence[str], rows: Sequence[Row], *, loaded: bool
) -> None:
    """Write one line a figure, below what it was measured on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in about)
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS.split())
        for row in rows:
            values = row.values
            figures = [row.median, min(values), max(values)] if values else []
            shown = [f"{figure:.5g}" for figure in figures] or [""] * 3
            met = row.met(loaded=loaded)
            load = "under load" if loaded else "idle"
            writer.writerow(
                [
                    *(row.section, row.tool, row.measure, row.clock, *shown),
                    *(len(values), row.wanted or "", met, load, row.note),
                ]
            )
