"""How many people get by each other in corridors, across each other and through doors.

Corridors of several widths, headings and counts, with obstacles in them: see README.md
beside this file.
"""

from __future__ import annotations

import json
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from figures import Bound, Row
from measuring import begin, on_one_thread, parser

STEP, FPS, RADIUS = 0.02, 10, 0.22
TOUCHING = Bound(at_least=False, bound=0.01)
OWN, OVERLAP = "animtool", "largest overlap [m]"
# Width [m], people, obstacles and heading [rad].
CORRIDORS = [
    (2.4, 20, 2, 0.0),
    (2.4, 40, 1, 0.4),
    (3.2, 60, 0, 1.1),
    (3.2, 60, 2, 0.0),
    (3.2, 60, 2, 2.2),
    (4.0, 60, 3, 0.7),
    (4.0, 80, 2, 1.5708),
    (5.0, 80, 3, 0.0),
]
# How far along the corridor they begin, have to come and go [m].
NEAREST, BEYOND, GOAL = 5.0, 9.0, 14.0
DENSITIES = [0.33, 1.38, 2.13]


def turned(points: np.ndarray, yaw: float) -> np.ndarray:
    """Return x and z ``(..., 2)`` turned about y [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, z = points[..., 0], points[..., 1]
    return np.stack([c * x + s * z, c * z - s * x], axis=-1)


def box(
    x: float, z: float, wide: float, deep: float, yaw: float = 0.0
) -> dict[str, Any]:
    """Return a box that stands on the ground."""
    at = turned(np.array([x, z]), yaw).tolist()
    return {
        "shape": {"box": {"size": [wide, 3, deep]}},
        "at": [at[0], 1.5, at[1]],
        "rotate": [float(np.cos(yaw / 2)), 0, float(np.sin(yaw / 2)), 0],
    }


def simulated(
    streams: list[tuple[np.ndarray, np.ndarray]], seconds: float, seed: int, **keys: Any
) -> np.ndarray:
    """Return where people are ``(F, N, 2)``: of each stream starts and goal."""
    from animtool.scene.file.read import load_scene
    from animtool.scene.systems.run import SystemRun

    goals, populations, arrays = [], [], {}
    for k, (starts, goal) in enumerate(streams):
        name = f"s{k}"
        arrays[name] = np.insert(starts, 1, 0.0, axis=1)
        at = [float(goal[0]), 0, float(goal[1])]
        goals.append({"name": name, "at": at, "radius": 1.5})
        populations.append(
            {
                "name": name,
                "points": f"starts.npz#{name}",
                "route": [name],
                "radius": RADIUS,
                "seed": len(streams) * seed + k,
            }
        )
    crowds = {"name": "people", "step": STEP, "goals": goals}
    system = {"crowds": {**crowds, "populations": populations, **keys}}
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "starts.npz", **arrays)
        path = Path(folder) / "it.scene.yaml"
        made = {"scene": "animtool/1", "fps": 24, "range": [1, 2], "systems": [system]}
        path.write_text(json.dumps(made), "utf-8")
        run = SystemRun(load_scene(path).systems, seconds)
        codes = [Fraction(k, FPS) for k in range(round(seconds * FPS) + 1)]
        rows = [row for _, (row,) in run.coded_frames(codes, Fraction(), Fraction(1))]
    return np.stack([row.points[:, [0, 2]] for row in rows])


def overlap(track: np.ndarray) -> float:
    """Return the most that any two are ever in each other [m]."""
    from scipy.spatial import cKDTree

    near = min(float(cKDTree(x).query(x, 2)[0][:, 1].min()) for x in track)
    return max(2 * RADIUS - near, 0.0)


def corridor(
    width: float, count: int, obstacles: int, yaw: float, seed: int
) -> tuple[int, float]:
    """Return how many of two streams are through after 45 s, and the overlap [m]."""
    rng = np.random.default_rng(seed)
    half, wide = count // 2, width / 2 - 0.4
    long = max(6.0, half / (2 * wide) / 2.1)
    streams = []
    for way in (-1, 1):
        along = way * rng.uniform(NEAREST, NEAREST + long, half)
        starts = np.stack([along, rng.uniform(-wide, wide, half)], axis=1)
        goal = np.array([-way * GOAL, 0.0])
        streams.append((turned(starts, yaw), turned(goal, yaw)))
    walls = [box(0, way * (width / 2 + 0.1), 60, 0.2, yaw) for way in (-1, 1)]
    for k in range(obstacles):
        x = -2 + 6 * k / max(obstacles - 1, 1) + float(rng.uniform(-1, 1))
        z = float(rng.uniform(-0.3, 0.3)) * width
        if k % 2:
            walls.append(box(x, z, 0.5, width / 4, yaw))
        else:
            at = turned(np.array([x, z / 2]), yaw).tolist()
            pillar = {"capsule": {"radius": width / 8, "length": 3}}
            walls.append({"shape": pillar, "at": [at[0], 1.5, at[1]]})
    track = simulated(streams, 45.0, seed, colliders=walls)
    along = turned(track[-1], -yaw)[:, 0] * np.repeat([1.0, -1.0], half)
    return int((along > BEYOND).sum()), overlap(track)


def crossing(first: float, seed: int) -> tuple[float, float]:
    """Return the mean speed [m/s] of 190 who cross 18 m in 20 s, and the overlap [m].

    Each of four streams begins on its side, ``first`` [m] off the middle and farther.
    """
    rng = np.random.default_rng(seed)
    streams = []
    for k in range(4):
        own = 48 if k < 2 else 47
        along, across = rng.uniform(first, first + 9, own), rng.uniform(-9, 9, own)
        starts = turned(np.stack([-along, across], axis=1), k * np.pi / 2)
        streams.append((starts, turned(np.array([40.0, 0.0]), k * np.pi / 2)))
    track = simulated(streams, 20.0, seed)
    steps = np.linalg.norm(np.diff(track, axis=0), axis=2)
    return float(steps.sum(axis=0).mean()) / 20.0, overlap(track)


def one_way(density: float, seed: int) -> tuple[float, float]:
    """Return the speed of one stream [m/s], over Weidmann's, and the overlap [m]."""
    wide, long = 4.0, 40.0
    columns = max(1, round(wide * np.sqrt(density)))
    k, apart = np.arange(round(density * wide * long)), wide / columns
    starts = np.stack(
        [(k % columns + 0.5) * apart - wide / 2, k // columns / density / apart], axis=1
    )
    starts += np.random.default_rng(seed).uniform(-0.05, 0.05, starts.shape)
    walls = [box(s * (wide / 2 + 0.4), 50, 0.3, 200) for s in (-1, 1)]
    streams = [(starts, np.array([0.0, 200.0]))]
    track = simulated(streams, 10.0, seed, colliders=walls, cell=0.5)
    behind = starts[:, 1] < long / 2
    speed = float((track[-1] - track[-11])[behind, 1].mean())
    published = 1.34 * (1 - np.exp(-1.913 * (1 / density - 1 / 5.4)))
    return speed / float(published), overlap(track)


def door(width: float, seed: int) -> tuple[float, float]:
    """Return the flow through a door [1/(m s)], and the overlap [m]."""
    k = np.arange(100)
    starts = np.stack([(k % 10 - 4.5) * 0.6, -1.5 - (k // 10) * 0.6], axis=1)
    starts += np.random.default_rng(seed).uniform(-0.05, 0.05, starts.shape)
    walls = [box(s * (5 + width / 2), 0, 10, 0.3) for s in (-1, 1)]
    streams = [(starts, np.array([0.0, 12.0]))]
    track = simulated(streams, 60.0, seed, colliders=walls)
    through = np.sort(np.argmax(track[:, :, 1] > 0, axis=0) / FPS)
    through = through[through > 0]
    first, last = len(through) // 5, len(through) * 4 // 5
    return (last - first) / (through[last] - through[first]) / width, overlap(track)


def main() -> None:
    """Simulate, print the tables, write the CSV."""
    made = parser(__doc__, "crowd_streams.csv", runs=1)
    made.add_argument("--seeds", type=int, nargs="+", default=[501, 502, 503])
    options = made.parse_args()
    on_one_thread()
    session = begin(options)
    rows: list[Row] = []

    def add(
        section: str, measure: str, found: list[tuple[float, float]], bound: float
    ) -> None:
        values, deepest = zip(*found, strict=True)
        wanted = Bound(at_least=True, bound=bound)
        rows.append(Row(section, OWN, measure, [float(v) for v in values], wanted))
        rows.append(Row(section, OWN, OVERLAP, [max(deepest)], TOUCHING))

    for width, count, obstacles, yaw in CORRIDORS:
        section = f"{count} in {width:g} m, {obstacles} obstacles, {yaw:.1f} rad"
        got = [corridor(width, count, obstacles, yaw, s) for s in options.seeds]
        add(section, "through after 45 s", [*got], count * 5 / 6)
    for first in (0.0, 3.0, 6.0):
        seen = [crossing(first, s) for s in options.seeds]
        add(f"190 across 18 m, from {first:g} m", "mean speed [m/s]", seen, 0.8)
    for density in DENSITIES:
        seen = [one_way(density, s) for s in options.seeds]
        add(f"one way, {density:g} a m²", "speed / Weidmann [x]", seen, 0.8)
    for width in (0.8, 1.2):
        seen = [door(width, s) for s in options.seeds]
        add(f"door of {width:g} m", "flow [1/(m s)]", seen, 0.8)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
