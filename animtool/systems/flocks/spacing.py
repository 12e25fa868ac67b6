"""Minimum distances between members: braking and separation."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.rules import max_pairs, wrapping
from animtool.systems.flocks.spec import DomainModel, SpeciesModel

# Members brake for others within this many minimum distances.
SIGHT = 2.0
# Least braking room, over the minimum distance.
ROOM = 0.1
# Separation passes in a step, and at the start; each moves by this fraction.
PASSES, FIRST_PASSES, RELAXATION = 24, 400, 0.6
# Extra clearance, over the minimum distance.
CLEAR = 1e-4


def least_distance(species: SpeciesModel) -> float:
    """Return the minimum distance of a species [m]; 0 for none.

    Twice the radius; members without a stated radius or shape are points.
    """
    repulsion = species.repulsion
    if repulsion.least is not None:
        return repulsion.least
    sized = "radius" in species.model_fields_set or species.shows is not None
    return 2 * species.radius if sized and repulsion.weight else 0.0


@dataclass(frozen=True)
class Spacing:
    """Minimum distances of N members; pairs use the mean of both."""

    distances: FloatArray  # minimum distances (N,) [m]; 0 for none
    period: FloatArray  # origin and length of each axis (2, 3) [m], 0 if not periodic

    @staticmethod
    def of(members: Members, domain: DomainModel | None) -> Spacing | None:
        """Return the spacing of members; None without minimum distances."""
        distances = members.each([least_distance(one) for one in members.entries])
        keeps = len(distances) > 1 and distances.max() > 0
        return Spacing(distances, wrapping(domain)) if keeps else None

    def braking(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return braking accelerations ahead of others ``(N, 3)`` [m/s²].

        Of two that close in each takes half: the square of their speed over twice the
        room that is left, the more the nearer they are.

        Raises:
            ToleranceError: Too many close pairs: a step would take minutes (SIM107).
        """
        most = max_pairs(len(x))
        brakes, looked = _kernels.flock_braking(
            x, v, self.distances, SIGHT, ROOM, self.period, most
        )
        self._check(len(x), looked, most)
        return np.asarray(brakes)

    def separated(
        self, x: FloatArray, rounds: int = PASSES
    ) -> tuple[FloatArray, float]:
        """Return separated positions ``(N, 3)`` [m], and the remaining overlap.

        Raises:
            ToleranceError: Too many close pairs: a step would take minutes (SIM107).
        """
        most = max_pairs(len(x))
        moved, overlap, looked = _kernels.flock_apart(
            x, self.distances, rounds, RELAXATION, CLEAR, self.period, most
        )
        self._check(len(x), looked, most)
        return moved, overlap

    @staticmethod
    def _check(count: int, looked: float, most: float) -> None:
        if looked > most:
            message = (
                f"{count} members are so close that each has thousands of neighbours"
            )
            hint = "use a larger start region, or a smaller distance"
            raise ToleranceError(Fault("SIM107", message, hint=hint))
