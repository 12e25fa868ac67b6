"""Drag of a viscous fluid at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, at_least
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Viscosity(Force):
    """Stokes's law: ``6 π η r v`` against the velocity of small, slow balls."""

    viscosity: float = 1e-3  # of the fluid [Pa s]; of water 1e-3, of air 1.8e-5

    drains = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return -6 * np.pi * self.viscosity * particles.radii[:, None] * v

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return how much it grows with velocity [kg/s]."""
        return 6 * np.pi * self.viscosity * float(particles.radii.max(initial=0.0))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return at_least(self, ["viscosity"])
