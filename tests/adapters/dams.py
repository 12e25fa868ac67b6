"""Dam breaks of ``$ANIMTOOL_DATA/sim``: their particles, tank and targets."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Box, Collider, Colliders, Poses
from animtool.systems.fluid.fluid import Fluid, build
from animtool.systems.fluid.spec import FluidModel
from animtool.systems.particles.forces.table import find_force


@dataclass(frozen=True)
class Dam:
    """An instance of a file of dam breaks; y is up here, z there."""

    name: str
    params: dict[str, Any]
    reference: dict[str, float]
    targets: dict[str, Any]

    def start(self) -> FloatArray:
        """Return where its particles begin ``(N, 3)`` [m]."""
        axes = [np.arange(n) + 0.5 for n in self.params["column"]]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return np.ascontiguousarray(grid[:, [0, 2, 1]] * self.params["spacing"])

    @property
    def tank(self) -> FloatArray:
        """Sides of its tank ``(3,)`` [m]."""
        return np.array(self.params["tank"])[[0, 2, 1]]

    def fluid(self, **keys: Any) -> Fluid:
        """Return it as a fluid."""
        spec = {
            "name": "dam",
            "spacing": self.params["spacing"],
            "density": self.params["rest_density"],
            "fills": [{"points": "start.npz"}],
            **keys,
        }
        gravity = find_force("gravity")(acceleration=(0.0, -self.params["g"], 0.0))
        parts = {"fills": [{"points": self.start()}], "forces": [gravity]}
        tank = Collider(
            Box(tuple(self.tank)),
            Poses.fixed(self.tank / 2),
            name="tank",
            container=True,
        )
        return build(
            FluidModel.model_validate(spec), _Context(Colliders([tank]), parts)
        )

    def densities(self, points: FloatArray) -> FloatArray:
        """Return densities over that at rest ``(N,)``, as the file defines them."""
        from scipy.spatial import cKDTree

        radius, spacing = self.params["kernel_radius"], self.params["spacing"]
        far = np.arange(-4, 5) * spacing
        lattice = np.stack(np.meshgrid(far, far, far), axis=-1).reshape(-1, 3)
        whole = _poly6((lattice**2).sum(axis=1), radius).sum()
        pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
        off = points[pairs[:, 0]] - points[pairs[:, 1]]
        weights = _poly6((off**2).sum(axis=1), radius)
        sums = [np.bincount(pairs[:, k], weights, len(points)) for k in (0, 1)]
        return np.asarray((1.0 + sums[0] + sums[1]) / whole)


def _poly6(squared: FloatArray, radius: float) -> FloatArray:
    return np.asarray(np.maximum(1 - squared / radius**2, 0.0) ** 3)


class _Context:
    begin, last, budget = 0.0, 0.0, None

    def __init__(self, colliders: Colliders, parts: dict[str, Any]) -> None:
        self.colliders, self.entry_data = colliders, parts


def read_dams(path: Path) -> list[Dam]:
    """Return the dam breaks of a file, none where it holds none."""
    data = json.loads(path.read_text("utf-8"))
    if data.get("case") != "dam_break":
        return []
    return [
        Dam(one["id"], one["params"], one["reference"], one["targets"])
        for one in data["instances"]
    ]
