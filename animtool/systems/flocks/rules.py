"""Rules between members in sight, and their minimum distances: kernel calls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.spec import DomainModel, SpeciesModel

IndexArray: TypeAlias = npt.NDArray[np.int32]
# Largest number of neighbour pairs per member on average, and in total. Beyond both,
# thousands of members see each other and a step takes minutes.
MAX_PAIRS_PER_MEMBER, MAX_PAIRS = 20_000, 2_000_000_000
# Distance at which members brake for others, in minimum distances [1].
BRAKING_RANGE = 2.0
# Smallest gap in the braking deceleration, relative to the minimum distance [1].
MIN_BRAKING_GAP = 0.1
# Separation passes in a step and at the start, and the fraction of the overlap that a
# pass removes.
STEP_PASSES, START_PASSES, OVERLAP_REDUCTION = 24, 400, 0.6
# Additional clearance, relative to the minimum distance [1].
SEPARATION_CLEARANCE = 1e-4
REMEDY_HINT = "use a larger start region, or a smaller distance"


@dataclass(frozen=True, slots=True)
class FlockRule:
    """A rule of one species towards other members, as kernel arguments."""

    members: IndexArray | None  # members that follow the rule (M,); None for all
    targets: IndexArray | None  # members that the rule reacts to; None for all
    radius: float  # range of sight [m]
    view_cosine: float = -1.0  # cosine of half the angle of view
    nearest: int = 0  # number of nearest neighbours; 0 for all
    attraction: tuple[float, float] = (0.0, 0.0)  # weight [1/s²] and range [m]
    alignment: tuple[float, float] = (0.0, 0.0)  # weight [1/s] and range [m]
    repulsion: tuple[float, float] = (0.0, 0.0)  # weight [m²/s²] and range [m]
    softening: float = 0.0  # softening length of the repulsion [m]


def build_rules(members: Members) -> list[FlockRule]:
    """Return the rules of all species that have an effect."""
    rules = []
    species_names = [species.name for species in members.entries]
    for species_index, species in enumerate(members.entries):
        followers = _member_indices(members, [species_index])
        mate_species = {
            species_index,
            *(species_names.index(name) for name in species.joins),
        }
        mates = _member_indices(members, sorted(mate_species))
        rules.append(_build_flocking_rule(species, followers, mates))
        for flee in species.flees:
            targets = _member_indices(members, [species_names.index(flee.species)])
            rule = FlockRule(followers, targets, flee.radius)
            repulsion = (flee.weight, flee.radius)
            softening = species.repulsion.softening
            rules.append(replace(rule, repulsion=repulsion, softening=softening))
        for chase in species.chases:
            targets = _member_indices(members, [species_names.index(chase.species)])
            rule = FlockRule(followers, targets, chase.radius)
            attraction = (chase.weight, chase.radius)
            rules.append(replace(rule, nearest=1, attraction=attraction))
    return [rule for rule in rules if _has_effect(rule)]


def _build_flocking_rule(
    species: SpeciesModel, followers: IndexArray | None, mates: IndexArray | None
) -> FlockRule:
    """Return the rule of a species towards members of this and of joined species."""
    vision, repulsion = species.vision, species.repulsion

    def clamp_radius(radius: float | None) -> float:
        return vision.radius if radius is None else min(radius, vision.radius)

    return FlockRule(
        followers,
        mates,
        vision.radius,
        -1.0 if vision.angle == 360 else float(np.cos(np.radians(vision.angle / 2))),
        vision.nearest or 0,
        (species.attraction.weight, clamp_radius(species.attraction.radius)),
        (species.alignment.weight, clamp_radius(species.alignment.radius)),
        (repulsion.weight, clamp_radius(repulsion.radius)),
        repulsion.softening,
    )


def _has_effect(rule: FlockRule) -> bool:
    """Return whether a rule has any members and a nonzero weight."""
    weights = (rule.attraction[0], rule.alignment[0], rule.repulsion[0])
    counts = [
        len(indices) for indices in (rule.members, rule.targets) if indices is not None
    ]
    return any(weights) and 0 not in counts


def _member_indices(members: Members, species: Sequence[int]) -> IndexArray | None:
    """Return the member indices of the given species ``(M,)``; None for all species."""
    if len(species) == len(members.entries):
        return None
    index_ranges = [
        np.arange(len(members))[members.ranges_by_entry[number]] for number in species
    ]
    return np.concatenate(index_ranges).astype(np.int32)


def periodic_box(domain: DomainModel | None) -> FloatArray:
    """Return the origin and period of each axis ``(2, 3)`` [m]; 0 if not periodic."""
    period = np.zeros((2, 3))
    if domain is not None and domain.wrap:
        period[1] = domain.size
        period[0] = np.subtract(domain.at, period[1] / 2)
    return period


def max_pairs(count: int) -> float:
    """Return the largest allowed number of neighbour pairs of N members."""
    return float(max(MAX_PAIRS_PER_MEMBER * count, MAX_PAIRS))


def check_pair_count(member_count: int, pair_count: float, hint: str) -> None:
    """Raise SIM107 if more than `max_pairs` of N members are neighbours."""
    if pair_count > max_pairs(member_count):
        message = (
            f"{member_count} members are so close that each has thousands of neighbours"
        )
        raise ToleranceError(Fault("SIM107", message, hint=hint))


def rule_accelerations(
    rules: Sequence[FlockRule], domain: DomainModel | None, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return the accelerations of all flocking rules ``(N, 3)`` [m/s²].

    Positions [m] and velocities [m/s] are ``(N, 3)``.
    """
    period = periodic_box(domain)
    accelerations_sum = np.zeros_like(x)
    for rule in rules:
        count = len(x) if rule.members is None else len(rule.members)
        accelerations, _, pair_count = _kernels.flock_accelerations(
            x, v, rule.members, rule.targets, rule.radius, rule.view_cosine,
            rule.nearest, np.array(rule.attraction), np.array(rule.alignment),
            np.array(rule.repulsion), rule.softening, period, max_pairs(count),
        )  # fmt: skip
        hint = "reduce their range of sight, or strengthen the repulsion"
        check_pair_count(count, pair_count, hint)
        member_indices = slice(None) if rule.members is None else rule.members
        accelerations_sum[member_indices] += accelerations
    return accelerations_sum


def min_distance(species: SpeciesModel) -> float:
    """Return the minimum distance of members of a species [m]; 0 if there is none.

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
        """Return the spacing of members; None if they have no minimum distance."""
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
        accelerations, pair_count = _kernels.flock_braking(
            x, v, self.distances, BRAKING_RANGE, MIN_BRAKING_GAP,
            self.period, max_pairs(len(x)),
        )  # fmt: skip
        check_pair_count(len(x), pair_count, REMEDY_HINT)
        return np.asarray(accelerations)

    def separate(
        self, x: FloatArray, pass_count: int = STEP_PASSES
    ) -> tuple[FloatArray, float]:
        """Return separated positions ``(N, 3)`` [m], and the remaining overlap [m]."""
        separated_points, overlap, pair_count = _kernels.flock_separate(
            x, self.distances, pass_count, OVERLAP_REDUCTION, SEPARATION_CLEARANCE,
            self.period, max_pairs(len(x)),
        )  # fmt: skip
        check_pair_count(len(x), pair_count, REMEDY_HINT)
        return separated_points, overlap
