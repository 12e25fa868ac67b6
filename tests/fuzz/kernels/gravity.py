"""Bodies that attract each other, and molecules in a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool import _kernels
from fuzz.kernels import Maker

Rng = np.random.Generator


def _gravity(rng: Rng) -> dict[str, Any]:
    count = int(rng.choice([0, 1, 2, 17, 130, 300]))
    points = rng.normal(scale=10.0 ** rng.integers(-9, 9), size=(count, 3))
    if count and rng.integers(2):
        points[rng.integers(0, count, 40)] = points[0]
    return {
        "points": points,
        "masses": rng.uniform(0, 10.0 ** rng.integers(-9, 9), count),
        "constant": float(rng.uniform(0, 3)),
        "softening": float(rng.choice([0.0, 0.1, 10.0])),
        "accuracy": float(rng.choice([0.0, 1e-6, 1e-3, 0.1])),
    }


def _pairs(rng: Rng) -> dict[str, Any]:
    count, reach = int(rng.integers(0, 60)), float(rng.uniform(0.2, 2))
    return {
        "points": rng.normal(scale=10.0 ** rng.integers(-1, 4), size=(count, 3)),
        "box": 2 * reach * rng.uniform(1, 3, 3),
        "radius": reach,
        "max_pairs": 10**6,
    }


def _forces(rng: Rng) -> dict[str, Any]:
    given = _pairs(rng)
    count, kinds = len(given["points"]), int(rng.integers(1, 4))
    order, starts, partners = _kernels.molecule_pairs(**given)
    cutoff = 0.9 * given["radius"]
    return {
        "points": given["points"],
        "order": order,
        "starts": starts,
        "partners": partners,
        "box": given["box"],
        "kinds": rng.integers(0, kinds, count).astype(np.int32),
        "forces": rng.uniform(0, 1, (kinds, kinds, 2)),
        "charges": rng.normal(size=count) if rng.integers(2) else None,
        "cutoff": cutoff,
        "onset": float(rng.choice([0.0, 0.8, 1.0])) * cutoff,
        "damping": float(rng.uniform(0, 3)),
    }


CALLS: dict[str, Maker] = {
    "gravity": _gravity,
    "molecule_pairs": _pairs,
    "molecule_forces": _forces,
}
# Two molecules may be at one place.
UNBOUNDED: frozenset[str] = frozenset({"molecule_forces"})
