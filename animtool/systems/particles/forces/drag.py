"""Drag of air at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, at_least
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Drag(Force):
    """Drag against the velocity, by the speed and by its square."""

    linear: float = 0.0  # [kg/s]
    quadratic: float = 0.0  # half of density, area and coefficient together [kg/m]

    drains = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        if self.quadratic == 0:
            return -self.linear * v
        speed = np.linalg.norm(v, axis=1)[:, None]
        return np.asarray(-(self.linear + self.quadratic * speed) * v)

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return how much it grows with velocity [kg/s]."""
        speed = float(np.linalg.norm(v, axis=1).max(initial=0.0))
        return self.linear + 2 * self.quadratic * speed

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return at_least(self, ["linear", "quadratic"])
