"""Wind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, at_least, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Wind(Force):
    """Air that moves and takes particles along."""

    velocity: Vector = (0.0, 0.0, 0.0)  # of the air [m/s]
    drag: float = 0.0  # of particles in it [kg/s]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return self.drag * (np.asarray(self.velocity, np.float64) - v)

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return how much it grows with velocity [kg/s]."""
        return self.drag

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["velocity"]) + at_least(self, ["drag"])
