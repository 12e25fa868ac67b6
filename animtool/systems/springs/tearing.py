"""Surfaces that part where springs along their sides tear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.systems.springs.body import Springs

# What keeps a turn as small as it may be where neighbours leave it open.
LEAST_TURN = 1e-9
# Over which points that no particle carries alone are looked at for their speed [s].
EPSILON_TIME = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Tearing:
    """A surface with more points, so that it can part and stays the same polygons.

    A tear goes through the middle of each side whose spring tears, from there on
    through the face to the next such side, or to the middle of the face where it
    ends. Each half goes with the particles of its end: until the spring tears, both
    halves meet where they did; then each is as at rest, turned as what is around its
    particle. No face goes.

    Points are the particles, two halves for each side that ever tears, and middles of
    faces.

    Attributes:
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
        size: Number of points.
        springs: Those that ever tear along sides ``(E,)``.
        ends: Their particles ``(E, 2)``.
        ways: Half the way from the first end to the second, at rest ``(E, 3)`` [m].
        turning: How particles at tears turn.
        middles: Of faces.
    """

    counts: IntArray
    indices: IntArray
    size: int
    springs: IntArray
    ends: IntArray
    ways: FloatArray
    turning: _Turning
    middles: tuple[_Middle, ...]

    def points(self, particles: FloatArray, torn: BoolArray) -> FloatArray:
        """Return all points ``(size, 3)`` [m].

        Args:
            particles: ``(N, 3)`` [m].
            torn: Which springs are ``(S,)``.
        """
        now = torn[self.springs]
        first, second = (particles[self.ends[:, k]] for k in (0, 1))
        halves = np.stack([(first + second) / 2] * 2, axis=1)
        turns = self.turning.at(particles)
        for k, sign in ((0, 1.0), (1, -1.0)):
            own = turns[self.turning.rows(self.ends[now, k])]
            ways = sign * np.einsum("eij,ej->ei", own, self.ways[now])
            halves[now, k] = particles[self.ends[now, k]] + ways
        middles = [middle.at(particles, torn, self.turning, turns)
                   for middle in self.middles]  # fmt: skip
        return np.concatenate([particles, halves.reshape(-1, 3), *middles])

    def velocities(
        self, particles: FloatArray, speeds: FloatArray, torn: BoolArray
    ) -> FloatArray:
        """Return how fast all points go ``(size, 3)`` [m/s].

        Args:
            particles: ``(N, 3)`` [m].
            speeds: Theirs ``(N, 3)`` [m/s].
            torn: Which springs are ``(S,)``.
        """
        ahead = self.points(particles + EPSILON_TIME * speeds, torn)
        behind = self.points(particles - EPSILON_TIME * speeds, torn)
        found = (ahead - behind) / (2 * EPSILON_TIME)
        found[: len(speeds)] = speeds
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Turning:
    """How particles turn with their neighbours."""

    which: IntArray  # the particles, ascending ``(P,)``
    owners: IntArray  # numbers of particles in it, one a neighbour ``(K,)``
    neighbours: IntArray  # particles that stay next to them ``(K,)``
    ways: FloatArray  # to them at rest ``(K, 3)`` [m]

    def rows(self, particles: IntArray) -> IntArray:
        """Return where particles stand among those that turn."""
        return np.searchsorted(self.which, particles)

    def at(self, particles: FloatArray) -> FloatArray:
        """Return their turns ``(P, 3, 3)``, as small as neighbours leave them open."""
        now = particles[self.neighbours] - particles[self.which[self.owners]]
        spread = np.zeros((len(self.which), 3, 3))
        np.add.at(spread, self.owners, now[:, :, None] * self.ways[:, None, :])
        size = np.abs(spread).max(axis=(1, 2), initial=0.0)
        size[size == 0] = 1.0
        spread += LEAST_TURN * size[:, None, None] * np.eye(3)
        u, _, v = np.linalg.svd(spread)
        u[:, :, -1] *= np.sign(np.linalg.det(u @ v))[:, None]
        turns: FloatArray = u @ v
        return turns


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """The middle of a face, once for each of the parts that meet there."""

    corners: IntArray  # of the face ``(C,)``
    parts: IntArray  # of each corner ``(C,)``
    springs: IntArray  # between a part and the next, around the face ``(P,)``
    ways: FloatArray  # from corners to the middle at rest ``(C, 3)`` [m]

    def at(
        self,
        particles: FloatArray,
        torn: BoolArray,
        turning: _Turning,
        turns: FloatArray,
    ) -> FloatArray:
        """Return where it is for each part ``(P, 3)`` [m]."""
        gone = torn[self.springs]
        groups = int(gone.sum())
        if groups < 2:
            middle = particles[self.corners].mean(axis=0)
            return np.tile(middle, (len(gone), 1))
        # What comes behind the last that is gone meets what comes before the first.
        group = np.mod(np.cumsum(gone) - gone, groups)
        own = turns[turning.rows(self.corners)]
        places = particles[self.corners] + np.einsum("cij,cj->ci", own, self.ways)
        of = group[self.parts]
        sums = np.zeros((groups, 3))
        np.add.at(sums, of, places)
        found: FloatArray = sums[group] / np.bincount(of)[group][:, None]
        return found


def tear_surface(
    counts: IntArray,
    indices: IntArray,
    sides: IntArray,
    springs: Springs,
    torn: BoolArray,
    places: FloatArray,
) -> Tearing:
    """Return how a surface parts.

    Args:
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face ``(C,)``.
        sides: The spring along each side ``(C,)``, from its corner on; -1 for none.
        springs: Between the particles.
        torn: Which of them ever tear ``(S,)``.
        places: Where particles are at rest ``(N, 3)`` [m].

    >>> from animtool.systems.springs import Family, sheet
    >>> body = sheet(3, 2, mass=1.0, structural=Family(1.0))
    >>> sides = np.array([0, 5, 2, 4, 1, 6, 3, 5])
    >>> torn = np.isin(np.arange(7), [0, 2])
    >>> made = tear_surface(np.array([4, 4]), np.array([0, 1, 4, 3, 1, 2, 5, 4]),
    ...                     sides, body.springs, torn, body.positions)
    >>> made.counts.tolist(), made.indices.tolist()
    ([4, 4, 4], [1, 2, 5, 4, 7, 1, 4, 9, 8, 3, 0, 6])
    """
    cut = torn[sides] & (sides >= 0)
    crossed = np.unique(sides[cut])
    cutter = _Cutter(len(places), crossed, springs.ends[crossed], places)
    starts = np.cumsum(counts) - counts
    whole = ~np.logical_or.reduceat(cut, starts)
    for face in np.flatnonzero(~whole).tolist():
        own = slice(starts[face], starts[face] + counts[face])
        cutter.part(indices[own], np.where(cut[own], sides[own], -1))
    ends = springs.ends[crossed]
    between = places[ends[:, 1]] - places[ends[:, 0]]
    lengths = np.linalg.norm(between, axis=1)
    shares = springs.rest[crossed] / np.where(lengths > 0, lengths, 1.0) / 2
    at = [ends.ravel(), *(middle.corners for middle in cutter.middles)]
    left = sides[~cut & (sides >= 0)]
    return Tearing(
        np.append(counts[whole], np.array(cutter.counts, np.int64)),
        np.append(
            indices[np.repeat(whole, counts)], np.array(cutter.indices, np.int64)
        ),
        cutter.size,
        crossed,
        ends,
        between * shares[:, None],
        _turning(np.unique(np.concatenate(at)), springs.ends[np.unique(left)], places),
        tuple(cutter.middles),
    )


def _turning(which: IntArray, pairs: IntArray, places: FloatArray) -> _Turning:
    """Return how ascending particles ``(P,)`` turn with those that they stay next to.

    Pairs ``(K, 2)`` stay next to each other; places are at rest ``(N, 3)`` [m].
    """
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.isin(both[:, 0], which)]
    ways = places[both[:, 1]] - places[both[:, 0]]
    return _Turning(which, np.searchsorted(which, both[:, 0]), both[:, 1], ways)


class _Cutter:
    """Cuts faces, one after the other."""

    def __init__(
        self, count: int, crossed: IntArray, ends: IntArray, places: FloatArray
    ) -> None:
        self._places = places
        self._half = {
            (spring, end): count + 2 * i + k
            for i, (spring, pair) in enumerate(
                zip(crossed.tolist(), ends.tolist(), strict=True)
            )
            for k, end in enumerate(pair)
        }
        self.size = count + 2 * len(crossed)
        self.counts: list[int] = []  # corners of each part
        self.indices: list[int] = []  # corners, part by part
        self.middles: list[_Middle] = []

    def part(self, corners: IntArray, cut: IntArray) -> None:
        """Cut a face of corners ``(C,)`` at springs of sides ``(C,)``; -1 is none."""
        runs = list(_runs(corners.tolist(), cut.tolist()))
        rings = [
            [self._half[before, run[0]], *run, self._half[after, run[-1]]]
            for before, run, after in runs
        ]
        if len(runs) == 2:
            for ring in rings:
                self._add(ring)
            return
        first = self._middle(corners, runs)
        if len(runs) > 2:
            for i, ring in enumerate(rings):
                self._add([first + i, *ring])
            return
        for one, other in zip(rings[0][:-1], rings[0][1:], strict=True):
            self._add([first, one, other])

    def _add(self, corners: Sequence[int]) -> None:
        self.counts.append(len(corners))
        self.indices += corners

    def _middle(
        self, corners: IntArray, runs: Sequence[tuple[int, list[int], int]]
    ) -> int:
        """Add the middle of a face; return the number of its first point."""
        order = [corner for _, run, _ in runs for corner in run]
        parts = [i for i, (_, run, _) in enumerate(runs) for _ in run]
        own = self._places[order]
        self.middles.append(
            _Middle(
                np.array(order),
                np.array(parts),
                np.array([after for _, _, after in runs]),
                self._places[corners].mean(axis=0) - own,
            )
        )
        self.size += len(runs)
        return self.size - len(runs)


def _runs(
    corners: Sequence[int], cut: Sequence[int]
) -> Iterator[tuple[int, list[int], int]]:
    """Yield corners that stay together, with the springs that tear at both ends."""
    count = len(corners)
    crossed = [i for i in range(count) if cut[i] >= 0]
    for one, other in zip(crossed, [*crossed[1:], crossed[0] + count], strict=True):
        run = [corners[i % count] for i in range(one + 1, other + 1)]
        yield cut[one], run, cut[other % count]
