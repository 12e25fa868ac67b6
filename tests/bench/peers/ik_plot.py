"""Time against error, a curve a tool over the tolerances, from the CSV of the bench."""

import csv
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("svg")
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D

Curves = dict[str, dict[str, dict[str, tuple[float, float, float]]]]
PARTS = ("time [us]", "error", "within [%]")
# A point is hollow where fewer problems than this came within its tolerance [%].
MOST = 99


def curves(source: Path) -> Curves:
    """Return panels of tools of tolerances: time, error, share within."""
    with source.open(encoding="utf-8") as file:
        lines = [line for line in file if not line.startswith("#")]
    found: Curves = {}
    cells = {}
    for row in csv.DictReader(lines):
        title, _, part = row["section"].partition(": ")
        if part in PARTS:
            key = (title, row["tool"], row["measure"])
            # The quickest run is the one that others on the machine disturbed least.
            cells[*key, part] = float(row["min" if part == PARTS[0] else "median"])
            point = tuple(cells.get((*key, each), 0.0) for each in PARTS)
            panel = found.setdefault(title, {})
            panel.setdefault(row["tool"], {})[row["measure"]] = point
    return found


def main(source: str, output: str) -> None:
    """Draw a panel for each set of problems."""
    found = curves(Path(source))
    # Names within the file come from this, so that the same figures give the same file.
    mpl.rcParams["svg.hashsalt"] = "animtool"
    mpl.rcParams["svg.fonttype"] = "none"
    columns = 2
    figure, axes = plt.subplots(
        -(-len(found) // columns), columns, figsize=(10, 7.5), squeeze=False
    )
    colours: dict[str, str] = {}
    for panel, (title, tools) in zip(axes.flat, found.items(), strict=False):
        for tool, points in tools.items():
            colour = colours.setdefault(tool, f"C{len(colours)}")
            times, errors, within = zip(*points.values(), strict=True)
            panel.plot(times, errors, "-", color=colour, label=tool)
            fills = [colour if share >= MOST else "white" for share in within]
            panel.scatter(times, errors, c=fills, edgecolors=colour, zorder=3)
        panel.set(xscale="log", yscale="log", title=title)
        panel.set(xlabel="median time [us]", ylabel="median error [m] or [rad]")
        panel.minorticks_off()
        panel.grid(visible=True, alpha=0.3)
    for panel in axes.flat[len(found) :]:
        panel.remove()
    lines = [Line2D([], [], color=colour) for colour in colours.values()]
    figure.legend(lines, list(colours), loc="upper center", ncols=len(colours))
    figure.tight_layout(rect=(0, 0, 1, 0.95))
    figure.savefig(output, metadata={"Date": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
