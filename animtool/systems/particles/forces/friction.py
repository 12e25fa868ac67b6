"""Friction that does not depend on the speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, at_least
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Friction(Force):
    """A brake against the velocity, as of what slides on a table everywhere.

    Of surfaces that particles touch, the colliders have their own.
    """

    deceleration: float = 0.0  # [m/s²]
    # Speed below which it goes to 0, so that nothing is pushed back [m/s].
    smooth: float = 0.01

    drains = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        speed = np.sqrt((v * v).sum(axis=1) + self.smooth**2)
        pull = self.deceleration * particles.masses / speed
        return np.asarray(-pull[:, None] * v)

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return how much it grows with velocity [kg/s]."""
        speed = np.sqrt((v * v).sum(axis=1) + self.smooth**2)
        return float((self.deceleration * particles.masses / speed).max(initial=0.0))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        found = at_least(self, ["deceleration", "smooth"])
        return found or ([] if self.smooth else [("smooth", "must be above 0")])
