"""What bodies do to each other, as integrators see it, and how close they come."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.systems.interacting import Law
from animtool.systems.nbody.spec import AttractorModel, NbodyModel

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

    def __init__(self, t: float, points: FloatArray, pulls: Pulls) -> None:
        super().__init__()
        self.t, self.points, self.rates = t, points, pulls.rates


def check_close(limit: float, t: float, x: FloatArray, pulls: Pulls) -> None:
    """Raise where a pair circles faster than a squared frequency [1/s²].

    Raises:
        TooCloseError: Two do.
    """
    if len(x) and pulls.rates.max() > limit:
        raise TooCloseError(t, x, pulls)


class Gravity(Law[Pulls]):
    """The law by which bodies of some masses attract each other.

    Attributes:
        masses: ``(N,)`` [kg].
        tree: Whether a tree is faster than a direct sum, and as accurate as is asked.
    """

    def __init__(
        self,
        spec: NbodyModel,
        masses: FloatArray,
        attractors: Sequence[Mapping[str, Any]],
    ) -> None:
        super().__init__(spec.attractors, attractors)
        self.masses = masses
        self._constant, self._softening = spec.gravity_constant, spec.softening
        share = CROSSOVER_ACCURACY / max(spec.accuracy, FINEST_TREE)
        many = len(masses) > CROSSOVER * share**CROSSOVER_POWER
        self.tree = spec.accuracy >= FINEST_TREE and many
        self._accuracy = spec.accuracy if self.tree else 0.0

    def pulls(self, x: FloatArray) -> Pulls:
        """Return how bodies at points ``(N, 3)`` [m] attract each other."""
        return Pulls(
            *_kernels.gravity(
                x, self.masses, self._constant, self._softening, self._accuracy
            )
        )

    def summed(self, x: FloatArray, before: Pulls) -> Pulls:  # noqa: ARG002
        """Return how bodies at points ``(N, 3)`` [m] attract each other."""
        return self.pulls(x)

    def accelerated(self, t: float, x: FloatArray, sums: Pulls) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²]."""
        if not self.placed:
            return sums.accelerations
        return np.asarray(sums.accelerations + self.outside(t, x)[0])

    def from_placed(
        self, one: AttractorModel, at: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return accelerations ``(N, 3)`` [m/s²] and potentials ``(N,)`` [J/kg]."""
        off = at - x
        reach = np.sqrt((off * off).sum(axis=1) + one.softening**2)
        reach = np.maximum(reach, 1e-300)
        pull = self._constant * one.mass / reach
        return (pull / reach**2)[:, None] * off, -pull

    def suspect(self, x: FloatArray, sums: Pulls) -> str:
        """Return which two are closest."""
        if len(x) < 2:
            return ""
        i, j, distance = self.closest(x, sums.rates)
        return f"bodies {i} and {j} are {distance:.3g} m apart"

    def closest(self, x: FloatArray, rates: FloatArray) -> tuple[int, int, float]:
        """Return the pair that circles fastest, and its distance [m]."""
        i = int(np.argmax(rates))
        off = x - x[i]
        squares = (off * off).sum(axis=1)
        reach = np.maximum(squares + self._softening**2, 1e-200) ** 1.5
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
            reach = np.where(squares > 0, squares + self._softening**2, np.inf)
            found[k] = self._constant * (self.masses / (reach * np.sqrt(reach))) @ off
        return found
