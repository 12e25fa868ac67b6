"""What is drawn of particles and springs: curves, faces, and faces that part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain, pairwise
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.faces import sides
from animtool.motion.frames import CurvesFrame, MeshFrame
from animtool.systems.springs.body import Springs

# What keeps a turn as small as it may be where neighbours leave it open.
ROTATION_REGULARIZATION = 1e-9
# Over which points that no particle carries alone are looked at for their speed [s].
EPSILON_TIME = 1e-4


@dataclass(frozen=True)
class CurveShape:
    """Particles in rows.

    Where a spring between two neighbours tears, a curve becomes two; a particle alone
    is not drawn.
    """

    counts: IntArray  # particles of each ``(C,)``
    width: float  # [m]
    springs: Springs  # between them

    @property
    def tears(self) -> bool:
        """Whether it may be drawn otherwise than at the start."""
        return bool(np.isfinite(self.springs.limit).any())

    def row(
        self, points: FloatArray, velocities: FloatArray, torn: BoolArray
    ) -> CurvesFrame:
        """Return curves of ``(N, 3)`` [m, m/s] where springs are torn ``(S,)``."""
        if not torn.any():
            return CurvesFrame(points, velocities, self.counts, self.width, self.tears)
        last = np.zeros(len(points), bool)
        last[np.cumsum(self.counts) - 1] = True
        gone = torn[self._next] & (self._next >= 0)
        last[:-1] |= gone
        piece = np.cumsum(np.append(0, last[:-1]))
        sizes = np.bincount(piece)
        drawn = sizes[piece] > 1
        counts = sizes[sizes > 1]
        return CurvesFrame(points[drawn], velocities[drawn], counts, self.width, True)

    @cached_property
    def _next(self) -> IntArray:
        """The spring from each particle to the next ``(N - 1,)``, -1 for none."""
        first = np.arange(int(self.counts.sum()) - 1)
        return _between(self.springs, np.stack([first, first + 1], axis=1))


@dataclass(frozen=True)
class FaceShape:
    """A surface of particles."""

    counts: IntArray  # corners of each face ``(M,)``
    indices: IntArray  # corners, face by face
    springs: Springs  # between the particles
    closed: bool = False  # whether only its outside is to be seen

    @property
    def tears(self) -> bool:
        """Whether it may part."""
        sides = self._sides[self._sides >= 0]
        return bool(np.isfinite(self.springs.limit[sides]).any())

    def row(
        self,
        points: FloatArray,
        velocities: FloatArray,
        torn: BoolArray,  # noqa: ARG002
    ) -> MeshFrame:
        """Return what is drawn; what is to part has a shape of its own."""
        return MeshFrame(points, velocities, self.counts, self.indices, self.closed)

    def torn_shape(self, torn: BoolArray, positions: FloatArray) -> Tearing | FaceShape:
        """Return it as it parts at springs ``(S,)``, at rest at ``(N, 3)`` [m]."""
        if not (torn[self._sides] & (self._sides >= 0)).any():
            return self
        return tear_surface(
            self.counts, self.indices, self._sides, self.springs, torn, positions
        )

    def intact_faces(self, torn: BoolArray) -> tuple[IntArray, IntArray]:
        """Return corners a face, and corners, of faces without a torn side ``(S,)``."""
        open_sides = torn[self._sides] & (self._sides >= 0)
        starts = np.cumsum(self.counts) - self.counts
        kept = ~np.logical_or.reduceat(open_sides, starts)
        return self.counts[kept], self.indices[np.repeat(kept, self.counts)]

    @cached_property
    def side_springs(self) -> IntArray:
        """The springs along sides, each once, ascending ``(E,)``."""
        return np.unique(self._sides[self._sides >= 0])

    @cached_property
    def _sides(self) -> IntArray:
        """The spring along each side, face by face; -1 for none."""
        return _between(self.springs, sides(self.counts, self.indices))


Shape: TypeAlias = CurveShape | FaceShape


def _between(springs: Springs, pairs: IntArray) -> IntArray:
    """Return the first spring between each of some pairs ``(P,)``, -1 for none."""
    if not len(springs.rest):
        return np.full(len(pairs), -1)
    size = int(max(springs.ends.max(), pairs.max(initial=0))) + 1
    ends = np.sort(springs.ends, axis=1) @ [size, 1]
    known, first = np.unique(ends, return_index=True)
    keys = np.sort(pairs, axis=1) @ [size, 1]
    at = np.searchsorted(known, keys).clip(max=len(known) - 1)
    return np.where(known[at] == keys, first[at], -1)


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
    half_edges: FloatArray
    rotations: _NeighbourRotations
    middles: tuple[_Middle, ...]

    def row(
        self, points: FloatArray, velocities: FloatArray, torn: BoolArray
    ) -> MeshFrame:
        """Return what is drawn of particles at a frame, as `Faces.row` does."""
        drawn = self.points(points, torn), self.velocities(points, velocities, torn)
        return MeshFrame(*drawn, self.counts, self.indices)

    def points(self, particles: FloatArray, torn: BoolArray) -> FloatArray:
        """Return all points ``(size, 3)`` [m].

        Args:
            particles: ``(N, 3)`` [m].
            torn: Which springs are ``(S,)``.
        """
        now = torn[self.springs]
        first, second = (particles[self.ends[:, k]] for k in (0, 1))
        halves = np.stack([(first + second) / 2] * 2, axis=1)
        neighbour_rotations = self.rotations.sample(particles)
        for k, sign in ((0, 1.0), (1, -1.0)):
            end_rotations = neighbour_rotations[self.rotations.rows(self.ends[now, k])]
            half_edges = sign * np.einsum(
                "eij,ej->ei", end_rotations, self.half_edges[now]
            )
            halves[now, k] = particles[self.ends[now, k]] + half_edges
        middles = [middle.at(particles, torn, self.rotations, neighbour_rotations)
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
        after = self.points(particles + EPSILON_TIME * speeds, torn)
        before = self.points(particles - EPSILON_TIME * speeds, torn)
        velocities = (after - before) / (2 * EPSILON_TIME)
        velocities[: len(speeds)] = speeds
        return velocities


@dataclass(frozen=True, slots=True, eq=False)
class _NeighbourRotations:
    """How particles turn with their neighbours."""

    which: IntArray  # the particles, ascending ``(P,)``
    owners: IntArray  # numbers of particles in it, one a neighbour ``(K,)``
    neighbours: IntArray  # particles that stay next to them ``(K,)``
    rest_offsets: FloatArray  # to them at rest ``(K, 3)`` [m]

    def rows(self, particles: IntArray) -> IntArray:
        """Return where particles stand among those that turn."""
        return np.searchsorted(self.which, particles)

    def sample(self, particles: FloatArray) -> FloatArray:
        """Return their turns ``(P, 3, 3)``, as small as neighbours leave them open."""
        now = particles[self.neighbours] - particles[self.which[self.owners]]
        spread = np.zeros((len(self.which), 3, 3))
        np.add.at(spread, self.owners, now[:, :, None] * self.rest_offsets[:, None, :])
        size = np.abs(spread).max(axis=(1, 2), initial=0.0)
        size[size == 0] = 1.0
        return polar_rotations(spread, size)


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """The middle of a face, once for each of the parts that meet there."""

    corners: IntArray  # of the face ``(C,)``
    parts: IntArray  # of each corner ``(C,)``
    springs: IntArray  # between a part and the next, around the face ``(P,)``
    rest_offsets: FloatArray  # from corners to the middle at rest ``(C, 3)`` [m]

    def at(
        self,
        particles: FloatArray,
        torn: BoolArray,
        turning: _NeighbourRotations,
        rotations: FloatArray,
    ) -> FloatArray:
        """Return where it is for each part ``(P, 3)`` [m]."""
        gone = torn[self.springs]
        groups = int(gone.sum())
        if groups < 2:
            middle = particles[self.corners].mean(axis=0)
            return np.tile(middle, (len(gone), 1))
        # What comes behind the last that is gone meets what comes before the first.
        group = np.mod(np.cumsum(gone) - gone, groups)
        corner_rotations = rotations[turning.rows(self.corners)]
        predicted = particles[self.corners] + np.einsum(
            "cij,cj->ci", corner_rotations, self.rest_offsets
        )
        of = group[self.parts]
        sums = np.zeros((groups, 3))
        np.add.at(sums, of, predicted)
        centres: FloatArray = sums[group] / np.bincount(of)[group][:, None]
        return centres


def tear_surface(
    counts: IntArray,
    indices: IntArray,
    sides: IntArray,
    springs: Springs,
    torn: BoolArray,
    positions: FloatArray,
) -> Tearing:
    """Return how a surface parts.

    Args:
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face ``(C,)``.
        sides: The spring along each side ``(C,)``, from its corner on; -1 for none.
        springs: Between the particles.
        torn: Which of them ever tear ``(S,)``.
        positions: Where particles are at rest ``(N, 3)`` [m].

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
    ends = springs.ends[crossed]
    named = zip(crossed.tolist(), ends.tolist(), strict=True)
    # Points of both halves of a side, by its spring and its end.
    halves = {
        (spring, end): len(positions) + 2 * i + k
        for i, (spring, pair) in enumerate(named)
        for k, end in enumerate(pair)
    }
    size = len(positions) + 2 * len(crossed)
    starts = np.cumsum(counts) - counts
    intact = ~np.logical_or.reduceat(cut, starts)
    middles: list[_Middle] = []
    parts: list[Sequence[int]] = []  # corners of each
    for face in np.flatnonzero(~intact).tolist():
        span = slice(starts[face], starts[face] + counts[face])
        corners = indices[span]
        torn_sides = np.where(cut[span], sides[span], -1)
        runs = list(_runs(corners.tolist(), torn_sides.tolist()))
        rings = [
            [halves[before, run[0]], *run, halves[after, run[-1]]]
            for before, run, after in runs
        ]
        if len(runs) == 2:
            parts += rings
            continue
        if len(runs) > 2:
            parts += [[size + i, *ring] for i, ring in enumerate(rings)]
        else:
            parts += [[size, *two] for two in pairwise(rings[0])]
        middles.append(_middle(runs, positions, positions[corners].mean(axis=0)))
        size += len(runs)
    between = positions[ends[:, 1]] - positions[ends[:, 0]]
    lengths = np.linalg.norm(between, axis=1)
    shares = springs.rest[crossed] / np.where(lengths > 0, lengths, 1.0) / 2
    at = [ends.ravel(), *(middle.corners for middle in middles)]
    left = sides[~cut & (sides >= 0)]
    return Tearing(
        np.append(counts[intact], np.array([len(part) for part in parts], np.int64)),
        np.append(
            indices[np.repeat(intact, counts)], np.array([*chain(*parts)], np.int64)
        ),
        size,
        crossed,
        ends,
        between * shares[:, None],
        _neighbour_rotations(
            np.unique(np.concatenate(at)), springs.ends[np.unique(left)], positions
        ),
        tuple(middles),
    )


