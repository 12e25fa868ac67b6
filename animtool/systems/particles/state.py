"""Particle attributes besides positions and velocities."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.rows import Rows


@dataclass(frozen=True, slots=True)
class ParticleState(Rows):
    """N particles, in order of birth.

    Attributes:
        ids: Unique ids, never reused ``(N,)``.
        masses: Masses ``(N,)`` [kg].
        charges: Electric charges ``(N,)`` [C].
        radii: Radii ``(N,)`` [m].
        births: Birth times ``(N,)`` [s].
        deaths: Times of death ``(N,)`` [s]; infinity for never.
        origins: Birth positions ``(N, 3)`` [m].
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
    def everlasting(
        ids: IntArray,
        masses: FloatArray | float,
        radii: FloatArray | float,
        births: FloatArray | float,
        origins: FloatArray,
    ) -> ParticleState:
        """Return uncharged particles that live forever."""
        arrays = [masses, 0.0, radii, births, np.inf]
        mass, charge, radius, birth, death = (
            np.array(np.broadcast_to(value, len(ids)), np.float64) for value in arrays
        )
        return ParticleState(ids, mass, charge, radius, birth, death, origins)

    @staticmethod
    def empty() -> ParticleState:
        """Return a record without particles."""
        no_ids = np.zeros(0, np.int64)
        return ParticleState.everlasting(no_ids, 0.0, 0.0, 0.0, np.zeros((0, 3)))
