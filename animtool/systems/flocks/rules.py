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
# Neighbour pairs per member on average, and in total: beyond both a step takes minutes,
# as if thousands see each other.
MAX_PAIRS_EACH, MAX_PAIRS = 20_000, 2_000_000_000
_NEVER = (0.0, 0.0)


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
    for number, species in enumerate(members.entries):
        subjects = _some(members, [number])
        mates = [number, *(names.index(name) for name in species.joins)]
        rules.append(_flocking(species, subjects, _some(members, sorted({*mates}))))
        for flee in species.flees:
            those = _some(members, [names.index(flee.species)])
            push = (flee.weight, flee.radius)
            rules.append(
                FlockRule(
                    subjects, those, flee.radius, -1.0, 0, _NEVER, _NEVER, push,
                    species.repulsion.softening,
                )
            )  # fmt: skip
        for chase in species.chases:
            those = _some(members, [names.index(chase.species)])
            pull = (chase.weight, chase.radius)
            rules.append(
                FlockRule(
                    subjects, those, chase.radius, -1.0, 1, pull, _NEVER, _NEVER, 0.0
                )
            )
    return [rule for rule in rules if _acts(rule)]


def _flocking(
    species: SpeciesModel,
    subjects: Indices | None,
    mates: Indices | None,
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


def _acts(rule: FlockRule) -> bool:
    weights = (rule.attraction[0], rule.alignment[0], rule.repulsion[0])
    sizes = [len(some) for some in (rule.members, rule.others) if some is not None]
    return any(weights) and 0 not in sizes


def _some(members: Members, numbers: Sequence[int]) -> Indices | None:
    """Return the members of some species ``(M,)``; None for all."""
    if len(numbers) == len(members.entries):
        return None
    every = [np.arange(len(members))[members.parted[number]] for number in numbers]
    return np.concatenate(every).astype(np.int32)


def wrapping(domain: DomainModel | None) -> FloatArray:
    """Return the origin and period of each axis ``(2, 3)`` [m]; 0 is not periodic."""
    period = np.zeros((2, 3))
    if domain is not None and domain.wrap:
        period[1] = domain.size
        period[0] = np.subtract(domain.at, period[1] / 2)
    return period


def max_pairs(count: int) -> float:
    """Return the maximum number of neighbour pairs for N members."""
    return float(max(MAX_PAIRS_EACH * count, MAX_PAIRS))


def flocking(
    rules: Sequence[FlockRule], domain: DomainModel | None, x: FloatArray, v: FloatArray
) -> FloatArray:
    """Return accelerations from members in sight ``(N, 3)`` [m/s²].

    ``x`` ``(N, 3)`` [m], ``v`` ``(N, 3)`` [m/s].

    Raises:
        ToleranceError: Too many members are so close that a step would take minutes
            (SIM107).
    """
    period = wrapping(domain)
    total = np.zeros_like(x)
    for rule in rules:
        size = len(x) if rule.members is None else len(rule.members)
        most = max_pairs(size)
        accelerations, _, looked = _kernels.flock_accelerations(
            x, v, rule.members, rule.others, rule.radius, rule.cosine, rule.nearest,
            np.array(rule.attraction), np.array(rule.alignment),
            np.array(rule.repulsion), rule.softening, period, most,
        )  # fmt: skip
        if looked > most:
            message = (
                f"{size} members are so close that each has thousands of neighbours"
            )
            hint = "reduce their range of sight, or strengthen the repulsion"
            raise ToleranceError(Fault("SIM107", message, hint=hint))
        total[slice(None) if rule.members is None else rule.members] += accelerations
    return total
