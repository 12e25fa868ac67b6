"""Members of a flock, and those whom they see."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.kernels import Maker

Rng = np.random.Generator


def _flock(rng: Rng) -> dict[str, Any]:
    count = int(rng.integers(0, 40))
    radius = float(rng.choice([0.3, 1.0, 5.0]))
    period = np.zeros((2, 3))
    period[0] = rng.normal(size=3)
    period[1] = rng.choice([0.0, 2.0, 7.0], 3) * radius

    def some() -> Any:
        if rng.integers(2):
            return None
        size = int(rng.integers(0, count + 1))
        return rng.integers(0, max(count, 1), size, dtype=np.int32)

    def pull() -> Any:
        return np.array([rng.normal(), rng.uniform(0, 2 * radius)])

    return {
        "points": rng.normal(scale=10.0 ** rng.integers(-1, 4), size=(count, 3)),
        "velocities": rng.normal(size=(count, 3)),
        "members": some(),
        "others": some(),
        "radius": radius,
        "cosine": float(rng.choice([-1.0, -0.5, 1.0])),
        "nearest": int(rng.integers(0, 4)),
        "attraction": pull(),
        "alignment": pull(),
        "repulsion": pull(),
        "softening": 0.1,
        "period": period,
        "max_tests": float(rng.choice([1e9, 10.0])),
    }


def _spaced(rng: Rng) -> dict[str, Any]:
    made = _flock(rng)
    return {
        "points": made["points"],
        "min_distances": np.maximum(rng.uniform(-0.2, 0.8, len(made["points"])), 0.0),
        "period": made["period"],
        "max_tests": made["max_tests"],
    }


def _braking(rng: Rng) -> dict[str, Any]:
    made = _spaced(rng)
    speeds = rng.normal(size=made["points"].shape)
    return {**made, "velocities": speeds, "sight": 2.0, "min_gap": 0.1}


def _apart(rng: Rng) -> dict[str, Any]:
    rounds = int(rng.integers(0, 12))
    return {**_spaced(rng), "max_passes": rounds, "relaxation": 0.6, "clearance": 1e-4}


CALLS: dict[str, Maker] = {
    "flock_accelerations": _flock,
    "flock_separate": _apart,
    "flock_braking": _braking,
}
UNBOUNDED: frozenset[str] = frozenset()
