"""How fast bodies attract each other at equal errors, beside rebound and pytreegrav.

See README.md beside this file.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from clock import Taken
from figures import Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, draw, on_one_thread, parser, run_peer

SEED, SAMPLE = 5, 200
ERROR = "rms of relative errors"
OWN, REBOUND = "animtool", "rebound, tree"
MONOPOLE, QUADRUPOLE = "pytreegrav", "pytreegrav, quadrupoles"
# Errors that all are compared at: what the anchor has.
AT = 2e-4
ACCURACIES = ("3e-3", "1e-3", "3e-4", "1e-4", "3e-5")
ANGLES = {
    REBOUND: ("nbody_rebound.py", (), ("0.7", "0.5", "0.3", "0.2")),
    MONOPOLE: ("nbody_pytreegrav.py", ("monopole",), ("0.7", "0.4", "0.25", "0.2")),
    QUADRUPOLE: ("nbody_pytreegrav.py", ("quadrupole",), ("1", "0.7", "0.5", "0.4")),
}
FASTER, DIRECT = (Bound(at_least=True, bound=b) for b in (1.5, 10.0))
# Bodies up to which direct sums are timed.
FEW = 20_000
# Bodies from which on the next count has just the settings around the error.
MANY = 10_000

Settings = dict[str, tuple[str, ...]]


def bodies(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a ball of Plummer: places ``(N, 3)`` and masses."""
    rng = np.random.default_rng(SEED)
    r = 1 / np.sqrt(rng.uniform(1e-3, 0.99, count) ** (-2 / 3) - 1)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return r[:, None] * ways, np.full(count, 1 / count)


def exact(x: np.ndarray, masses: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return accelerations of some bodies from each other one."""
    found = []
    for i in rows:
        off = x - x[i]
        squares = (off**2).sum(axis=1)
        squares[i] = np.inf
        found.append((masses / squares**1.5) @ off)
    return np.array(found)


def around(found: list[dict[str, Any]], error: float) -> tuple[str, ...]:
    """Return the settings whose errors are next above and below an error.

    Of a tool that stays above it, that is the setting with the least error.
    """
    by_error = sorted(found, key=lambda one: one["error"])
    above = [one["setting"] for one in by_error if one["error"] >= error][:1]
    below = [one["setting"] for one in by_error if one["error"] < error][-1:]
    return tuple(below + above)


def at_error(found: list[dict[str, Any]], error: float) -> Taken | None:
    """Return what a tool takes for an error, between its settings; None beyond them."""
    points = sorted(
        (one["error"], *(min(t[k] for t in one["taken"]) for k in (0, 1)))
        for one in found
    )
    errors, walls, cpus = np.log(np.array(points)).T
    if not errors[0] <= math.log(error) <= errors[-1]:
        return None
    wall, cpu = (
        math.exp(float(np.interp(math.log(error), errors, each)))
        for each in (walls, cpus)
    )
    return Taken(wall, cpu)


def measure(
    options: argparse.Namespace, count: int, folder: Path, settings: Settings
) -> list[Row]:
    """Time each tool by its settings, and compare them at one error.

    ``settings`` of peers become those around that error where there are many bodies.
    """
    x, masses = bodies(count)
    rows_of = np.random.default_rng(SEED + 1).choice(count, SAMPLE, replace=False)
    source = folder / f"{count}.npz"
    np.savez(source, x=x, m=masses, rows=rows_of, exact=exact(x, masses, rows_of))
    section, rows = f"{count} bodies", []

    def run(name: str, script: str, *arguments: str) -> list[dict[str, Any]]:
        python = sys.executable if name == OWN else options.peer_python
        runs = options.runs if count <= 10**5 else 1
        print(f"  {count}: {name}", file=sys.stderr)
        found: list[dict[str, Any]] = run_peer(
            python, script, source, runs, *arguments
        )["found"]
        for one in found:
            tool = f"{name}, {one['setting']}"
            taken = [Taken(*pair) for pair in one["taken"]]
            rows.extend(time_rows(section, tool, taken, unit="ms"))
            rows.append(Row(section, tool, ERROR, [one["error"]]))
        return found

    own = run(OWN, "nbody_animtool.py", *ACCURACIES)
    ours = at_error(own, AT)
    if not options.peer_python:
        return rows
    fastest: tuple[float, str, Taken] | None = None
    for name, (script, more, _) in ANGLES.items():
        found = run(name, script, *more, *settings[name])
        theirs = at_error(found, AT)
        if count >= MANY:
            settings[name] = around(found, AT)
        if theirs is None or ours is None:
            continue
        rows += ratio_rows(section, f"{name} at {AT:g}", [theirs], [ours], wanted=None)
        if fastest is None or theirs.cpu < fastest[0]:
            fastest = theirs.cpu, name, theirs
    if fastest is not None and ours is not None:
        tool = f"the fastest peer at {AT:g} ({fastest[1]})"
        rows += ratio_rows(section, tool, [fastest[2]], [ours], wanted=FASTER)
    if count <= FEW and ours is not None:
        (direct,) = run("rebound, direct", "nbody_rebound.py", "0")
        taken = [Taken(*pair) for pair in direct["taken"]]
        wanted = DIRECT if count >= MANY else None
        rows += ratio_rows(section, "rebound, direct", taken, [ours], wanted=wanted)
        run(OWN, "nbody_animtool.py", "0")
    return rows


def methods() -> list[Row]:
    """Return seconds of a galaxy against its errors, by method and step."""
    steps = [
        f"{method}:{step}"
        for method in ("symplectic_euler", "midpoint", "velocity_verlet", "rk4")
        for step in (0.01, 0.005, 0.0025)
    ]
    found = run_peer(sys.executable, "nbody_methods.py", 2, *steps, "rk4:0.000625")
    rows = []
    for one in found["found"][:-1]:
        tool = one["setting"].replace(":", ", ")
        rows += time_rows("methods", tool, [Taken(*pair) for pair in one["taken"]])
        rows.append(Row("methods", tool, "drift of energy", [one["drift"]]))
        rows.append(Row("methods", tool, "rms of errors [m]", [one["error"]]))
    return rows


def growth(rows: list[Row], counts: list[int]) -> list[Row]:
    """Return the exponent that times grow with, from the least to the most bodies."""
    tool = f"{OWN}, {ACCURACIES[2]}"
    medians = [
        row.median
        for count in (counts[0], counts[-1])
        for row in rows
        if (row.section, row.tool, row.measure) == (f"{count} bodies", tool, "CPU [ms]")
    ]
    exponent = math.log(medians[1] / medians[0]) / math.log(counts[-1] / counts[0])
    return [Row("growth", tool, "exponent of CPU time", [exponent], None, Clock.CPU)]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "particles_nbody.csv", runs=3)
    made.add_argument("--peer-python", help="interpreter with rebound and pytreegrav")
    made.add_argument(
        "--counts", type=int, nargs="+", default=[10**3, 10**4, 10**5, 10**6]
    )
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, ["rebound", "pytreegrav", "numba"]),
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        settings = {name: angles for name, (_, _, angles) in ANGLES.items()}
        for count in options.counts:
            rows += measure(options, count, Path(folder), settings)
    rows += methods()
    if len(options.counts) > 1:
        rows += growth(rows, options.counts)
    session.finish(options.csv, rows)
    draw(sys.executable, options.csv, "drift of energy", "rms of ")


if __name__ == "__main__":
    main()
