"""The force of electric and magnetic fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Electromagnetic(Force):
    """Lorentz's force ``q (E + v ^ B)`` of fields that are the same everywhere."""

    electric: Vector = (0.0, 0.0, 0.0)  # electric field [V/m]
    magnetic: Vector = (0.0, 0.0, 0.0)  # magnetic flux density [T]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        turned = np.cross(v, np.asarray(self.magnetic, np.float64))
        return particles.charges[:, None] * (np.asarray(self.electric) + turned)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        return -particles.charges * (x @ np.asarray(self.electric, np.float64))

    def turning(self, particles: ParticleState) -> float:
        """Return how fast it turns velocities [rad/s]."""
        field = float(np.linalg.norm(self.magnetic))
        return field * float(
            (np.abs(particles.charges) / particles.masses).max(initial=0.0)
        )

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["electric", "magnetic"])
