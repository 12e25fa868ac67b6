"""Particles and springs that an attachment becomes."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.maths.faces import distinct_pairs, edge_counts, of_one_edge, sides

NO_PAIRS: IntArray = np.zeros((0, 2), np.int64)
NO_TRIANGLES: IntArray = np.zeros((0, 3), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """L springs of one kind."""

    ends: IntArray  # particles on either end ``(L, 2)``
    rests: FloatArray  # length at rest ``(L,)`` [m]

    @staticmethod
    def of(points: FloatArray, ends: IntArray) -> Links:
        """Return springs that are at rest between points ``(N, 3)`` [m]."""
        apart = points[ends[:, 1]] - points[ends[:, 0]]
        return Links(ends, np.asarray(np.linalg.norm(apart, axis=-1)))


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """N particles of equal mass, and what joins them."""

    points: FloatArray  # where they are at bind ``(N, 3)`` [m]
    held: IntArray  # particles that go where the animation has them ``(P,)``, ascending
    stiff: Links  # what does not become longer
    shears: Links  # diagonals of faces, which give way sideways
    folds: Links  # from one side of a fold to the other
    triangles: IntArray  # corners of the surface ``(T, 3)``
    # How many lines of equal length the particles stand in, each from the end that is
    # held on, one line behind the other; 0 where it is a surface.
    strands: int = 0

    @staticmethod
    def of(
        points: FloatArray,
        held: IntArray,
        stiff: IntArray,
        *,
        shears: IntArray = NO_PAIRS,
        folds: IntArray = NO_PAIRS,
        triangles: IntArray = NO_TRIANGLES,
        strands: int = 0,
    ) -> Network:
        """Return a network that is at rest at points ``(N, 3)`` [m]."""
        return Network(
            points,
            np.unique(held).astype(np.int64),
            Links.of(points, stiff),
            Links.of(points, shears),
            Links.of(points, folds),
            triangles,
            strands,
        )

    def scaled(self, scale: float) -> Network:
        """Return the network of another size."""
        points = self.points * scale
        return replace(
            self,
            points=points,
            stiff=Links.of(points, self.stiff.ends),
            shears=Links.of(points, self.shears.ends),
            folds=Links.of(points, self.folds.ends),
        )

    @property
    def count(self) -> int:
        """N."""
        return len(self.points)

    @property
    def free(self) -> IntArray:
        """Particles that are not held, ascending."""
        loose = np.ones(self.count, bool)
        loose[self.held] = False
        return np.flatnonzero(loose)


def reach(network: Network) -> int:
    """Return how many springs the farthest particle is away from a held one.

    Without any that is held it is counted from the first.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> points = np.eye(3)
    >>> reach(Network.of(points, np.array([0]), line))
    2
    """
    props: list[list[int]] = [[] for _ in range(network.count)]
    for i, j in network.stiff.ends.tolist():
        props[i].append(j)
        props[j].append(i)
    starts = network.held.tolist() or [0]
    away = dict.fromkeys(starts, 0)
    waiting = deque(starts)
    while waiting:
        at = waiting.popleft()
        for other in props[at]:
            if other not in away:
                away[other] = away[at] + 1
                waiting.append(other)
    return max(away.values(), default=0)


def typical_edge(network: Network) -> float:
    """Return the median length of springs that do not become longer [m]; 0 of none."""
    lengths = network.stiff.rests[network.stiff.rests > 0]
    return float(np.median(lengths)) if len(lengths) else 0.0


def lost_links(network: Network, points: FloatArray) -> int:
    """Return how many springs have both ends at one place of points ``(N, 3)``.

    Those of no length at rest are to be so, but where all are.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> network = Network.of(np.eye(3), np.array([0]), line)
    >>> lost_links(network, np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]))
    1
    """
    i, j = network.stiff.ends.T
    lost = (points[i] == points[j]).all(axis=1)
    rests = network.stiff.rests
    return int((lost & ((rests > 0) | ~rests.any())).sum())


def surface_problems(network: Network) -> list[str]:
    """Return what of the triangles is no surface, in words.

    >>> fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    >>> network = Network.of(np.eye(5, 3), np.array([0]), fan[:, :2], triangles=fan)
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
    said = [f"{counted(flat, 'triangle')} without area"] if flat else []
    if shared:
        said.append(f"{counted(shared, 'edge')} of more than two triangles")
    return said


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
    own = sides(counts, indices)
    # Beside the first end of a side, and beside the second.
    props = np.stack([indices[starts + (around + k) % sizes] for k in (-1, 2)], axis=1)
    turned = own[:, 0] > own[:, 1]
    props[turned] = props[turned, ::-1]
    one, other = of_one_edge(own)
    pairs = np.stack([props[one], props[other]], axis=-1)
    return distinct_pairs(pairs.reshape(-1, 2))
