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

# Relative regularization; keeps rotations minimal where neighbours are too few.
ROTATION_REGULARIZATION = 1e-9
# Difference step for velocities of points that depend on several particles [s].
VELOCITY_TIME_STEP = 1e-4


@dataclass(frozen=True)
class CurveShape:
    """Particles in rows, drawn as curves.

    A curve is split where a spring between two neighbours tears; single particles are
    not drawn.
    """

    counts: IntArray  # particles of each curve ``(C,)``
    width: float  # width of the curves [m]
    springs: Springs  # springs between the particles

    @property
    def can_tear(self) -> bool:
        """Whether any spring can tear, which changes the topology."""
        return bool(np.isfinite(self.springs.limit).any())

    def frame(
        self, points: FloatArray, velocities: FloatArray, torn: BoolArray
    ) -> CurvesFrame:
        """Return curves at points ``(N, 3)`` [m], split at torn springs ``(S,)``."""
        width = self.width
        if not torn.any():
            return CurvesFrame(points, velocities, self.counts, width, self.can_tear)
        is_last = np.zeros(len(points), bool)
        is_last[np.cumsum(self.counts) - 1] = True
        is_torn = torn[self._next_springs] & (self._next_springs >= 0)
        is_last[:-1] |= is_torn
        curve_of_particle = np.cumsum(np.append(0, is_last[:-1]))
        sizes = np.bincount(curve_of_particle)
        is_drawn = sizes[curve_of_particle] > 1
        counts = sizes[sizes > 1]
        return CurvesFrame(points[is_drawn], velocities[is_drawn], counts, width, True)

    @cached_property
    def _next_springs(self) -> IntArray:
        """Spring from each particle to the next ``(N - 1,)``; -1 without one."""
        first = np.arange(int(self.counts.sum()) - 1)
        return _spring_of_pairs(self.springs, np.stack([first, first + 1], axis=1))


@dataclass(frozen=True)
class FaceShape:
    """Faces between particles, drawn as a mesh."""

    counts: IntArray  # corners of each face ``(M,)``
    indices: IntArray  # corners, face by face
    springs: Springs  # springs between the particles
    closed: bool = False  # whether only the outside of the surface is visible

    @property
    def can_tear(self) -> bool:
        """Whether any spring along a side can tear."""
        return bool(np.isfinite(self.springs.limit[self.side_springs]).any())

    def frame(
        self,
        points: FloatArray,
        velocities: FloatArray,
        torn: BoolArray,  # noqa: ARG002
    ) -> MeshFrame:
        """Return the mesh frame; a surface that tears is drawn by `Tearing`."""
        return MeshFrame(points, velocities, self.counts, self.indices, self.closed)

    def torn_shape(self, torn: BoolArray, positions: FloatArray) -> Tearing | FaceShape:
        """Return the surface split at torn side springs; mask ``(S,)``."""
        if not torn[self.side_springs].any():
            return self
        counts, indices, sides = self.counts, self.indices, self._spring_of_side
        return tear_surface(counts, indices, sides, self.springs, torn, positions)

    def intact_faces(self, torn: BoolArray) -> tuple[IntArray, IntArray]:
        """Return counts and indices of faces without a torn side."""
        is_torn = torn[self._spring_of_side] & (self._spring_of_side >= 0)
        starts = np.cumsum(self.counts) - self.counts
        is_intact = ~np.logical_or.reduceat(is_torn, starts)
        return self.counts[is_intact], self.indices[np.repeat(is_intact, self.counts)]

    @cached_property
    def side_springs(self) -> IntArray:
        """Unique springs along sides, ascending ``(E,)``."""
        return np.unique(self._spring_of_side[self._spring_of_side >= 0])

    @cached_property
    def _spring_of_side(self) -> IntArray:
        """Spring along each side, face by face; -1 without one."""
        return _spring_of_pairs(self.springs, directed_edges(self.counts, self.indices))


Shape: TypeAlias = CurveShape | FaceShape


