"""Particles and springs that an attachment becomes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.maths.faces import distinct_pairs, edge_counts, of_one_edge, sides
from animtool.systems.springs.body import Body, built
from animtool.systems.springs.records import Family

# Springs that do not give [rad/s].
RIGID = 1e6
# Cloth [kg/m²], and the least mass of a particle among the others' [1].
CLOTH_WEIGHT = 0.3
MIN_MASS_FRACTION = 1e-3


def _none(columns: int) -> IntArray:
    return np.zeros((0, columns), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """N points that are at rest where they are, and the springs that join them."""

    points: FloatArray  # where they are at bind ``(N, 3)`` [m]
    pinned: IntArray  # those that go where the animation has them ``(P,)``, ascending
    sides: IntArray  # ends of what does not become longer ``(L, 2)``
    # Of faces, which give way sideways ``(L, 2)``.
    diagonals: IntArray = field(default_factory=lambda: _none(2))
    # From one side of a fold to the other ``(L, 2)``.
    bends: IntArray = field(default_factory=lambda: _none(2))
    # Corners of the surface ``(T, 3)``.
    triangles: IntArray = field(default_factory=lambda: _none(3))
    # How many lines of equal length the points stand in, each from the end that is held
    # on, one line behind the other; 0 where it is a surface.
    strands: int = 0

    @property
    def count(self) -> int:
        """N."""
        return len(self.points)

    @property
    def free(self) -> IntArray:
        """Particles that are not held, ascending."""
        return np.setdiff1d(np.arange(self.count), self.pinned)

    @property
    def rests(self) -> FloatArray:
        """Lengths of the sides at rest ``(L,)`` [m]."""
        return self.lengths(self.sides)

    def lengths(self, ends: IntArray) -> FloatArray:
        """Return how far ends ``(L, 2)`` are apart at rest ``(L,)`` [m]."""
        gaps = self.points[ends[:, 1]] - self.points[ends[:, 0]]
        return np.asarray(np.linalg.norm(gaps, axis=-1))

    @property
    def masses(self) -> FloatArray:
        """Of the particles ``(N,)`` [kg]: of cloth those of its area."""
        corners = self.triangles
        if not len(corners):
            return np.ones(self.count)
        a, b, c = (self.points[corners[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        thirds = np.repeat(areas * (CLOTH_WEIGHT / 3), 3)
        masses = np.bincount(corners.ravel(), thirds, self.count)
        # Faces without area leave some particles none.
        least = MIN_MASS_FRACTION * float(masses.max(initial=0.0))
        return np.maximum(masses, least if least > 0 else 1.0)

    def body(self, diagonals: float, bends: float) -> Body:
        """Return its particles with springs of some frequencies [Hz]."""
        loose = np.isin(np.arange(self.count), self.pinned, invert=True)
        families = (
            (self.sides, RIGID / (2 * math.pi)),
            (self.diagonals, diagonals),
            (self.bends, bends),
        )
        pulling = [
            (ends[loose[ends].any(axis=1)], Family(frequency=frequency))
            for ends, frequency in families
            if frequency
        ]
        return built(self.points, self.masses, pulling, self.triangles)


def reach(network: Network) -> int:
    """Return how many springs the farthest particle is away from a held one.

    Without any that is held it is counted from the first.

    >>> reach(Network(np.eye(3), np.array([0]), np.array([[0, 1], [1, 2]])))
    2
    """
    neighbours: list[list[int]] = [[] for _ in range(network.count)]
    for i, j in network.sides.tolist():
        neighbours[i].append(j)
        neighbours[j].append(i)
    starts = network.pinned.tolist() or [0]
    away = dict.fromkeys(starts, 0)
    waiting = deque(starts)
    while waiting:
        at = waiting.popleft()
        for other in neighbours[at]:
            if other not in away:
                away[other] = away[at] + 1
                waiting.append(other)
    return max(away.values(), default=0)


def typical_edge(network: Network) -> float:
    """Return the median length of springs that do not become longer [m]; 0 of none."""
    rests = network.rests
    return float(np.median(rests[rests > 0])) if rests.any() else 0.0


def lost_links(network: Network, points: FloatArray) -> int:
    """Return how many springs have both ends at one place of points ``(N, 3)``.

    Those of no length at rest are to be so, but where all are.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> network = Network(np.eye(3), np.array([0]), line)
    >>> lost_links(network, np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]))
    1
    """
    i, j = network.sides.T
    lost = (points[i] == points[j]).all(axis=1)
    rests = network.rests
    return int((lost & ((rests > 0) | ~rests.any())).sum())


def surface_problems(network: Network) -> list[str]:
    """Return what of the triangles is no surface, in words.

    >>> fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> network = Network(np.eye(5, 3), np.array([0]), fan[:, :2], triangles=fan)
    >>> surface_problems(network)
    ['1 edge of more than two triangles']
    """
    corners = network.triangles
    if not len(corners):
        return []
    a, b, c = (network.points[corners[:, k]] for k in range(3))
    flat = int((~np.cross(b - a, c - a).any(axis=1)).sum())
    often = edge_counts(np.full(len(corners), 3), corners.ravel())[1]
    shared = int((often > 2).sum())
    problems = [f"{counted(flat, 'triangle')} without area"] if flat else []
    if shared:
        problems.append(f"{counted(shared, 'edge')} of more than two triangles")
    return problems


def diagonals_of_faces(counts: IntArray, indices: IntArray) -> IntArray:
    """Return both diagonals of each quadrangle ``(L, 2)``.

    >>> diagonals_of_faces(np.array([4]), np.array([0, 1, 2, 3])).tolist()
    [[0, 2], [1, 3]]
    """
    corners = indices[np.repeat(counts == 4, counts)].reshape(-1, 4)
    return distinct_pairs(corners[:, [[0, 2], [1, 3]]].reshape(-1, 2))


def folds_of_faces(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the points on either side of each edge that faces share ``(L, 2)``.

    Of two triangles those are the corners that face the edge, of two quadrangles the
    next points on either side of each end. An edge of three faces bends between each
    two.

    >>> folds_of_faces(np.array([3, 3]), np.array([0, 1, 2, 1, 0, 3])).tolist()
    [[2, 3]]
    """
    starts, sizes = np.repeat([np.cumsum(counts) - counts, counts], counts, axis=1)
    around = np.arange(len(indices)) - starts
    side_corners = sides(counts, indices)
    # Beside the first end of a side, and beside the second.
    neighbours = np.stack(
        [indices[starts + (around + k) % sizes] for k in (-1, 2)], axis=1
    )
    turned = side_corners[:, 0] > side_corners[:, 1]
    neighbours[turned] = neighbours[turned, ::-1]
    one, other = of_one_edge(side_corners)
    pairs = np.stack([neighbours[one], neighbours[other]], axis=-1)
    return distinct_pairs(pairs.reshape(-1, 2))
