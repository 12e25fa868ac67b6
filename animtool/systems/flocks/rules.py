"""Rules between members in sight: one kernel call each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.spec import DomainModel, SpeciesModel

Indices: TypeAlias = npt.NDArray[np.int32]
# Neighbour pairs per member on average, and in total. Beyond both, thousands of members
# see each other and a step takes minutes.
MAX_PAIRS_PER_MEMBER, MAX_PAIRS = 20_000, 2_000_000_000
_NO_INTERACTION = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FlockRule:
    """A rule of one species towards others: arguments of the kernel."""

    members: Indices | None  # (M,); None for all
    others: Indices | None
    radius: float  # [m]
    cosine: float  # of half the angle of view
    nearest: int  # number of nearest neighbours; 0 for all
    attraction: tuple[float, float]  # [1/s²] and [m]
    alignment: tuple[float, float]  # [1/s] and [m]
    repulsion: tuple[float, float]  # [m²/s²] and [m]
    softening: float  # [m]


def rules_of(members: Members) -> list[FlockRule]:
    """Return the rules of all species, without those that have no effect."""
    rules = []
    names = [species.name for species in members.entries]
    for index, species in enumerate(members.entries):
        subject_members = _members_of(members, [index])
        flock_members = [index, *(names.index(name) for name in species.joins)]
        rules.append(
            _flocking_rule(
                species, subject_members, _members_of(members, sorted({*flock_members}))
            )
        )
        for flee in species.flees:
            targets = _members_of(members, [names.index(flee.species)])
            push = (flee.weight, flee.radius)
            rules.append(
                FlockRule(
                    subject_members, targets, flee.radius, -1.0, 0,
                    _NO_INTERACTION, _NO_INTERACTION, push, species.repulsion.softening,
                )
            )  # fmt: skip
        for chase in species.chases:
            targets = _members_of(members, [names.index(chase.species)])
            pull = (chase.weight, chase.radius)
            rules.append(
                FlockRule(
                    subject_members,
                    targets,
                    chase.radius,
                    -1.0,
                    1,
                    pull,
                    _NO_INTERACTION,
                    _NO_INTERACTION,
                    0.0,
                )
            )
    return [rule for rule in rules if _has_effect(rule)]


def _flocking_rule(
    species: SpeciesModel, subjects: Indices | None, mates: Indices | None
) -> FlockRule:
    vision, repulsion = species.vision, species.repulsion

    def within(radius: float | None) -> float:
        return vision.radius if radius is None else min(radius, vision.radius)

    return FlockRule(
        subjects,
        mates,
        vision.radius,
        -1.0 if vision.angle == 360 else float(np.cos(np.radians(vision.angle / 2))),
        vision.nearest or 0,
        (species.attraction.weight, within(species.attraction.radius)),
        (species.alignment.weight, within(species.alignment.radius)),
        (repulsion.weight, within(repulsion.radius)),
        repulsion.softening,
    )


def _has_effect(rule: FlockRule) -> bool:
    weights = (rule.attraction[0], rule.alignment[0], rule.repulsion[0])
    sizes = [
        len(indices) for indices in (rule.members, rule.others) if indices is not None
    ]
    return any(weights) and 0 not in sizes


def _members_of(members: Members, species: Sequence[int]) -> Indices | None:
    """Return the members of selected species ``(M,)``; None for all species."""
    if len(species) == len(members.entries):
        return None
    ranges = [
        np.arange(len(members))[members.rows_by_entry[number]] for number in species
    ]
    return np.concatenate(ranges).astype(np.int32)


def periodic_box(domain: DomainModel | None) -> FloatArray:
    """Return the origin and period of each axis ``(2, 3)`` [m]; 0 is not periodic."""
    period = np.zeros((2, 3))
    if domain is not None and domain.wrap:
        period[1] = domain.size
        period[0] = np.subtract(domain.at, period[1] / 2)
    return period


def max_pairs(count: int) -> float:
    """Return the maximum number of neighbour pairs for N members."""
    return float(max(MAX_PAIRS_PER_MEMBER * count, MAX_PAIRS))


def rule_accelerations(
    rules: Sequence[FlockRule], domain: DomainModel | None, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations from members in sight ``(N, 3)`` [m/s²].

    ``x`` ``(N, 3)`` [m], ``v`` ``(N, 3)`` [m/s].
    """
    period = periodic_box(domain)
    total = np.zeros_like(x)
    for rule in rules:
        count = len(x) if rule.members is None else len(rule.members)
        limit = max_pairs(count)
        accelerations, _, pairs = _kernels.flock_accelerations(
            x, v, rule.members, rule.others, rule.radius, rule.cosine, rule.nearest,
            np.array(rule.attraction), np.array(rule.alignment),
            np.array(rule.repulsion), rule.softening, period, limit,
        )  # fmt: skip
        if pairs > limit:
            message = f"{count} members are so close that each has thousands of "
            message += "neighbours"
            hint = "reduce their range of sight, or strengthen the repulsion"
            raise ToleranceError(Fault("SIM107", message, hint=hint))
        total[slice(None) if rule.members is None else rule.members] += accelerations
    return total