def _spring_of_pairs(springs: Springs, pairs: IntArray) -> IntArray:
    """Return the first spring between each pair of particles ``(P,)``; -1 for none."""
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
        ends: Particles at both ends of those springs ``(E, 2)``.
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
    middles: tuple[_FaceMiddle, ...]

    def frame(
        self, points: FloatArray, velocities: FloatArray, torn: BoolArray
    ) -> MeshFrame:
        """Return the mesh frame, as `FaceShape.frame` does."""
        return MeshFrame(
            self.points(points, torn),
            self.velocities(points, velocities, torn),
            self.counts,
            self.indices,
        )

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
        half_edges = self.half_edges[is_torn]
        for k, sign in ((0, 1.0), (1, -1.0)):
            ends = self.ends[is_torn, k]
            rotations = neighbour_rotations[self.rotations.rows(ends)]
            rotated_edges = np.einsum("eij,ej->ei", rotations, half_edges)
            halves[is_torn, k] = particles[ends] + sign * rotated_edges
        middles = [
            middle.positions(particles, torn, self.rotations, neighbour_rotations)
            for middle in self.middles
        ]
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
        after = self.points(particles + VELOCITY_TIME_STEP * speeds, torn)
        before = self.points(particles - VELOCITY_TIME_STEP * speeds, torn)
        velocities = (after - before) / (2 * VELOCITY_TIME_STEP)
        velocities[: len(speeds)] = speeds
        return velocities


@dataclass(frozen=True, slots=True, eq=False)
class _NeighbourRotations:
    """Fits rotations of particles to the offsets of their neighbours."""

    particles: IntArray  # ascending ``(P,)``
    owners: IntArray  # row in `particles` for each neighbour ``(K,)``
    neighbours: IntArray  # particles that stay connected to an owner ``(K,)``
    rest_offsets: FloatArray  # rest vectors to the neighbours ``(K, 3)`` [m]

    def rows(self, particles: IntArray) -> IntArray:
        """Return the rows of given particles in `particles`."""
        return np.searchsorted(self.particles, particles)

    def sample(self, particles: FloatArray) -> FloatArray:
        """Return rotations ``(P, 3, 3)`` fitted to current positions ``(N, 3)``."""
        owners = self.particles[self.owners]
        offsets = particles[self.neighbours] - particles[owners]
        products = offsets[:, :, None] * self.rest_offsets[:, None, :]
        covariances = np.zeros((len(self.particles), 3, 3))
        np.add.at(covariances, self.owners, products)
        scales = np.abs(covariances).max(axis=(1, 2), initial=0.0)
        scales[scales == 0] = 1.0
        return polar_rotations(covariances, scales)


