"""Weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Gravity(Force):
    """The same acceleration everywhere."""

    acceleration: Vector = (0.0, -9.81, 0.0)  # [m/s²]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return np.outer(particles.masses, self.acceleration)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        return np.asarray(-particles.masses * (x @ np.asarray(self.acceleration)))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["acceleration"])
