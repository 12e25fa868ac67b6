"""Flocks of ``$ANIMTOOL_DATA/sim``, with their reference answers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders, Poses
from animtool.systems.flocks.flock import Flock, build
from animtool.systems.flocks.spec import FlocksModel
from animtool.systems.particles import Point

_MIXING = [(30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)]


@dataclass(frozen=True)
class Boids:
    """An instance of a file of flocks."""

    name: str
    params: dict[str, Any]
    first: dict[str, FloatArray]  # positions and velocities of the first five
    reference: dict[str, Any]
    statistics: dict[str, Any] | None

    def start(self) -> FloatArray:
        """Return positions and velocities ``(2, N, 3)``, as its generator has them."""
        params = self.params
        u = splitmix(params["seed"], 6 * params["n"]).reshape(-1, 6) - 0.5
        return np.stack([params["box"] * u[:, :3], 2 * params["speed"] * u[:, 3:]])

    def flock(self, method: str = "symplectic_euler", step: float = 0.01) -> Flock:
        """Return it as a flock: with a goal for what keeps it together."""
        params, (points, velocities) = self.params, self.start()
        radius, speed = params["radius"], params["speed"]
        species = {
            "name": "boid",
            "points": "start.npz",
            "vision": {"radius": radius},
            "attraction": {"weight": params["k_attract"]},
            "alignment": {"weight": params["k_align"]},
            "repulsion": {"weight": params["k_repulse"], "softening": params["eps"]},
            "speed": {"cruise": speed, "weight": params["k_speed"], "most": 1e6},
            "goals": [{"weight": params["k_home"]}],
        }
        spec = {"name": "boids", "species": [species], "method": method, "step": step}
        poses = Poses.fixed()
        parts = {
            "species": [
                {
                    "points": points,
                    "velocities": velocities,
                    "place": Point(),
                    "poses": poses,
                    "goals": [{"poses": poses}],
                }
            ]
        }
        return build(FlocksModel.model_validate(spec), _Context(parts))


class _Context:
    begin, last, colliders = 0.0, 0.0, Colliders([])

    def __init__(self, parts: dict[str, Any]) -> None:
        self.entry_data = parts


def read_boids(path: Path) -> list[Boids]:
    """Return the flocks of a file, none where it holds no flock."""
    data = json.loads(path.read_text("utf-8"))
    if data.get("case") != "boids":
        return []
    return [
        Boids(
            entry["id"],
            entry["params"],
            {key: np.array(rows) for key, rows in entry["initial_first5"].items()},
            entry["reference"],
            entry.get("statistics"),
        )
        for entry in data["instances"]
    ]


def splitmix(seed: int, count: int) -> FloatArray:
    """Return numbers in [0, 1) of splitmix64 ``(count,)``, the top 53 bits of each."""
    steps = np.arange(1, count + 1, dtype=np.uint64)
    z = np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15) * steps
    for shift, factor in _MIXING:
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    return np.asarray((z >> np.uint64(11)).astype(np.float64) * 2.0**-53)