@dataclass(frozen=True, slots=True, eq=False)
class _FaceMiddle:
    """Middle points of a torn face: one for each run of corners around the face."""

    corners: IntArray  # particles at the corners of the face ``(C,)``
    run_of_corner: IntArray  # index of the run of each corner ``(C,)``
    springs: IntArray  # side spring from each run to the next ``(P,)``
    rest_offsets: FloatArray  # from corners to the middle at rest ``(C, 3)`` [m]

    def positions(
        self,
        particles: FloatArray,
        torn: BoolArray,
        neighbours: _NeighbourRotations,
        rotations: FloatArray,
    ) -> FloatArray:
        """Return the middle point of each run ``(P, 3)`` [m]."""
        is_torn = torn[self.springs]
        group_count = int(is_torn.sum())
        if group_count < 2:
            middle = particles[self.corners].mean(axis=0)
            return np.tile(middle, (len(is_torn), 1))
        # The runs after the last torn side join those before the first.
        group_of_run = np.mod(np.cumsum(is_torn) - is_torn, group_count)
        corner_rotations = rotations[neighbours.rows(self.corners)]
        offsets = np.einsum("cij,cj->ci", corner_rotations, self.rest_offsets)
        predicted_middles = particles[self.corners] + offsets
        group_of_corner = group_of_run[self.run_of_corner]
        sums = np.zeros((group_count, 3))
        np.add.at(sums, group_of_corner, predicted_middles)
        counts = np.bincount(group_of_corner)
        centres: FloatArray = sums[group_of_run] / counts[group_of_run][:, None]
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
    >>> mesh = tear_surface(np.array([4, 4]), np.array([0, 1, 4, 3, 1, 2, 5, 4]),
    ...                     sides, body.springs, torn, body.positions)
    >>> mesh.counts.tolist(), mesh.indices.tolist()
    ([4, 4, 4], [1, 2, 5, 4, 7, 1, 4, 9, 8, 3, 0, 6])
    """
    is_cut = torn[sides] & (sides >= 0)
    torn_springs = np.unique(sides[is_cut])
    ends = springs.ends[torn_springs]
    spring_ends = zip(torn_springs.tolist(), ends.tolist(), strict=True)
    # Point index of each half of a side, by its spring and end particle.
    half_points = {
        (spring, end): len(positions) + 2 * i + k
        for i, (spring, pair) in enumerate(spring_ends)
        for k, end in enumerate(pair)
    }
    size = len(positions) + 2 * len(torn_springs)
    starts = np.cumsum(counts) - counts
    is_intact = ~np.logical_or.reduceat(is_cut, starts)
    middles: list[_FaceMiddle] = []
    split_faces: list[Sequence[int]] = []  # corners of each face
    for face in np.flatnonzero(~is_intact).tolist():
        corner_range = slice(starts[face], starts[face] + counts[face])
        corners = indices[corner_range]
        torn_sides = np.where(is_cut[corner_range], sides[corner_range], -1)
        runs = list(_runs(corners.tolist(), torn_sides.tolist()))
        outlines = [
            [half_points[before, run[0]], *run, half_points[after, run[-1]]]
            for before, run, after in runs
        ]
        if len(runs) == 2:
            split_faces += outlines
            continue
        if len(runs) > 2:
            split_faces += [[size + i, *outline] for i, outline in enumerate(outlines)]
        else:
            split_faces += [[size, *edge] for edge in pairwise(outlines[0])]
        middles.append(_build_middle(runs, positions, positions[corners].mean(axis=0)))
        size += len(runs)
    edge_vectors = positions[ends[:, 1]] - positions[ends[:, 0]]
    lengths = np.linalg.norm(edge_vectors, axis=1)
    divisors = np.where(lengths > 0, lengths, 1.0)
    half_fractions = springs.rest[torn_springs] / divisors / 2
    rotated_particles = [ends.ravel(), *(middle.corners for middle in middles)]
    intact_springs = sides[~is_cut & (sides >= 0)]
    return Tearing(
        np.append(counts[is_intact], np.array([*map(len, split_faces)], np.int64)),
        np.append(
            indices[np.repeat(is_intact, counts)],
            np.array([*chain(*split_faces)], np.int64),
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
_CornerRun: TypeAlias = tuple[int, list[int], int]


def _runs(corners: Sequence[int], torn_springs: Sequence[int]) -> Iterator[_CornerRun]:
    """Yield runs of corners between the torn sides of a face.

    ``torn_springs`` has the spring of each side, or -1 if it is not torn.
    """
    count = len(corners)
    cut_sides = [i for i in range(count) if torn_springs[i] >= 0]
    for start, end in pairwise([*cut_sides, cut_sides[0] + count]):
        run = [corners[i % count] for i in range(start + 1, end + 1)]
        yield torn_springs[start], run, torn_springs[end % count]


def _build_middle(
    runs: Sequence[_CornerRun], positions: FloatArray, rest_position: FloatArray
) -> _FaceMiddle:
    """Return the middle of a torn face with rest position ``(3,)`` [m]."""
    corners = np.array([corner for _, run, _ in runs for corner in run])
    run_of_corner = np.array([i for i, (_, run, _) in enumerate(runs) for _ in run])
    next_springs = np.array([next_springs for _, _, next_springs in runs])
    rest_offsets = rest_position - positions[corners]
    return _FaceMiddle(corners, run_of_corner, next_springs, rest_offsets)


def polar_rotations(covariances: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the rotations of regularised polar decompositions ``(..., 3, 3)``."""
    regularization = ROTATION_REGULARIZATION * scales[..., None, None] * np.eye(3)
    u, _, v = np.linalg.svd(covariances + regularization)
    u[..., -1] *= np.sign(np.linalg.det(u @ v))[..., None]
    rotations: FloatArray = u @ v
    return rotations


def _neighbour_rotations(
    particles: IntArray, pairs: IntArray, positions: FloatArray
) -> _NeighbourRotations:
    """Return rotations of ascending particles by neighbour pairs ``(K, 2)``."""
    directed_pairs = np.concatenate([pairs, pairs[:, ::-1]])
    directed_pairs = directed_pairs[np.isin(directed_pairs[:, 0], particles)]
    offsets = positions[directed_pairs[:, 1]] - positions[directed_pairs[:, 0]]
    return _NeighbourRotations(
        particles,
        np.searchsorted(particles, directed_pairs[:, 0]),
        directed_pairs[:, 1],
        offsets,
    )
