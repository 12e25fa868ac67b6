"""Steps of a fluid."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzz.kernels.colliders import colliders

Rng = np.random.Generator


def _steps(rng: Rng) -> dict[str, Any]:
    count, pushed = int(rng.choice([0, 1, 2, 20])), int(rng.integers(0, 3))
    state = rng.normal(scale=0.2, size=(2, count, 3))
    if count and rng.integers(2):
        state[0, -1] = state[0, 0]
    bodies = rng.normal(size=(pushed, 13))
    bodies[:, :4] = rng.uniform(0, 2, (pushed, 4))
    bodies[:, 4:7] = 0
    met = colliders(rng)
    return {
        "colliders": met,
        "owners": rng.integers(-1, pushed, len(met[0]), dtype=np.int32),
        "bodies": bodies,
        "state": state,
        "accelerations": rng.normal(scale=10, size=(count, 3)),
        "spacing": float(rng.choice([0.05, 0.1, 1.0])),
        "density": float(rng.uniform(1, 2000)),
        "viscosity": float(rng.choice([0.0, 1e-3])),
        "tension": float(rng.choice([0.0, 1.0])),
        "sound_speed": float(rng.uniform(1, 40)),
        "step": 0.005,
        "substeps": int(rng.integers(1, 5)),
    }


def _densities(rng: Rng) -> dict[str, Any]:
    return {
        "colliders": colliders(rng),
        "points": rng.normal(scale=0.2, size=(int(rng.choice([0, 1, 2, 20])), 3)),
        "spacing": float(rng.choice([0.05, 0.1, 1.0])),
    }


def _area(rng: Rng) -> dict[str, Any]:
    return {
        "points": rng.normal(scale=0.2, size=(int(rng.choice([0, 1, 2, 20])), 3)),
        "spacing": float(rng.choice([0.05, 0.1, 1.0])),
    }


CALLS = {"fluid_steps": _steps, "fluid_densities": _densities, "fluid_area": _area}
# Particles at one place, and beside surfaces of any shape, may be pushed far.
UNBOUNDED: frozenset[str] = frozenset(CALLS)
