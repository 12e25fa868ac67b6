"""Curves and faces drawn for particles and springs, and faces that tear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain, pairwise
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.faces import directed_edges
from animtool.motion.frames import CurvesFrame, MeshFrame
from animtool.systems.springs.body import Springs

# Keeps rotations minimal where neighbours do not determine them.
ROTATION_REGULARIZATION = 1e-9
# Difference step for velocities of points that depend on several particles [s].
EPSILON_TIME = 1e-4


@dataclass(frozen=True)
class CurveShape:
    """Particles in rows, drawn as curves.

    A curve is split where a spring between two neighbours tears; single particles are
    not drawn.
    """

    counts: IntArray  # particles of each ``(C,)``
    width: float  # [m]
    springs: Springs  # between them

    @property
    def tears(self) -> bool:
        """Whether its springs can tear, so that the topology changes."""
        return bool(np.isfinite(self.springs.limit).any())

    def row(
        self, points: FloatArray, velocities: FloatArray, torn: BoolArray
    ) -> CurvesFrame:
        """Return the curves of ``(N, 3)`` [m, m/s] for torn springs ``(S,)``."""
        if not torn.any():
            return CurvesFrame(points, velocities, self.counts, self.width, self.tears)
        last = np.zeros(len(points), bool)
        last[np.cumsum(self.counts) - 1] = True
        is_torn = torn[self._next] & (self._next >= 0)
        last[:-1] |= is_torn
        piece_numbers = np.cumsum(np.append(0, last[:-1]))
        sizes = np.bincount(piece_numbers)
        is_drawn = sizes[piece_numbers] > 1
        counts = sizes[sizes > 1]
        return CurvesFrame(
            points[is_drawn], velocities[is_drawn], counts, self.width, True
        )

    @cached_property
    def _next(self) -> IntArray:
        """The spring from each particle to the next ``(N - 1,)``, -1 for none."""
        first = np.arange(int(self.counts.sum()) - 1)
        return _spring_of_pairs(self.springs, np.stack([first, first + 1], axis=1))


@dataclass(frozen=True)
class FaceShape:
    """A surface of particles."""

    counts: IntArray  # corners of each face ``(M,)``
    indices: IntArray  # corners, face by face
    springs: Springs  # between the particles
    closed: bool = False  # whether only its outside is visible

    @property
    def tears(self) -> bool:
        """Whether it can tear."""
        sides = self._sides[self._sides >= 0]
        return bool(np.isfinite(self.springs.limit[sides]).any())

    def row(
        self,
        points: FloatArray,
        velocities: FloatArray,
        torn: BoolArray,  # noqa: ARG002
    ) -> MeshFrame:
        """Return the mesh frame; a surface that tears is drawn by `Tearing`."""
        return MeshFrame(points, velocities, self.counts, self.indices, self.closed)

    def torn_shape(self, torn: BoolArray, positions: FloatArray) -> Tearing | FaceShape:
        """Return the surface split at torn springs ``(S,)``; rest ``(N, 3)`` [m]."""
        if not (torn[self._sides] & (self._sides >= 0)).any():
            return self
        return tear_surface(
            self.counts, self.indices, self._sides, self.springs, torn, positions
        )

    def intact_faces(self, torn: BoolArray) -> tuple[IntArray, IntArray]:
        """Return counts and indices of faces without a torn side; torn ``(S,)``."""
        open_sides = torn[self._sides] & (self._sides >= 0)
        starts = np.cumsum(self.counts) - self.counts
        is_intact = ~np.logical_or.reduceat(open_sides, starts)
        return self.counts[is_intact], self.indices[np.repeat(is_intact, self.counts)]

    @cached_property
    def side_springs(self) -> IntArray:
        """The springs along sides, each once, ascending ``(E,)``."""
        return np.unique(self._sides[self._sides >= 0])

    @cached_property
    def _sides(self) -> IntArray:
        """The spring along each side, face by face; -1 for none."""
        return _spring_of_pairs(self.springs, directed_edges(self.counts, self.indices))


Shape: TypeAlias = CurveShape | FaceShape


def _spring_of_pairs(springs: Springs, pairs: IntArray) -> IntArray:
    """Return the first spring between each of some pairs ``(P,)``, -1 for none."""
    if not len(springs.rest):
        return np.full(len(pairs), -1)
    size = int(max(springs.ends.max(), pairs.max(initial=0))) + 1
    ends = np.sort(springs.ends, axis=1) @ [size, 1]
    spring_keys, first = np.unique(ends, return_index=True)
    keys = np.sort(pairs, axis=1) @ [size, 1]
    rows = np.searchsorted(spring_keys, keys).clip(max=len(spring_keys) - 1)
    return np.where(spring_keys[rows] == keys, first[rows], -1)


@dataclass(frozen=True, slots=True, eq=False)
class Tearing:
    """A surface with additional points, so that it can tear with constant topology.

    A tear passes through the middle of each side whose spring tears, and through the
    face to the next such side, or ends in the middle of the face. Each half follows the
    particle at its end. Until the spring tears, both halves coincide; after that each
    keeps its rest shape, rotated with the neighbours of its particle. No face is
    removed.

    Points are the particles, two halves for each side that ever tears, and face
    middles.

    Attributes:
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
        size: Number of points.
        springs: Side springs that ever tear ``(E,)``.
        ends: Their particles ``(E, 2)``.
        half_edges: Half the rest vector from first to second end ``(E, 3)`` [m].
        rotations: Rotations of particles at tears.
        middles: Face middles.
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
        """Return the mesh frame, as `FaceShape.row` does."""
        point_motion = (
            self.points(points, torn),
            self.velocities(points, velocities, torn),
        )
        return MeshFrame(*point_motion, self.counts, self.indices)

    def points(self, particles: FloatArray, torn: BoolArray) -> FloatArray:
        """Return all points ``(size, 3)`` [m].

        Args:
            particles: ``(N, 3)`` [m].
            torn: Torn flags ``(S,)``.
        """
        is_torn = torn[self.springs]
        first, second = (particles[self.ends[:, k]] for k in (0, 1))
        halves = np.stack([(first + second) / 2] * 2, axis=1)
        neighbour_rotations = self.rotations.sample(particles)
        for k, sign in ((0, 1.0), (1, -1.0)):
            end_rotations = neighbour_rotations[
                self.rotations.rows(self.ends[is_torn, k])
            ]
            half_edges = sign * np.einsum(
                "eij,ej->ei", end_rotations, self.half_edges[is_torn]
            )
            halves[is_torn, k] = particles[self.ends[is_torn, k]] + half_edges
        middles = [middle.at(particles, torn, self.rotations, neighbour_rotations)
                   for middle in self.middles]  # fmt: skip
        return np.concatenate([particles, halves.reshape(-1, 3), *middles])

    def velocities(
        self, particles: FloatArray, speeds: FloatArray, torn: BoolArray
    ) -> FloatArray:
        """Return the velocities of all points ``(size, 3)`` [m/s].

        Args:
            particles: ``(N, 3)`` [m].
            speeds: Velocities of the particles ``(N, 3)`` [m/s].
            torn: Torn flags ``(S,)``.
        """
        after = self.points(particles + EPSILON_TIME * speeds, torn)
        before = self.points(particles - EPSILON_TIME * speeds, torn)
        velocities = (after - before) / (2 * EPSILON_TIME)
        velocities[: len(speeds)] = speeds
        return velocities


