"""Particles and springs that an attachment becomes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray, IntArray

__all__ = ["Network", "bends_of_faces", "edges_of_faces", "reach"]


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """N particles of equal mass, and what joins them.

    Attributes:
        count: N.
        held: Particles that go where the animation has them ``(P,)``, ascending.
        ends: Particles that a stiff spring keeps apart ``(E, 2)``.
        rests: Its length at rest ``(E,)`` [m].
        folds: Particles on either side of a fold ``(B, 2)``.
        fold_rests: Their distance at rest ``(B,)`` [m].
        triangles: Corners of the surface ``(T, 3)``.
    """

    count: int
    held: IntArray
    ends: IntArray
    rests: FloatArray
    folds: IntArray
    fold_rests: FloatArray
    triangles: IntArray

    @staticmethod
    def of(
        points: FloatArray,
        held: IntArray,
        ends: IntArray,
        folds: IntArray,
        triangles: IntArray | None = None,
    ) -> Network:
        """Return a network that is at rest at points ``(N, 3)`` [m]."""
        none = np.zeros((0, 3), np.int64)
        return Network(
            len(points),
            np.unique(held).astype(np.int64),
            ends,
            _lengths(points, ends),
            folds,
            _lengths(points, folds),
            none if triangles is None else triangles,
        )

    def scaled(self, scale: float) -> Network:
        """Return the network of another size."""
        return replace(
            self, rests=self.rests * scale, fold_rests=self.fold_rests * scale
        )

    @property
    def free(self) -> IntArray:
        """Particles that are not held, ascending."""
        loose = np.ones(self.count, bool)
        loose[self.held] = False
        return np.flatnonzero(loose)


def _lengths(points: FloatArray, ends: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=-1))


def reach(network: Network) -> int:
    """Return how many springs the farthest particle is away from a held one.

    Without any that is held it is counted from the first.

    >>> line = np.array([[0, 1], [1, 2]])
    >>> points = np.eye(3)
    >>> reach(Network.of(points, np.array([0]), line, line[:0]))
    2
    """
    beside: list[list[int]] = [[] for _ in range(network.count)]
    for i, j in network.ends.tolist():
        beside[i].append(j)
        beside[j].append(i)
    starts = network.held.tolist() or [0]
    away = dict.fromkeys(starts, 0)
    waiting = deque(starts)
    while waiting:
        at = waiting.popleft()
        for other in beside[at]:
            if other not in away:
                away[other] = away[at] + 1
                waiting.append(other)
    return max(away.values(), default=0)


def edges_of_faces(faces: list[list[int]]) -> IntArray:
    """Return the sides and diagonals of faces, each once, ascending ``(E, 2)``.

    >>> edges_of_faces([[0, 1, 2, 3]]).tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    """
    found = set()
    for face in faces:
        for k, i in enumerate(face):
            found.add(_ordered(i, face[(k + 1) % len(face)]))
        if len(face) == 4:
            found |= {_ordered(face[0], face[2]), _ordered(face[1], face[3])}
    return _pairs(found)


def bends_of_faces(faces: list[list[int]]) -> IntArray:
    """Return the points on either side of each edge that faces share ``(B, 2)``.

    Of two triangles those are the corners that face the edge, of two quadrangles the
    next points on either side of each end. An edge of three faces bends between each
    two.

    >>> bends_of_faces([[0, 1, 2], [1, 0, 3]]).tolist()
    [[2, 3]]
    """
    beyond: dict[tuple[int, int], list[dict[int, int]]] = {}
    for face in faces:
        size = len(face)
        for k, i in enumerate(face):
            j = face[(k + 1) % size]
            beside = {i: face[k - 1], j: face[(k + 2) % size]}
            beyond.setdefault(_ordered(i, j), []).append(beside)
    found = set()
    for edge, sides in beyond.items():
        for k, one in enumerate(sides):
            for other in sides[k + 1 :]:
                found |= {_ordered(one[end], other[end]) for end in edge}
    return _pairs({pair for pair in found if pair[0] != pair[1]})


def _ordered(i: int, j: int) -> tuple[int, int]:
    return (i, j) if i < j else (j, i)


def _pairs(found: set[tuple[int, int]]) -> IntArray:
    kept = sorted(pair for pair in found if pair[0] != pair[1])
    return np.array(kept, np.int64).reshape(-1, 2)
