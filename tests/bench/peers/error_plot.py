"""CPU time against error, a curve a tool over its settings, from the CSV."""

import sys
from pathlib import Path

from plots import Curves, Point, draw, rows

TIME = "CPU ["
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def curves(source: Path, measures: tuple[str, ...]) -> Curves:
    """Return panels, a section and measure each, of tools by their settings."""
    times: dict[tuple[str, str], float] = {}
    found: Curves = {}
    for row in rows(source):
        key = row["section"], row["tool"]
        unit = row["measure"].removeprefix(TIME).removesuffix("]")
        if row["measure"].startswith(TIME) and unit in SECONDS:
            # The quickest run is the one that others on the machine disturbed least.
            times[key] = float(row["min"]) * SECONDS[unit]
        elif row["measure"].startswith(measures) and key in times:
            panel = found.setdefault(f"{row['section']}: {row['measure']}", {})
            tool, _, _ = row["tool"].rpartition(", ")
            point = Point(times[key], float(row["median"]))
            panel.setdefault(tool or row["tool"], []).append(point)
    return found


def main(source: str, output: str, *measures: str) -> None:
    """Draw a panel for each section and each measure that begins as asked."""
    draw(curves(Path(source), measures), output, x="CPU time [s]", y="error")


if __name__ == "__main__":
    main(*sys.argv[1:])
