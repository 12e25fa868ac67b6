"""Minimum distances between members: braking and separation."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.rules import check_pair_count, max_pairs, periodic_box
from animtool.systems.flocks.spec import DomainModel, SpeciesModel

# Distance at which members brake for others, in minimum distances [1].
BRAKING_RANGE = 2.0
# Smallest gap in the braking deceleration, relative to the minimum distance [1].
MIN_BRAKING_GAP = 0.1
# Separation passes in a step and at the start, and the fraction of the overlap that a
# pass removes.
STEP_PASSES, START_PASSES, RELAXATION = 24, 400, 0.6
# Additional clearance, relative to the minimum distance [1].
CLEARANCE = 1e-4
REMEDY_HINT = "use a larger start region, or a smaller distance"


def min_distance(species: SpeciesModel) -> float:
    """Return the minimum distance of members of a species [m]; 0 for none.

    The default is twice the radius; members without a specified radius or mesh are
    points.
    """
    repulsion = species.repulsion
    if repulsion.least is not None:
        return repulsion.least
    has_size = "radius" in species.model_fields_set or species.shows is not None
    return 2 * species.radius if has_size and repulsion.weight else 0.0


@dataclass(frozen=True)
class Spacing:
    """Minimum distances of N members; that of a pair is the mean of both."""

    distances: FloatArray  # minimum distances (N,) [m]; 0 for none
    period: FloatArray  # origin and length of each axis (2, 3) [m], 0 if not periodic

    @staticmethod
    def for_members(members: Members, domain: DomainModel | None) -> Spacing | None:
        """Return the spacing of members; None without minimum distances."""
        distances = members.repeat_per_individual(
            [min_distance(entry) for entry in members.entries]
        )
        has_distances = len(distances) > 1 and distances.max() > 0
        return Spacing(distances, periodic_box(domain)) if has_distances else None

    def braking_accelerations(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return the decelerations for members ahead ``(N, 3)`` [m/s²].

        Each of two approaching members contributes half of the deceleration: the
        squared closing speed over twice the remaining gap, weighted by proximity.
        """
        limit = max_pairs(len(x))
        accelerations, pair_count = _kernels.flock_braking(
            x, v, self.distances, BRAKING_RANGE, MIN_BRAKING_GAP, self.period, limit
        )
        check_pair_count(len(x), pair_count, limit, REMEDY_HINT)
        return np.asarray(accelerations)

    def separate(
        self, x: FloatArray, pass_count: int = STEP_PASSES
    ) -> tuple[FloatArray, float]:
        """Return separated positions ``(N, 3)`` [m], and the remaining overlap [m]."""
        limit = max_pairs(len(x))
        separated_points, overlap, pair_count = _kernels.flock_separate(
            x, self.distances, pass_count, RELAXATION, CLEARANCE, self.period, limit
        )
        check_pair_count(len(x), pair_count, limit, REMEDY_HINT)
        return separated_points, overlap
