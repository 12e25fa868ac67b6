"""Agents of a crowd, the ways to their goals, and their poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.kernels import Maker

Rng = np.random.Generator


def _starts(rng: Rng, rows: int, count: int) -> Any:
    inner = np.sort(rng.integers(0, rows + 1, max(count - 1, 0)))
    ends = [0, *inner.tolist(), rows] if count else [0]
    return np.array(ends, np.int32)


def _crowd(rng: Rng) -> dict[str, Any]:
    count = int(rng.integers(0, 40))
    rows = int(rng.integers(0, 60)) if count else 0
    angles = rng.uniform(0, 2 * np.pi, rows)
    walls = np.stack(
        [np.cos(angles), np.sin(angles), rng.normal(size=rows), rng.normal(size=rows)],
        1,
    )
    return {
        "points": rng.normal(scale=10.0 ** rng.integers(-1, 3), size=(count, 2)),
        "velocities": rng.normal(size=(count, 2)),
        "preferred": rng.normal(size=(count, 2)),
        "radii": rng.uniform(0.1, 0.4, count),
        "max_speeds": rng.uniform(0, 2, count),
        "yielding": rng.uniform(0.1, 1, count),
        "shoulders": rng.uniform(-0.7, 0.7, (count, 2)) * float(rng.integers(0, 2)),
        "depth": 0.6,
        "groups": rng.integers(-1, 3, count, dtype=np.int32),
        "modes": rng.integers(0, 3, count, dtype=np.uint8),
        "starts": _starts(rng, rows, count),
        "walls": walls,
        "sight": float(rng.choice([0.5, 3.0])),
        "nearest": int(rng.integers(0, 12)),
        "horizon": float(rng.choice([0.5, 2.0])),
        "space": float(rng.choice([0.0, 0.3])),
        "push": 0.3,
        "headway": float(rng.choice([0.0, 0.5])),
        "side": float(rng.choice([-0.3, 0.0, 0.3])),
        "step": 0.05,
        "max_passes": int(rng.integers(0, 5)),
        "tolerance": 1e-3,
    }


def _travel(rng: Rng) -> dict[str, Any]:
    shape = tuple(rng.integers(1, 12, 2).tolist())
    seeds = rng.integers(0, shape[0] * shape[1], int(rng.integers(0, 4)))
    return {
        "is_free": rng.random(shape) < 0.8,
        "cell_size": 0.5,
        "seeds": seeds,
        "starts": rng.uniform(0, 1, len(seeds)),
    }


def _spans(rng: Rng) -> dict[str, Any]:
    frames, moving = int(rng.integers(5, 20)), int(rng.integers(1, 5))
    count, wide = moving + 1, int(rng.integers(2, 4))

    def turns(*shape: int) -> Any:
        made = rng.normal(size=(*shape, 4))
        return made / np.linalg.norm(made, axis=-1, keepdims=True)

    return {
        "joint_rotations": turns(frames, moving),
        "parents": np.array(
            [int(rng.integers(-1, j)) if j else -1 for j in range(count)]
        ),
        "pose_indices": rng.integers(-1, moving, count),
        "positions": rng.normal(size=(count, 3)),
        "pre_rotations": turns(count),
        "rest_rotations": turns(count),
        "feet": rng.integers(0, count, 2),
        "foot_stands": rng.random((frames, 2)) < 0.5,
        "span_starts": rng.integers(0, frames - wide, int(rng.integers(0, 5))),
        "span_width": wide,
        "max_joint_error": float(rng.choice([0.01, 10.0])),
        "max_foot_error": float(rng.choice([0.01, 10.0])),
        "max_root_shift": float(rng.choice([0.01, 10.0])),
    }


CALLS: dict[str, Maker] = {
    "crowd_step": _crowd,
    "fitting_spans": _spans,
    "travel_distances": _travel,
}
# No way leads to some places.
UNBOUNDED = frozenset({"travel_distances"})
