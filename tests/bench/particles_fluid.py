"""How fast water collapses at an equal compression, beside SPlisHSPlasH.

5000 particles for two seconds, then the growth from 1000 to 1 000 000; see README.md
beside this file.
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

COMPRESSION, ERROR = "worst mean compression", "outside the tank"
LESS, NONE = (
    Bound(at_least=False, bound=0.01),
    Bound(at_least=False, bound=0),
)
FASTER = Bound(at_least=True, bound=1.0)
LINEAR = Bound(at_least=False, bound=1.15)
OWN, PEER = "animtool", "SPlisHSPlasH, DFSPH"
# Mean density error that the scenes of its authors ask SPlisHSPlasH for [%].
ERRORS = 0.05
SPACING, TANK = 0.04, np.array([2.0, 2.0, 0.8])


def dam(count: int) -> tuple[np.ndarray, float, np.ndarray]:
    """Return points of a column ``(N, 3)``, their spacing, and the tank."""
    # Those of the data, finer or coarser.
    finer = (count / 5000) ** (1 / 3)
    axes = [np.arange(round(n * finer)) + 0.5 for n in (10, 25, 20)]
    spacing = 0.8 / len(axes[2])
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.ascontiguousarray(grid * spacing), spacing, TANK


def compression(points: np.ndarray, spacing: float) -> float:
    """Return how much denser than at rest it is in the mean, as the data defines it."""
    from scipy.spatial import cKDTree

    radius = 2 * spacing

    def weights(off: np.ndarray) -> np.ndarray:
        return np.maximum(1 - (off**2).sum(axis=1) / radius**2, 0.0) ** 3

    far = np.arange(-3, 4) * spacing
    lattice = np.stack(np.meshgrid(far, far, far), axis=-1).reshape(-1, 3)
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    each = weights(points[pairs[:, 0]] - points[pairs[:, 1]])
    sums = sum(np.bincount(pairs[:, k], each, len(points)) for k in (0, 1))
    return float(np.maximum((1 + sums) / weights(lattice).sum() - 1, 0.0).mean())


def write(path: Path, count: int, seconds: float, fps: float = 24) -> tuple[float, int]:
    """Write the dam of a count; return its spacing, and how many there are."""
    x, spacing, tank = dam(count)
    keys = {"seconds": seconds, "fps": fps, "compression": 0.01}
    np.savez(path, x=x, tank=tank, spacing=spacing, **keys)
    return spacing, len(x)


def collapse(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time two seconds of 5000 particles by each tool in turn."""
    source, found, worst, outside = folder / "5k.npz", folder / "5k.npy", {}, {}
    spacing, _ = write(source, 5000, options.seconds)

    def route(name: str) -> Taken:
        if name == OWN:
            report = run_peer(sys.executable, "fluid_animtool.py", source, 1, found)
        else:
            report = run_peer(
                options.peer_python, "fluid_splishsplash.py", source, found, ERRORS
            )
        frames = np.load(found)
        worst[name] = max(compression(one, spacing) for one in frames)
        beyond = np.abs(frames - TANK / 2) > TANK / 2 + spacing / 2
        outside[name] = int(beyond.any(axis=2).sum(axis=1).max())
        return taken_of(report)[0]

    tools = [OWN, PEER] if options.peer_python else [OWN]
    taken = in_turn(
        {name: lambda name=name: route(name) for name in tools}, options.runs
    )
    section, rows = "5000 particles, 2 s", []
    for name in tools:
        rows += time_rows(section, name, taken[name], unit="s")
        rows.append(Row(section, name, COMPRESSION, [worst[name]], LESS))
        rows.append(Row(section, name, ERROR, [outside[name]], NONE))
    if options.peer_python:
        checks = [
            Accuracy(COMPRESSION, worst[PEER], LESS),
            Accuracy(ERROR, outside[PEER], NONE),
        ]
        rows += ratio_rows(
            section, PEER, taken[PEER], taken[OWN], wanted=FASTER, accuracy=checks
        )
    return rows


def growth(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time a part of a step by counts, and return the exponent it grows with."""
    rows, costs = [], []
    for count in options.counts:
        source = folder / f"{count}.npz"
        # A frame that is shorter where particles are finer has as many parts.
        fps = 24 * (count / 1000) ** (1 / 3)
        _, there = write(source, count, 1 / fps, fps)
        report = run_peer(
            sys.executable, "fluid_animtool.py", source, options.runs, folder / "x.npy"
        )
        taken = [Taken(*(t / report["steps"] for t in one)) for one in taken_of(report)]
        rows += time_rows(f"{there} particles, a part", OWN, taken, unit="ms")
        costs.append((there, min(one.cpu for one in taken)))
    (few, first), (many, last) = costs[0], costs[-1]
    if many > few:
        exponent = math.log(last / first) / math.log(many / few)
        measure = "exponent of CPU time of a part"
        rows.append(Row("growth", OWN, measure, [exponent], LINEAR, Clock.CPU))
    return rows


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "particles_fluid.csv", runs=3)
    made.add_argument("--peer-python", help="interpreter with pysplishsplash")
    made.add_argument("--seconds", type=float, default=2.0, help="of the dam")
    made.add_argument(
        "--counts", type=int, nargs="+", default=[10**3, 10**4, 10**5, 10**6]
    )
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, ["pysplishsplash", "numpy"]),
    )
    with tempfile.TemporaryDirectory() as folder:
        rows = collapse(options, Path(folder)) + growth(options, Path(folder))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