@dataclass(frozen=True, slots=True, eq=False)
class _NeighbourRotations:
    """Rotations of particles, fitted to their neighbours."""

    which: IntArray  # the particles, ascending ``(P,)``
    owners: IntArray  # row in `which` for each neighbour ``(K,)``
    neighbours: IntArray  # particles that stay connected to them ``(K,)``
    rest_offsets: FloatArray  # rest vectors to the neighbours ``(K, 3)`` [m]

    def rows(self, particles: IntArray) -> IntArray:
        """Return the rows of particles in `which`."""
        return np.searchsorted(self.which, particles)

    def sample(self, particles: FloatArray) -> FloatArray:
        """Return minimal rotations ``(P, 3, 3)`` that fit the neighbours."""
        offsets = particles[self.neighbours] - particles[self.which[self.owners]]
        covariances = np.zeros((len(self.which), 3, 3))
        np.add.at(
            covariances,
            self.owners,
            offsets[:, :, None] * self.rest_offsets[:, None, :],
        )
        scales = np.abs(covariances).max(axis=(1, 2), initial=0.0)
        scales[scales == 0] = 1.0
        return polar_rotations(covariances, scales)


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """The middle of a face, once for each part that joins there."""

    corners: IntArray  # of the face ``(C,)``
    parts: IntArray  # of each corner ``(C,)``
    springs: IntArray  # between a part and the next, around the face ``(P,)``
    rest_offsets: FloatArray  # from corners to the middle at rest ``(C, 3)`` [m]

    def at(
        self,
        particles: FloatArray,
        torn: BoolArray,
        neighbours: _NeighbourRotations,
        rotations: FloatArray,
    ) -> FloatArray:
        """Return its position for each part ``(P, 3)`` [m]."""
        is_torn = torn[self.springs]
        groups = int(is_torn.sum())
        if groups < 2:
            middle = particles[self.corners].mean(axis=0)
            return np.tile(middle, (len(is_torn), 1))
        # The parts after the last torn side join those before the first.
        group = np.mod(np.cumsum(is_torn) - is_torn, groups)
        corner_rotations = rotations[neighbours.rows(self.corners)]
        predicted = particles[self.corners] + np.einsum(
            "cij,cj->ci", corner_rotations, self.rest_offsets
        )
        corner_groups = group[self.parts]
        sums = np.zeros((groups, 3))
        np.add.at(sums, corner_groups, predicted)
        centres: FloatArray = sums[group] / np.bincount(corner_groups)[group][:, None]
        return centres