# A run of corners that stay together, between the springs that tear at both ends.
_Run: TypeAlias = tuple[int, list[int], int]


def _runs(corners: Sequence[int], cut: Sequence[int]) -> Iterator[_Run]:
    """Yield runs of corners of a face whose sides are cut at springs; -1 is none."""
    count = len(corners)
    crossed = [i for i in range(count) if cut[i] >= 0]
    for one, other in zip(crossed, [*crossed[1:], crossed[0] + count], strict=True):
        run = [corners[i % count] for i in range(one + 1, other + 1)]
        yield cut[one], run, cut[other % count]


def _middle(runs: Sequence[_Run], positions: FloatArray, at: FloatArray) -> _Middle:
    """Return the middle of a face of runs, which at rest is at a place ``(3,)`` [m]."""
    order = np.array([corner for _, run, _ in runs for corner in run])
    parts = np.array([i for i, (_, run, _) in enumerate(runs) for _ in run])
    after = np.array([after for _, _, after in runs])
    return _Middle(order, parts, after, at - positions[order])


def polar_rotations(spreads: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return turns ``(..., 3, 3)`` by covariances of that shape, of some sizes."""
    small = ROTATION_REGULARIZATION * sizes[..., None, None] * np.eye(3)
    u, _, v = np.linalg.svd(spreads + small)
    u[..., -1] *= np.sign(np.linalg.det(u @ v))[..., None]
    rotations: FloatArray = u @ v
    return rotations


def _neighbour_rotations(
    which: IntArray, pairs: IntArray, positions: FloatArray
) -> _NeighbourRotations:
    """Return how ascending particles ``(P,)`` turn with those of pairs ``(K, 2)``."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.isin(both[:, 0], which)]
    offsets = positions[both[:, 1]] - positions[both[:, 0]]
    return _NeighbourRotations(
        which, np.searchsorted(which, both[:, 0]), both[:, 1], offsets
    )
