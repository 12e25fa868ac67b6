"""Particle attributes other than positions and velocities."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.rows import Rows


@dataclass(frozen=True, slots=True)
class ParticleState(Rows):
    """N particles, in order of birth.

    Attributes:
        ids: Of each its own, never used again ``(N,)``.
        masses: ``(N,)`` [kg].
        charges: ``(N,)`` [C].
        radii: ``(N,)`` [m].
        births: When each was born ``(N,)`` [s].
        deaths: When each goes ``(N,)`` [s]; infinity is never.
        origins: Where each was born ``(N, 3)`` [m].
    """

    ids: IntArray
    masses: FloatArray
    charges: FloatArray
    radii: FloatArray
    births: FloatArray
    deaths: FloatArray
    origins: FloatArray

    def __len__(self) -> int:
        """Return the number of particles."""
        return len(self.ids)

    @staticmethod
    def lasting(
        ids: IntArray,
        masses: FloatArray | float,
        radii: FloatArray | float,
        births: FloatArray | float,
        origins: FloatArray,
    ) -> ParticleState:
        """Return uncharged, immortal particles from per-particle values."""
        every = [masses, 0.0, radii, births, np.inf]
        mass, charge, radius, birth, death = (
            np.array(np.broadcast_to(one, len(ids)), np.float64) for one in every
        )
        return ParticleState(ids, mass, charge, radius, birth, death, origins)

    @staticmethod
    def none() -> ParticleState:
        """Return no particles."""
        nothing = np.zeros(0, np.int64)
        return ParticleState.lasting(nothing, 0.0, 0.0, 0.0, np.zeros((0, 3)))