def tear_surface(
    counts: IntArray,
    indices: IntArray,
    sides: IntArray,
    springs: Springs,
    torn: BoolArray,
    positions: FloatArray,
) -> Tearing:
    """Return the split topology of a tearing surface.

    Args:
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face ``(C,)``.
        sides: The spring along each side ``(C,)``, from its corner on; -1 for none.
        springs: Between the particles.
        torn: Springs that ever tear ``(S,)``.
        positions: Rest positions of particles ``(N, 3)`` [m].

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
    torn_springs = np.unique(sides[cut])
    ends = springs.ends[torn_springs]
    spring_ends = zip(torn_springs.tolist(), ends.tolist(), strict=True)
    # Points of both halves of a side, by its spring and its end.
    halves = {
        (spring, end): len(positions) + 2 * i + k
        for i, (spring, pair) in enumerate(spring_ends)
        for k, end in enumerate(pair)
    }
    size = len(positions) + 2 * len(torn_springs)
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
            parts += [[size, *edge] for edge in pairwise(rings[0])]
        middles.append(_middle(runs, positions, positions[corners].mean(axis=0)))
        size += len(runs)
    edge_vectors = positions[ends[:, 1]] - positions[ends[:, 0]]
    lengths = np.linalg.norm(edge_vectors, axis=1)
    half_fractions = (
        springs.rest[torn_springs] / np.where(lengths > 0, lengths, 1.0) / 2
    )
    rotated_particles = [ends.ravel(), *(middle.corners for middle in middles)]
    intact_springs = sides[~cut & (sides >= 0)]
    return Tearing(
        np.append(counts[intact], np.array([len(part) for part in parts], np.int64)),
        np.append(
            indices[np.repeat(intact, counts)], np.array([*chain(*parts)], np.int64)
        ),
        size,
        torn_springs,
        ends,
        edge_vectors * half_fractions[:, None],
        _neighbour_rotations(
            np.unique(np.concatenate(rotated_particles)),
            springs.ends[np.unique(intact_springs)],
            positions,
        ),
        tuple(middles),
    )


# A run of corners that stay together, between the torn springs at both ends.
_Run: TypeAlias = tuple[int, list[int], int]


def _runs(corners: Sequence[int], cut: Sequence[int]) -> Iterator[_Run]:
    """Yield runs of corners between the cut sides of a face; -1 is not cut."""
    count = len(corners)
    cut_sides = [i for i in range(count) if cut[i] >= 0]
    for start, end in zip(
        cut_sides, [*cut_sides[1:], cut_sides[0] + count], strict=True
    ):
        run = [corners[i % count] for i in range(start + 1, end + 1)]
        yield cut[start], run, cut[end % count]


def _middle(
    runs: Sequence[_Run], positions: FloatArray, rest_position: FloatArray
) -> _Middle:
    """Return the middle of a face of runs with rest position ``(3,)`` [m]."""
    corners = np.array([corner for _, run, _ in runs for corner in run])
    parts = np.array([i for i, (_, run, _) in enumerate(runs) for _ in run])
    next_springs = np.array([next_springs for _, _, next_springs in runs])
    return _Middle(corners, parts, next_springs, rest_position - positions[corners])


def polar_rotations(spreads: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the polar rotations of covariances ``(..., 3, 3)`` of given sizes."""
    small = ROTATION_REGULARIZATION * sizes[..., None, None] * np.eye(3)
    u, _, v = np.linalg.svd(spreads + small)
    u[..., -1] *= np.sign(np.linalg.det(u @ v))[..., None]
    rotations: FloatArray = u @ v
    return rotations


def _neighbour_rotations(
    which: IntArray, pairs: IntArray, positions: FloatArray
) -> _NeighbourRotations:
    """Return rotations of ascending particles ``(P,)`` by pairs ``(K, 2)``."""
    directed_pairs = np.concatenate([pairs, pairs[:, ::-1]])
    directed_pairs = directed_pairs[np.isin(directed_pairs[:, 0], which)]
    offsets = positions[directed_pairs[:, 1]] - positions[directed_pairs[:, 0]]
    return _NeighbourRotations(
        which,
        np.searchsorted(which, directed_pairs[:, 0]),
        directed_pairs[:, 1],
        offsets,
    )
