"""A pull to a point that a power of the distance gives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, at_least, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Central(Force):
    """Acceleration towards a centre."""

    centre: Vector = (0.0, 0.0, 0.0)  # [m]
    strength: float = 1.0  # acceleration at one metre [m/s²]; below 0 it pushes
    power: float = -2.0  # of the distance: -2 is that of gravity and of charges
    softening: float = 0.01  # length that keeps it finite at the centre [m]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        off = np.asarray(self.centre) - x
        distance = self._distance(x)[:, None]
        return np.asarray(
            particles.masses[:, None]
            * off
            * self.strength
            * distance ** (self.power - 1)
        )

    def _distance(self, x: FloatArray) -> FloatArray:
        off = x - np.asarray(self.centre)
        return np.asarray(np.sqrt((off * off).sum(axis=1) + self.softening**2))

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        distance = self._distance(x)
        if self.power == -1:
            return np.asarray(particles.masses * self.strength * np.log(distance))
        raised = distance ** (self.power + 1) / (self.power + 1)
        return np.asarray(particles.masses * self.strength * raised)

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        found = three(self, ["centre"]) + at_least(self, ["softening"])
        found += [
            (name, "is not finite")
            for name in ("strength", "power")
            if not math.isfinite(getattr(self, name))
        ]
        if self.power < 1 and not self.softening > 0:
            found.append(("softening", "must be above 0 where the power is below 1"))
        return found
