"""How fast boxes fall into a container and come to rest, beside MuJoCo and pybullet.

Penetration is measured the same way for all; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, in_turn, on_one_thread, parser, run_peer, taken_of
from scipy.spatial import cKDTree

from animtool.maths import so3

SEED, SIDE, APART, LAYERS = 1, 0.2, 0.36, 10
OWN, BULLET, MUJOCO = "animtool", "pybullet", "MuJoCo"
SCRIPTS = {
    OWN: "rigid_animtool.py",
    BULLET: "rigid_pybullet.py",
    MUJOCO: "rigid_mujoco.py",
}
DEEPEST, MEAN = "deepest penetration [mm]", "mean penetration [mm]"
FASTER = Bound(at_least=True, bound=1.0)
GROWTH = Bound(at_least=False, bound=1.15)


def heap(count: int) -> dict[str, np.ndarray]:
    """Return boxes turned at random above a container, in layers."""
    rng = np.random.default_rng(SEED)
    row = max(round(math.sqrt(count / LAYERS)), 1)
    k = np.arange(count)
    x, z, layer = k % row, k // row % row, k // (row * row)
    points = np.stack([x - row / 2 + 0.5, layer + 0.8, z - row / 2 + 0.5], axis=1)
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return {
        "points": points * APART,
        "turns": turns,
        "side": np.array(SIDE),
        "width": np.array(row * APART),
    }


def penetrations(points: np.ndarray, turns: np.ndarray, width: float) -> np.ndarray:
    """Return how deep boxes are in each other and in the container [m].

    Of two boxes, along the one of 15 axes that parts them most.
    """
    half = SIDE / 2
    pairs = cKDTree(points).query_pairs(SIDE * math.sqrt(3), output_type="ndarray")
    frames = so3.to_matrix(turns)
    a, b = frames[pairs[:, 0]], frames[pairs[:, 1]]
    off = points[pairs[:, 1]] - points[pairs[:, 0]]
    axes = [a[:, :, i] for i in range(3)] + [b[:, :, i] for i in range(3)]
    axes += [np.cross(a[:, :, i], b[:, :, j]) for i in range(3) for j in range(3)]
    gaps = np.full(len(pairs), -np.inf)
    for axis in axes:
        size = np.linalg.norm(axis, axis=1)
        n = axis / np.where(size > 1e-6, size, 1)[:, None]
        wide = np.abs(np.einsum("nk,nki->ni", n, a)).sum(axis=1)
        wide += np.abs(np.einsum("nk,nki->ni", n, b)).sum(axis=1)
        gap = np.abs((off * n).sum(axis=1)) - half * wide
        gaps = np.where(size > 1e-6, np.maximum(gaps, gap), gaps)
    corners = (np.indices((2, 2, 2)).reshape(3, 8).T * 2 - 1) * half
    places = points[:, None] + so3.rotate(turns[:, None], corners)
    floor = -places[..., 1].min(axis=1)
    walls = np.abs(places[..., [0, 2]]).max(axis=(1, 2)) - width / 2
    depths = np.concatenate([-gaps, floor, walls])
    return depths[depths > 0]


def measure(
    options: argparse.Namespace, count: int, peers: list[str], folder: Path
) -> list[Row]:
    """Time every tool in turn."""
    source, made = folder / f"{count}.npz", heap(count)
    np.savez(source, **made)
    found: dict[str, tuple[np.ndarray, float, float]] = {}

    def route(name: str) -> Taken:
        python = sys.executable if name == OWN else options.peers_python
        output = folder / f"{count}-{name}.npz"
        report = run_peer(python, SCRIPTS[name], source, options.seconds, output)
        end = np.load(output)
        deep = penetrations(end["points"], end["turns"], float(made["width"]))
        kinetic = float(4 * (end["velocities"] ** 2).sum())
        found[name] = deep, kinetic, float(end["points"][:, 1].mean())
        return taken_of(report)[0]

    taken = in_turn(
        {name: lambda name=name: route(name) for name in peers}, options.runs
    )
    section = f"{count} boxes, {options.seconds:g} s"
    rows = []
    others = [float(found[name][0].mean()) for name in peers if name != OWN]
    for name in peers:
        deep, kinetic, height = found[name]
        rows += time_rows(section, name, taken[name])
        bound = Bound(at_least=False, bound=1e3 * min(others)) if others else None
        bound = bound if name == OWN else None
        rows.append(Row(section, name, MEAN, [1e3 * float(deep.mean())], bound))
        rows.append(Row(section, name, DEEPEST, [1e3 * float(deep.max())]))
        rows.append(Row(section, name, "left of motion [J]", [kinetic]))
        rows.append(Row(section, name, "mean height [m]", [height]))
        if name != OWN:
            rows += ratio_rows(section, name, taken[name], taken[OWN], wanted=FASTER)
    return rows


def growth(rows: list[Row], counts: list[int], seconds: float) -> list[Row]:
    """Return the exponent that time grows with."""
    first, last = (
        next(
            row.median
            for row in rows
            if (row.section, row.tool, row.measure)
            == (f"{count} boxes, {seconds:g} s", OWN, "CPU [s]")
        )
        for count in (counts[0], counts[-1])
    )
    exponent = math.log(last / first) / math.log(counts[-1] / counts[0])
    name = f"exponent of CPU time, {counts[0]} to {counts[-1]} boxes"
    return [Row("growth", OWN, name, [exponent], GROWTH, Clock.CPU)]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "rigid.csv", runs=1)
    made.add_argument("--peers-python", help="interpreter with mujoco and pybullet")
    made.add_argument("--counts", type=int, nargs="+", default=[100, 1000, 10000])
    made.add_argument("--peers-up-to", type=int, default=1000)
    made.add_argument("--seconds", type=float, default=3.0, help="that are simulated")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peers_python, ["mujoco", "pybullet", "numpy"]),
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.counts:
            several = options.peers_python and count <= options.peers_up_to
            peers = list(SCRIPTS) if several else [OWN]
            rows += measure(options, count, peers, Path(folder))
    if len(options.counts) > 1:
        rows += growth(rows, options.counts, options.seconds)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
