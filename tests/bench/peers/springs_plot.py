"""CPU time against error of springs, a curve a tool over its steps, from the CSV."""

import sys
from pathlib import Path

from plots import Curves, Point, draw, rows

TIME, ERROR = "CPU [s]", "RMS at "


def curves(source: Path) -> Curves:
    """Return panels, a size and frame each, of tools of steps."""
    times: dict[tuple[str, str], float] = {}
    found: Curves = {}
    for row in rows(source):
        key = row["section"], row["tool"]
        if row["measure"] == TIME:
            # The quickest run is the one that others on the machine disturbed least.
            times[key] = float(row["min"])
        elif row["measure"].startswith(ERROR) and key in times:
            frame = row["measure"].removeprefix(ERROR).partition(" [")[0]
            panel = found.setdefault(f"{row['section']}, {frame}", {})
            tool = row["tool"].rpartition(", ")[0]
            point = Point(times[key], float(row["median"]))
            panel.setdefault(tool, []).append(point)
    return found


def main(source: str, output: str) -> None:
    """Draw a panel for each size and frame."""
    shown = curves(Path(source))
    draw(shown, output, x="CPU time [s]", y="root mean square error [mm]")


if __name__ == "__main__":
    main(*sys.argv[1:])
