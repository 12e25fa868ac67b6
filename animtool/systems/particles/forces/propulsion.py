"""A thrust of particles' own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, Vector, at_least, three
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Propulsion(Force):
    """A thrust along the velocity, or in a direction."""

    thrust: float = 0.0  # [N]; below 0 it brakes
    direction: Vector | None = None  # of any length above 0; None is along the velocity
    duration: float = math.inf  # from birth on [s]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        way = v
        if self.direction is not None:
            way = np.broadcast_to(np.asarray(self.direction, np.float64), x.shape)
        length = np.linalg.norm(way, axis=1)[:, None]
        along = np.divide(way, length, out=np.zeros_like(x), where=length > 0)
        burns = (t - particles.births <= self.duration)[:, None]
        return np.asarray(self.thrust * along * burns)

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        found = three(self, ["direction"])
        if self.direction is not None and not any(self.direction):
            found.append(("direction", "must not be all 0"))
        if not math.isfinite(self.thrust):
            found.append(("thrust", "is not finite"))
        if self.duration != math.inf:
            found += at_least(self, ["duration"])
        return found
