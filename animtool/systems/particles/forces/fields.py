"""Force fields: expressions, turbulence, electromagnetism, charges.

References:
    R. Bridson, J. Hourihan, M. Nordenstam, "Curl-noise for procedural fluid flow",
    2007: the curl of any vector field has no divergence. The field is gradient noise:
    K. Perlin, "Improving noise", 2002.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.options import at_least
from animtool.core.record import dataclass
from animtool.systems.particles.forces.base import (
    Force,
    NonNegative,
    Positive,
    Time,
    Vector,
)
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.velocity_field import (
    VARIABLES,
    Expressions,
    evaluate_expressions,
    expression_faults,
)


@dataclass(frozen=True)
class Field(Expressions, Force):
    """Forces from expressions of x, y, z, vx, vy, vz, t, age, mass and charge."""

    x: str = "0"  # [N]
    y: str = "0"  # [N]
    z: str = "0"  # [N]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return evaluate_expressions(self.expressions, t, x, v, particles)

    def faults(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        return expression_faults(self, VARIABLES)


@dataclass(frozen=True)
class Turbulence(Force):
    """Divergence-free noise accelerations, zero on average."""

    strength: NonNegative = 1.0  # about the root mean square [m/s²]
    size: Positive = 1.0  # of the largest eddies [m]
    change: NonNegative = 0.5  # rate of change [1/s]
    # Octaves: each half the size and strength of the previous.
    octaves: Annotated[int, at_least(1, "SIM022", finite=True)] = 2
    seed: int = 0  # random seed

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        noise = np.zeros_like(x)
        for octave in range(self.octaves):
            frequency = 2.0**octave
            lattice_points = x * (frequency / self.size)
            times = np.broadcast_to(np.asarray(t, np.float64), len(x)) * self.change
            seed = (self.seed + octave) % 2**64
            noise += (
                _kernels.curl_noise(lattice_points, times * frequency, seed) / frequency
            )
        return noise * (self.strength * particles.masses[:, None])

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return zero Jacobians: turbulence has no restoring force."""
        zeros = np.zeros((len(x), 3, 3))
        return zeros, zeros


@dataclass(frozen=True)
class Electromagnetic(Force):
    """Lorentz force ``q (E + v ^ B)`` of uniform fields."""

    electric: Vector = (0.0, 0.0, 0.0)  # electric field [V/m]
    magnetic: Vector = (0.0, 0.0, 0.0)  # magnetic flux density [T]

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        magnetic_term = np.cross(v, np.asarray(self.magnetic, np.float64))
        return particles.charges[:, None] * (np.asarray(self.electric) + magnetic_term)

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray:
        """Return potential energies ``(N,)`` [J]."""
        return -particles.charges * (x @ np.asarray(self.electric, np.float64))

    def turning(self, particles: ParticleState) -> float:
        """Return the largest rate at which the force rotates velocities [rad/s]."""
        flux_density = float(np.linalg.norm(self.magnetic))
        charges_per_mass = np.abs(particles.charges) / particles.masses
        return flux_density * float(charges_per_mass.max(initial=0.0))


# Number of particles processed at once, to limit memory.
_BLOCK_SIZE = 256


@dataclass(frozen=True)
class Charges(Force):
    """Coulomb forces between all particles, softened at short range."""

    constant: NonNegative = 8.9875517862e9  # Coulomb constant [N m²/C²]
    softening: Positive = 0.01  # softening length [m]

    is_pair_force = True

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        fields = np.zeros_like(x)
        for first in range(0, len(x), _BLOCK_SIZE):
            block = slice(first, first + _BLOCK_SIZE)
            offsets = x[block, None] - x
            squared_distances = (offsets * offsets).sum(axis=2) + self.softening**2
            weights = particles.charges / squared_distances**1.5
            fields[block] = (offsets * weights[:, :, None]).sum(axis=1)
        return fields * (self.constant * particles.charges[:, None])
