"""Discs of ``$ANIMTOOL_DATA/sim`` under their own gravity, with reference answers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from adapters.boids import splitmix

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.nbody.nbody import Nbody, build
from animtool.systems.nbody.spec import NbodyModel


@dataclass(frozen=True)
class Disc:
    """An instance of a file of discs."""

    name: str
    params: dict[str, Any]
    first: dict[str, FloatArray]  # positions and velocities of the first five
    reference: dict[str, Any]
    trajectory: dict[str, Any] | None

    def start(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and masses, as its generator has them."""
        p = self.params
        n, size, eps = p["n"], p["radius"], p["softening"]
        u = splitmix(p["seed"], 4 * n).reshape(-1, 4)
        r, angle = size * np.sqrt(0.01 + 0.99 * u[:, 0]), 2 * np.pi * u[:, 1]
        cos, sin = np.cos(angle), np.sin(angle)
        within = p["mass_central"] + p["mass_disc"] * (r / size) ** 2
        speed = np.sqrt(p["G"] * within * r**2 / (r**2 + eps**2) ** 1.5)
        x = np.stack([r * cos, r * sin, 0.02 * size * (u[:, 2] - 0.5)], axis=1)
        v = np.stack([-speed * sin, speed * cos, 0 * r], axis=1)
        masses = np.full(n, p["mass_disc"] / n)
        x[0] = v[0] = 0
        masses[0] = p["mass_central"]
        return x, v, masses

    def nbody(self, step: float = 1e-3, **keys: Any) -> Nbody:
        """Return it as a system."""
        return nbody(
            *self.start(), self.params["G"], self.params["softening"], step, **keys
        )


class _Context:
    begin, last, colliders, budget = 0.0, 0.0, Colliders([]), None

    def __init__(self, parts: dict[str, Any]) -> None:
        self.entry_data = parts


def nbody(
    x: FloatArray,
    v: FloatArray,
    masses: FloatArray,
    constant: float,
    softening: float,
    step: float,
    **keys: Any,
) -> Nbody:
    """Return bodies as a system."""
    spec = {
        "name": "bodies",
        "bodies": [{"points": "start.npz"}],
        "gravity_constant": constant,
        "softening": softening,
        "step": step,
        **keys,
    }
    parts = {"bodies": [{"points": x, "velocities": v, "masses": masses}]}
    return build(NbodyModel.model_validate(spec), _Context(parts))


def read_discs(path: Path) -> list[Disc]:
    """Return the discs of a file, none where it holds no disc."""
    data = json.loads(path.read_text("utf-8"))
    if data.get("case") != "nbody_disc":
        return []
    return [
        Disc(
            entry["id"],
            entry["params"],
            {key: np.array(rows) for key, rows in entry["initial_first5"].items()},
            entry["reference"],
            entry.get("trajectory"),
        )
        for entry in data["instances"]
    ]
