"""CPU time against error, a curve a tool over the tolerances, from the CSV."""

import sys
from pathlib import Path

from plots import Curves, Point, draw, rows

PARTS = ("CPU [us]", "error", "within [%]")
# A point is hollow where fewer problems than this came within its tolerance [%].
MOST = 99


def curves(source: Path) -> Curves:
    """Return panels of tools of tolerances."""
    cells: dict[tuple[str, str, str], dict[str, float]] = {}
    for row in rows(source):
        title, _, part = row["section"].partition(": ")
        if part in PARTS:
            # The quickest run is the one that others on the machine disturbed least.
            value = float(row["min" if part == PARTS[0] else "median"])
            key = (title, row["tool"], row["measure"])
            cells.setdefault(key, {})[part] = value
    found: Curves = {}
    for (title, tool, _), parts in cells.items():
        point = Point(parts[PARTS[0]], parts[PARTS[1]], parts[PARTS[2]] >= MOST)
        found.setdefault(title, {}).setdefault(tool, []).append(point)
    return found


def main(source: str, output: str) -> None:
    """Draw a panel for each set of problems."""
    shown = curves(Path(source))
    draw(shown, output, x="median CPU time [us]", y="median error [m] or [rad]")


if __name__ == "__main__":
    main(*sys.argv[1:])
