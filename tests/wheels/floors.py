"""Compare the coverage of each package of animtool with its floor in ``floors.toml``.

Reads the JSON report of coverage.py; lines of a folder below ``animtool/`` count for
the package of that name, modules directly in ``animtool/`` for ``animtool``. Exit code
1 if a package is below its floor or has none, or if a floor has no package.

Floors are a measured run minus a margin, rounded down: ``--set MARGIN`` prints them.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path, PureWindowsPath
from typing import Any

FLOORS = Path(__file__).parent / "floors.toml"


def by_package(report: dict[str, Any]) -> dict[str, float]:
    """Return the share of lines that ran, by package [%]."""
    covered: dict[str, int] = {}
    statements: dict[str, int] = {}
    for name, file in report["files"].items():
        # A path of either kind, of the sources or of an installed package.
        parts = PureWindowsPath(name).parts
        if "animtool" not in parts:
            continue
        inside = parts[len(parts) - parts[::-1].index("animtool") :]
        package = inside[0] if len(inside) > 1 else "animtool"
        summary = file["summary"]
        covered[package] = covered.get(package, 0) + summary["covered_lines"]
        statements[package] = statements.get(package, 0) + summary["num_statements"]
    return {
        package: 100 * covered[package] / count
        for package, count in sorted(statements.items())
        if count
    }


def too_low(shares: dict[str, float], floors: dict[str, float]) -> list[str]:
    """Return a line for each package that is below its floor, or has no partner."""
    lines = []
    for package in sorted(shares.keys() | floors.keys()):
        if package not in floors:
            lines.append(f"{package}: no floor; add one to {FLOORS.name}")
        elif package not in shares:
            lines.append(f"{package}: not measured; remove its floor")
        elif shares[package] < floors[package]:
            lines.append(
                f"{package}: {shares[package]:.2f} %, below {floors[package]} %"
            )
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and what is too low; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, help="JSON report of coverage.py")
    parser.add_argument(
        "--set", type=float, metavar="MARGIN", help="print floors this far below [%%]"
    )
    options = parser.parse_args(arguments)
    shares = by_package(json.loads(options.report.read_text("utf-8")))
    if options.set is not None:
        for package, share in shares.items():
            print(f"{package} = {math.floor(share - options.set)}")
        return 0
    floors = tomllib.loads(FLOORS.read_text("utf-8"))["floors"]
    print(f"{'package':12}  lines   floor")
    for package, share in shares.items():
        print(f"{package:12} {share:6.2f}  {floors.get(package, ''):>6}")
    lines = too_low(shares, floors)
    print(*lines, sep="\n", file=sys.stderr)
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
