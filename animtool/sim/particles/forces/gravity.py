"""Weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.sim.particles.cloud import Cloud
from animtool.sim.particles.forces.force import Force, Time, Vector, three

__all__ = ["Gravity"]


@dataclass(frozen=True)
class Gravity(Force):
    """The same acceleration everywhere.

    Attributes:
        acceleration: [m/s²].
    """

    acceleration: Vector = (0.0, -9.81, 0.0)

    def force(self, t: Time, x: FloatArray, v: FloatArray, cloud: Cloud) -> FloatArray:  # noqa: ARG002
        """Return forces ``(N, 3)`` [N]."""
        return np.outer(cloud.masses, self.acceleration)

    def potential(self, x: FloatArray, cloud: Cloud) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        return np.asarray(-cloud.masses * (x @ np.asarray(self.acceleration)))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["acceleration"])
