"""Turbulence: noise without sources, from a seed.

References:
    R. Bridson, J. Hourihan, M. Nordenstam, "Curl-noise for procedural fluid flow",
    2007: the curl of any vector field has no divergence. The field is gradient noise:
    K. Perlin, "Improving noise", 2002.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.systems.particles.forces.force import Force, Time, at_least
from animtool.systems.particles.state import ParticleState


@dataclass(frozen=True)
class Turbulence(Force):
    """Accelerations that swirl and go nowhere in the mean."""

    strength: float = 1.0  # about the root mean square [m/s²]
    size: float = 1.0  # of the largest swirls [m]
    change: float = 0.5  # how often a second they become others [1/s]
    octaves: int = 2  # sizes of swirls, each half of the one before and half as strong
    seed: int = 0  # of what is random

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        found = np.zeros_like(x)
        for octave in range(self.octaves):
            finer = 2.0**octave
            places = x * (finer / self.size)
            times = np.broadcast_to(np.asarray(t, np.float64), len(x)) * self.change
            seed = (self.seed + octave) % 2**64
            found += _kernels.curl_noise(places, times * finer, seed) / finer
        return found * (self.strength * particles.masses[:, None])

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        found = at_least(self, ["strength", "change"])
        found += at_least(self, ["octaves"], 1)
        if not 0 < self.size < np.inf:
            found.append(("size", f"must be above 0, not {self.size:g}"))
        return found
