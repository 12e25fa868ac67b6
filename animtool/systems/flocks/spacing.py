"""The least distance of members: who brakes for whom, and who is moved apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, ToleranceError
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.rules import Indices
from animtool.systems.flocks.spec import DomainModel, SpeciesModel

# Others are braked for within so many times the least distance.
SEEN = 2.0
# Share of the least distance below which the room to brake in is no smaller.
ROOM = 0.1
# Rounds in which members are moved apart in a step, and at the beginning; each goes
# this share of the way, and pairs are found anew after so many.
ROUNDS, FIRST, SHARE, REFRESH = 24, 400, 0.6, 8
# They are moved farther apart than must be by this share of it.
CLEAR = 1e-4
# Pairs that are held at once, for each and in all.
MOST_EACH, MOST = 200, 5_000_000


def least_distance(species: SpeciesModel) -> float:
    """Return how near members of a species come to each other [m]; 0 is any.

    Twice the radius that they are given: without one they are points.
    """
    repulsion = species.repulsion
    if repulsion.least is not None:
        return repulsion.least
    sized = "radius" in species.model_fields_set
    return 2 * species.radius if sized and repulsion.weight else 0.0


@dataclass(frozen=True)
class Spacing:
    """The least distances of N members: of two, the mean of both."""

    own: FloatArray  # (N,) [m]; 0 keeps none
    period: FloatArray | None  # of a domain that wraps (3,) [m]

    @staticmethod
    def of(members: Members, domain: DomainModel | None) -> Spacing | None:
        """Return the spacing of members; None where nobody keeps any."""
        own = members.each([least_distance(one) for one in members.species])
        wraps = domain is not None and domain.wrap
        period = np.array(domain.size) if domain is not None and wraps else None
        return Spacing(own, period) if len(own) > 1 and own.max() > 0 else None

    def _pairs(self, x: FloatArray, times: float) -> tuple[Indices, Indices]:
        """Return who are within so many times the largest least distance.

        Raises:
            ToleranceError: They are so many that a step would take minutes (SIM107).
        """
        reach, count = times * float(self.own.max()), len(x)
        box, low = self.period, np.zeros(3)
        if box is None:
            low = x.min(axis=0) - 2 * reach
            box = np.asarray(np.ptp(x, axis=0) + 4 * reach)
        most = max(MOST_EACH * count, MOST)
        try:
            order, starts, partners = _kernels.molecule_pairs(
                np.ascontiguousarray(x - low), box, reach, most
            )
        except ValueError as error:
            message = f"{count} members are so close that each is near thousands"
            hint = "let them begin in a larger place, or keep a smaller distance"
            raise ToleranceError(Fault("SIM107", message, hint=hint)) from error
        first = np.repeat(np.arange(count), np.diff(starts))
        there = partners < count
        i, j = order[first[there]], order[partners[there]]
        kept = (self.own[i] > 0) & (self.own[j] > 0)
        return i[kept], j[kept]

    def _apart(
        self, x: FloatArray, i: Indices, j: Indices
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ways from i to j ``(P, 3)``, distances and least distances [m]."""
        off = x[j] - x[i]
        if self.period is not None:
            off = off - self.period * np.round(off / self.period)
        far = np.sqrt((off * off).sum(axis=1))
        return (
            off / np.maximum(far, 1e-300)[:, None],
            far,
            (self.own[i] + self.own[j]) / 2,
        )

    def braking(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return what stops members before they are too near ``(N, 3)`` [m/s²].

        Of two that close in each takes half: the square of their speed over twice the
        room that is left, the more the nearer they are.
        """
        made = np.zeros_like(x)
        if not np.isfinite(x).all():
            return made
        i, j = self._pairs(x, SEEN)
        if not len(i):
            return made
        ways, far, least = self._apart(x, i, j)
        closing = np.maximum(-((v[j] - v[i]) * ways).sum(axis=1), 0.0)
        room = np.maximum(far - least, ROOM * least)
        near = np.clip(1 - (far - least) / ((SEEN - 1) * least), 0.0, 1.0)
        push = (near * closing**2 / (4 * room))[:, None] * ways
        return _added(made, i, j, push)

    def moved_apart(
        self, x: FloatArray, rounds: int = ROUNDS
    ) -> tuple[FloatArray, float]:
        """Return members moved apart ``(N, 3)`` [m], and the overlap left [m]."""
        overlap = 0.0
        if not np.isfinite(x).all():
            return x, overlap
        for k in range(rounds + 1):
            if k % REFRESH == 0:
                i, j = self._pairs(x, 1.5)
            ways, far, least = self._apart(x, i, j)
            lack = np.maximum(least - far, 0.0)
            overlap = float(lack.max(initial=0.0))
            if k == rounds or overlap == 0.0:
                break
            lack = np.where(lack > 0, lack + CLEAR * least, 0.0)
            push = (SHARE / 2 * lack)[:, None] * ways
            x = _added(x.copy(), i, j, push)
        return x, overlap


def _added(values: FloatArray, i: Indices, j: Indices, push: FloatArray) -> FloatArray:
    """Return values, less what is done to i, and more what is to j."""
    for axis in range(3):
        count = len(values)
        values[:, axis] += np.bincount(j, push[:, axis], count)
        values[:, axis] -= np.bincount(i, push[:, axis], count)
    return values
