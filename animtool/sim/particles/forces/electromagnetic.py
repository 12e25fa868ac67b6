"""The force of electric and magnetic fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.sim.particles.cloud import Cloud
from animtool.sim.particles.forces.force import Force, Time, Vector, three

__all__ = ["Electromagnetic"]


@dataclass(frozen=True)
class Electromagnetic(Force):
    """Lorentz's force ``q (E + v ^ B)`` of fields that are the same everywhere.

    Attributes:
        electric: Electric field [V/m].
        magnetic: Magnetic flux density [T].
    """

    electric: Vector = (0.0, 0.0, 0.0)
    magnetic: Vector = (0.0, 0.0, 0.0)

    def force(self, t: Time, x: FloatArray, v: FloatArray, cloud: Cloud) -> FloatArray:  # noqa: ARG002
        """Return forces ``(N, 3)`` [N]."""
        turned = np.cross(v, np.asarray(self.magnetic, np.float64))
        return cloud.charges[:, None] * (np.asarray(self.electric) + turned)

    def potential(self, x: FloatArray, cloud: Cloud) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        return -cloud.charges * (x @ np.asarray(self.electric, np.float64))

    def turning(self, cloud: Cloud) -> float:
        """Return how fast it turns velocities [rad/s]."""
        field = float(np.linalg.norm(self.magnetic))
        return field * float((np.abs(cloud.charges) / cloud.masses).max(initial=0.0))

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["electric", "magnetic"])
