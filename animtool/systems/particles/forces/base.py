"""The base class of forces on particles."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Annotated, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.options import Range, at_least, range_faults
from animtool.systems.particles.state import ParticleState

# Types of options.
_VECTOR = Range("three finite numbers", "SIM022", -math.inf, finite=True, count=3)
Vector: TypeAlias = Annotated[tuple[float, float, float], _VECTOR]
AnyVector: TypeAlias = Annotated[tuple[float, float, float] | None, _VECTOR]
Finite: TypeAlias = Annotated[float, Range("finite", "SIM022", -math.inf, finite=True)]
NonNegative: TypeAlias = Annotated[float, at_least(0.0, "SIM022", finite=True)]
Positive: TypeAlias = Annotated[
    float, Range("above 0", "SIM022", 0.0, includes_minimum=False, finite=True)
]
# A time for all particles, or one per particle ``(N,)`` [s].
Time: TypeAlias = "float | FloatArray"

# Finite difference step, relative to positions [m] and velocities [m/s]; at least this.
DIFFERENCE_STEP = 1e-6


def unit_vectors(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors ``(N, 3)``, 0 for vectors of 0, and lengths ``(N, 1)``."""
    lengths = np.linalg.norm(vectors, axis=1)[:, None]
    zeros = np.zeros_like(vectors)
    return np.divide(vectors, lengths, out=zeros, where=lengths > 0), lengths


class Force(ABC):
    """A force on particles, and its options.

    Attributes:
        is_pair_force: Whether particles act on each other.
        is_dissipative: Whether it only removes energy from particles.
        is_variable: Whether it depends on positions, velocities or time.
    """

    is_pair_force: bool = False
    is_dissipative: bool = False
    is_variable: bool = True

    @abstractmethod
    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N] at positions and velocities ``(N, 3)``."""

    def jacobians(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of each force with respect to position and velocity.

        Both are ``(N, 3, 3)`` [N/m] and [kg/s]; by default from finite differences, and
        0 for pair forces. The Jacobians need not be exact: methods are stable if they
        are about as steep as the force.
        """
        by_position, by_velocity = np.zeros((2, len(x), 3, 3))
        if self.is_pair_force:
            return by_position, by_velocity
        for k in range(3):
            offset = np.zeros_like(x)
            offset[:, k] = DIFFERENCE_STEP * np.maximum(np.abs(x).max(axis=1), 1.0)
            forward, backward = (
                self.force(t, x + sign * offset, v, particles) for sign in (1, -1)
            )
            by_position[:, :, k] = (forward - backward) / (2 * offset[:, k, None])
            offset[:, k] = DIFFERENCE_STEP * np.maximum(np.abs(v).max(axis=1), 1.0)
            forward, backward = (
                self.force(t, x, v + sign * offset, particles) for sign in (1, -1)
            )
            by_velocity[:, :, k] = (forward - backward) / (2 * offset[:, k, None])
        return by_position, by_velocity

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray | None:
        """Return potential energies ``(N,)`` [J]; None if it has no potential."""
        return np.zeros(len(x)) if self.is_dissipative else None

    def stiffness(self) -> float:
        """Return the largest stiffness: force per displacement [N/m]."""
        return 0.0

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return the largest damping coefficient: force per speed [kg/s]."""
        return 0.0

    def turning(self, particles: ParticleState) -> float:
        """Return the largest rate at which the force rotates velocities [rad/s]."""
        return 0.0

    def faults(self) -> list[tuple[str, str]]:
        """Return the names of invalid options, each with a message."""
        faults = range_faults(self, "must be {bound}, not {value:g}")
        return [(str(fault.where), fault.message) for fault in faults]
