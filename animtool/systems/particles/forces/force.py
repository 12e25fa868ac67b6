"""What a force on particles is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from animtool._types import FloatArray
from animtool.systems.particles.state import ParticleState

Vector: TypeAlias = tuple[float, float, float]
# One for all particles, or one each ``(N,)`` [s].
Time: TypeAlias = "float | FloatArray"


class Force(ABC):
    """A force on particles; a record of its options.

    Attributes:
        pairs: Whether particles act on each other.
        drains: Whether it takes energy from particles and never gives any.
    """

    pairs: bool = False
    drains: bool = False

    @abstractmethod
    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N] at positions and velocities ``(N, 3)``."""

    def potential(self, x: FloatArray, particles: ParticleState) -> FloatArray | None:
        """Return energies ``(N,)`` [J], None of a force that has none."""
        return np.zeros(len(x)) if self.drains else None

    def stiffness(self) -> float:
        """Return how much it grows with the way from where it is 0 [N/m]."""
        return 0.0

    def damping(self, v: FloatArray, particles: ParticleState) -> float:
        """Return how much it grows with velocity, against it [kg/s]."""
        return 0.0

    def turning(self, particles: ParticleState) -> float:
        """Return how fast it turns velocities [rad/s]."""
        return 0.0

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return []


def at_least(
    given: object, names: Sequence[str], least: float = 0.0
) -> list[tuple[str, str]]:
    """Return the options that are not finite, or below a bound."""
    return [
        (name, f"must be finite and at least {least:g}, not {value:g}")
        for name in names
        if not (least <= (value := getattr(given, name)) < math.inf)
    ]


def three(given: object, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the options that are no three finite numbers."""
    return [
        (name, "must be three finite numbers")
        for name in names
        if (value := getattr(given, name)) is not None
        and not (len(value) == 3 and np.isfinite(value).all())
    ]
