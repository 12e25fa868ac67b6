"""What bodies do to each other, as integrators see it, and how close they come."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.sim.colliders import Poses
from animtool.systems.matter import StepSystem

# Bodies from which on a tree is faster than a direct sum, at an accuracy; cells that
# it looks at go with the accuracy to about this power.
CROSSOVER, CROSSOVER_ACCURACY, CROSSOVER_POWER = 1000, 2e-4, 0.4
# Pairs of the tree are float32: nothing below this can be asked of it.
FINEST_TREE = 1e-6


@dataclass(frozen=True, slots=True)
class Pulls:
    """How N bodies attract each other."""

    accelerations: FloatArray  # (N, 3) [m/s²]
    potentials: FloatArray  # (N,) [J/kg]
    # Largest squared frequency at which each would circle another ``(N,)`` [1/s²].
    rates: FloatArray


class TooCloseError(Exception):
    """Two bodies came too close for a step."""

    def __init__(self, t: float, points: FloatArray, rates: FloatArray) -> None:
        super().__init__()
        self.t, self.points, self.rates = t, points, rates


@dataclass(frozen=True, slots=True)
class Attractor:
    """A mass that attracts and goes where it is put."""

    mass: float  # [kg]
    softening: float  # [m]
    poses: Poses


@dataclass(frozen=True)
class Gravity:
    """The law by which bodies of some masses attract each other."""

    masses: FloatArray  # (N,) [kg]
    constant: float  # [m³/(kg s²)]
    softening: float  # [m]
    accuracy: float  # [1]
    attractors: Sequence[Attractor]

    @property
    def tree(self) -> bool:
        """Whether a tree is faster than a direct sum, and as accurate as is asked."""
        if self.accuracy < FINEST_TREE:
            return False
        share = (CROSSOVER_ACCURACY / self.accuracy) ** CROSSOVER_POWER
        return bool(len(self.masses) > CROSSOVER * share)

    def pulls(self, x: FloatArray) -> Pulls:
        """Return how bodies at points ``(N, 3)`` [m] attract each other."""
        accuracy = self.accuracy if self.tree else 0.0
        return Pulls(
            *_kernels.gravity(
                x,
                self.masses,
                self.constant,
                self.softening,
                accuracy,
            )
        )

    def outside(self, t: float, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return accelerations and potentials by attractors ``(N, 3)`` and ``(N,)``."""
        made, potentials = np.zeros_like(x), np.zeros(len(x))
        for one in self.attractors:
            off = one.poses.at(t)[:3] - x
            reach = np.sqrt((off * off).sum(axis=1) + one.softening**2)
            pull = self.constant * one.mass / np.maximum(reach, 1e-300)
            potentials -= pull
            made += (pull / np.maximum(reach, 1e-300) ** 2)[:, None] * off
        return made, potentials

    def closest(self, x: FloatArray, rates: FloatArray) -> tuple[int, int, float]:
        """Return the pair that circles fastest, and its distance [m]."""
        i = int(np.argmax(rates))
        off = x - x[i]
        squares = (off * off).sum(axis=1)
        reach = np.maximum(squares + self.softening**2, 1e-200) ** 1.5
        each = (self.masses + self.masses[i]) / reach
        each[i] = -1.0
        j = int(np.argmax(each))
        return min(i, j), max(i, j), math.sqrt(squares[j])

    def direct(self, x: FloatArray, rows: Sequence[int]) -> FloatArray:
        """Return accelerations of some bodies, summed pair by pair ``(M, 3)``."""
        found = np.zeros((len(rows), 3))
        for k, i in enumerate(rows):
            off = x - x[i]
            squares = (off * off).sum(axis=1)
            reach = np.where(squares > 0, squares + self.softening**2, np.inf)
            found[k] = self.constant * (self.masses / (reach * np.sqrt(reach))) @ off
        return found


class GravitySystem(StepSystem[Pulls]):
    """Bodies under gravity for one step.

    Args:
        gravity: How they attract each other.
        motion: Where they are, and how fast ``(2, N, 3)``.
        pulls: How they attract each other there.
        limit: Squared frequency of a pair from which on it is too close [1/s²].
    """

    def __init__(
        self, gravity: Gravity, motion: FloatArray, pulls: Pulls, limit: float
    ) -> None:
        super().__init__(motion, pulls)
        self._gravity, self._limit = gravity, limit

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:  # noqa: ARG002
        """Return accelerations ``(N, 3)`` [m/s²].

        Raises:
            TooCloseError: Two are too close for the step.
        """
        if not np.isfinite(x).all():
            return np.full_like(x, np.nan)
        pulls = self.at(x)
        if len(x) and pulls.rates.max() > self._limit:
            raise TooCloseError(t, x, pulls.rates)
        if not self._gravity.attractors:
            return pulls.accelerations
        return np.asarray(pulls.accelerations + self._gravity.outside(t, x)[0])

    def summed(self, x: FloatArray) -> Pulls:
        """Return how bodies at points attract each other."""
        return self._gravity.pulls(x)

    def suspect(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return which two are closest."""
        if not np.isfinite(state).all() or len(state[0]) < 2:
            return ""
        i, j, distance = self._gravity.closest(state[0], self.at(state[0]).rates)
        return f"bodies {i} and {j} are {distance:.3g} m apart"
