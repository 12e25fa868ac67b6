"""Curves of time against error, from the CSV of a benchmark."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("svg")
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D


@dataclass(frozen=True)
class Point:
    """One setting of a tool; one that is not whole is drawn hollow."""

    time: float
    error: float
    whole: bool = True


# Names in a line of the legend, so that long ones fit the page.
SIDE = 4

# By the title of their panel and their name.
Curves = dict[str, dict[str, list[Point]]]


def rows(source: Path) -> Iterator[dict[str, str]]:
    """Return the lines of a CSV below its comments."""
    with source.open(encoding="utf-8") as file:
        yield from csv.DictReader(line for line in file if not line.startswith("#"))


def draw(curves: Curves, output: str, *, x: str, y: str) -> None:
    """Write a figure with a panel a title, two in a row."""
    # Names within the file come from this, so that the same figures give the same file.
    mpl.rcParams["svg.hashsalt"] = "animtool"
    mpl.rcParams["svg.fonttype"] = "none"
    columns = 2
    figure, axes = plt.subplots(
        -(-len(curves) // columns), columns, figsize=(10, 7.5), squeeze=False
    )
    colours: dict[str, str] = {}
    for panel, (title, tools) in zip(axes.flat, curves.items(), strict=False):
        for tool, points in tools.items():
            colour = colours.setdefault(tool, f"C{len(colours)}")
            times = [point.time for point in points]
            errors = [point.error for point in points]
            panel.plot(times, errors, "-", color=colour, label=tool)
            fills = [colour if point.whole else "white" for point in points]
            panel.scatter(times, errors, c=fills, edgecolors=colour, zorder=3)
        panel.set(xscale="log", yscale="log", title=title)
        panel.set(xlabel=x, ylabel=y)
        panel.minorticks_off()
        panel.grid(visible=True, alpha=0.3)
    for panel in axes.flat[len(curves) :]:
        panel.remove()
    lines = [Line2D([], [], color=colour) for colour in colours.values()]
    figure.legend(lines, list(colours), loc="upper center", ncols=SIDE)
    figure.tight_layout(rect=(0, 0, 1, 0.97 - 0.02 * -(-len(colours) // SIDE)))
    figure.savefig(output, metadata={"Date": None})
