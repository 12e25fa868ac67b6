"""A spring from each particle to a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, at_least, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Spring(Force):
    """A spring to a point, or to where each particle was born."""

    anchor: Vector | None = None  # the point [m]; None is where each was born
    k: float = 1.0  # stiffness [N/m]
    rest: float = 0.0  # length at which it pulls nobody [m]
    kd: float = 0.0  # damping against change of its length [kg/s]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        off = x - self._anchors(particles)
        if self.rest == 0 and self.kd == 0:
            return -self.k * off
        length = np.linalg.norm(off, axis=1)[:, None]
        along = np.divide(off, length, out=np.zeros_like(off), where=length > 0)
        rate = (v * along).sum(axis=1)[:, None]
        return np.asarray(-(self.k * (length - self.rest) + self.kd * rate) * along)

    def _anchors(self, particles: ParticleState) -> FloatArray:
        return particles.origins if self.anchor is None else np.asarray(self.anchor)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return energies ``(N,)`` [J]."""
        stretch = np.linalg.norm(x - self._anchors(particles), axis=1) - self.rest
        return np.asarray(0.5 * self.k * stretch**2)

    def stiffness(self) -> float:
        """Return its stiffness [N/m]."""
        return self.k

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return its damping [kg/s]."""
        return self.kd

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return three(self, ["anchor"]) + at_least(self, ["k", "rest", "kd"])
