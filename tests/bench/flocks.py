"""How fast members of a flock find those whom they see, beside numba and a tree.

Each sees 11 others on average; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, in_turn, on_one_thread, parser, run_peer, taken_of

SEED, SEEN, RADIUS, SOFTENING = 3, 11, 1.0, 0.1
WEIGHTS = np.array([0.8, 1.5, 0.15])
ERROR = "largest error [m/s²]"
NEAR_ENOUGH = Bound(at_least=False, bound=1e-9)
GRIDS = Bound(at_least=True, bound=2.5)
# Members whose accelerations are also found from each other member.
SAMPLE = 64
OWN, SEES, SEVEN = "animtool", "animtool, 300 degrees", "animtool, 7 nearest"
GRID, LISTS, TREE = "numba, sorted grid", "numba, grid of lists", "cKDTree and numpy"
ROUTES = {
    OWN: ("flocks_animtool.py", "all"),
    GRID: ("flocks_numba.py", "sorted"),
    LISTS: ("flocks_numba.py", "lists"),
    TREE: ("flocks_tree.py",),
    SEES: ("flocks_animtool.py", "seen"),
    SEVEN: ("flocks_animtool.py", "seven"),
}


def members(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places and velocities ``(N, 3)`` in a box, each with 11 others near."""
    side = (count * 4 / 3 * math.pi * RADIUS**3 / SEEN) ** (1 / 3)
    rng = np.random.default_rng(SEED)
    return rng.random((count, 3)) * side, rng.normal(size=(count, 3))


def direct(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return accelerations of the first ones, from each other member."""
    made = []
    for i in range(SAMPLE):
        off = x - x[i]
        far2 = (off * off).sum(axis=1)
        near = (far2 <= RADIUS**2) & (np.arange(len(x)) != i)
        attract, align, repulse = WEIGHTS
        push = off[near] / (far2[near] + SOFTENING**2)[:, None]
        count = max(int(near.sum()), 1)
        mean = attract * off[near] + align * (v[near] - v[i])
        made.append(mean.sum(axis=0) / count - repulse * push.sum(axis=0))
    return np.array(made)


def measure(options: argparse.Namespace, count: int, folder: Path) -> list[Row]:
    """Time every route in turn, each run a process that warms up."""
    x, v = members(count)
    source, output = folder / f"{count}.npz", folder / f"{count}.npy"
    radii = np.array([RADIUS, SOFTENING])
    np.savez(source, x=x, v=v, weights=WEIGHTS, radii=radii)
    truth = direct(x, v)
    errors, sizes = {}, []

    def route(name: str) -> Taken:
        script, *how = ROUTES[name]
        own = script == "flocks_animtool.py"
        python = sys.executable if own else options.numba_python
        # The best of a few: each process has other memory.
        report = run_peer(python, script, source, options.repeats, output, *how)
        errors[name] = float(np.abs(np.load(output)[:SAMPLE] - truth).max())
        sizes.extend([report["bytes"]] if name == OWN else [])
        return min(taken_of(report), key=lambda taken: taken.cpu)

    peers = [name for name in ROUTES if name.startswith("animtool")]
    peers = list(ROUTES) if options.numba_python else peers
    taken = in_turn(
        {name: lambda name=name: route(name) for name in peers}, options.runs
    )
    section = f"{count} members"
    rows = []
    for name in peers:
        rows += time_rows(section, name, taken[name], unit="ms")
        if name in {SEES, SEVEN}:
            continue
        rows.append(Row(section, name, ERROR, [errors[name]], NEAR_ENOUGH))
        if name != OWN:
            rows += ratio_rows(
                section, name, taken[name], taken[OWN],
                wanted=GRIDS if "grid" in name else None,
                accuracy=[Accuracy(ERROR, errors[name], NEAR_ENOUGH)],
            )  # fmt: skip
    if count >= options.memory_from:
        least = Bound(at_least=False, bound=200)
        rows.append(Row(section, OWN, "memory a member [B]", sizes, least))
    return rows


def growth(rows: list[Row], counts: list[int]) -> list[Row]:
    """Return the exponent that times grow with, from the least to the most members."""
    found = []
    for name in (OWN, GRID, LISTS, TREE):
        medians = [
            row.median
            for count in (counts[0], counts[-1])
            for row in rows
            if (row.section, row.tool, row.measure)
            == (f"{count} members", name, "CPU [ms]")
        ]
        if len(medians) == 2:
            exponent = math.log(medians[1] / medians[0]) / math.log(
                counts[-1] / counts[0]
            )
            bound = Bound(at_least=False, bound=1.1) if name == OWN else None
            measure = "exponent of CPU time"
            found.append(Row("growth", name, measure, [exponent], bound, Clock.CPU))
    return found


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "flocks.csv", runs=5)
    made.add_argument("--numba-python", help="interpreter with numba and scipy")
    made.add_argument("--counts", type=int, nargs="+", default=[10**4, 10**5, 10**6])
    made.add_argument("--repeats", type=int, default=3, help="of each process")
    made.add_argument("--memory-from", type=int, default=10**5)
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.numba_python, ["numba", "scipy", "numpy"]),
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.counts:
            rows += measure(options, count, Path(folder))
    if len(options.counts) > 1:
        rows += growth(rows, options.counts)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
