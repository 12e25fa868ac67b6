"""A force that is the same everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Uniform(Force):
    """The same force everywhere, whatever the mass."""

    push: Vector = (0.0, 0.0, 0.0)  # [N]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return np.tile(np.asarray(self.push, np.float64), (len(x), 1))

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        return -(x @ np.asarray(self.push, np.float64))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["push"])
