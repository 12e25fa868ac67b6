"""The force of charges on each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, at_least
from animtool.systems.particles.state import ParticleState

# Pairs at once: this bounds memory.
_ROWS = 256


@dataclass(frozen=True)
class Charges(Force):
    """Coulomb's law between all particles, softened where they are close."""

    constant: float = 8.9875517862e9  # coulomb's [N m²/C²]
    softening: float = 0.01  # length that keeps it finite [m]

    pairs = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        found = np.zeros_like(x)
        for first in range(0, len(x), _ROWS):
            rows = slice(first, first + _ROWS)
            off = x[rows, None] - x
            squared = (off * off).sum(axis=2) + self.softening**2
            weights = particles.charges / squared**1.5
            found[rows] = (off * weights[:, :, None]).sum(axis=1)
        return found * (self.constant * particles.charges[:, None])

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        found = at_least(self, ["constant", "softening"])
        if self.softening == 0:
            found.append(("softening", "must be above 0"))
        return found
