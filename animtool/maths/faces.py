"""Polygons and points: sides, edges, triangles, and the rigid motion between points."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.maths import so3


def sides(counts: IntArray, indices: IntArray) -> IntArray:
    """Return each corner of polygons with the next of the same ``(C, 2)``.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> sides(np.array([3]), np.array([5, 6, 7])).tolist()
    [[5, 6], [6, 7], [7, 5]]
    """
    ends = np.cumsum(counts)
    ahead = np.roll(indices, -1)
    ahead[ends - 1] = indices[ends - counts]
    return np.stack([indices, ahead], axis=1)


def distinct_pairs(pairs: IntArray) -> IntArray:
    """Return pairs ``(P, 2)`` each once, both ways alike, without those of one number.

    They ascend, and so do the two of each.

    >>> distinct_pairs(np.array([[2, 1], [1, 2], [0, 3], [4, 4]])).tolist()
    [[0, 3], [1, 2]]
    """
    apart = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    return np.unique(apart, axis=0)


def edges(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the sides of polygons, each once, ascending ``(E, 2)``.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> edges(np.array([3, 3]), np.array([0, 1, 2, 0, 2, 3])).tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    """
    return distinct_pairs(sides(counts, indices))


def edge_counts(counts: IntArray, indices: IntArray) -> tuple[IntArray, IntArray]:
    """Return the sides of polygons, each once ``(E, 2)``, and how many each is of.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> edge_counts(np.array([3, 3]), np.array([0, 1, 2, 0, 2, 3]))[1].tolist()
    [1, 2, 1, 1, 1]
    """
    ends = np.sort(sides(counts, indices), axis=1)
    edges, often = np.unique(ends, axis=0, return_counts=True)
    return edges, often


def closed(counts: IntArray, indices: IntArray) -> bool:
    """Return whether each side of polygons is of two of them: none has an open edge.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> tetrahedron = np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3])
    >>> closed(np.full(4, 3), tetrahedron), closed(np.full(3, 3), tetrahedron[:9])
    (True, False)
    """
    low, high = np.sort(sides(counts, indices), axis=1).astype(np.int64).T
    ends = np.sort(low * (high.max(initial=0) + 1) + high).reshape(-1)
    pairs = ends[: len(ends) // 2 * 2].reshape(-1, 2)
    twice = len(ends) % 2 == 0 and bool((pairs[:, 0] == pairs[:, 1]).all())
    return twice and bool((np.diff(pairs[:, 0]) > 0).all())


def of_one_edge(pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Return each two of some sides ``(C, 2)`` that have the same ends: their numbers.

    >>> one, other = of_one_edge(np.array([[0, 1], [1, 2], [1, 0]]))
    >>> one.tolist(), other.tolist()
    ([0], [2])
    """
    ends = np.sort(pairs, axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends = ends[order]
    edges = [np.zeros((0, 2), np.int64)]
    for apart in range(1, len(order)):
        same = (ends[apart:] == ends[:-apart]).all(axis=1)
        if not same.any():
            break
        edges.append(np.stack([order[:-apart][same], order[apart:][same]], axis=1))
    one, other = np.concatenate(edges).T
    return one, other


def triangulated(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the triangles of polygons, each cut into a fan ``(T, 3)``.

    Args:
        counts: Corners of each ``(M,)``.
        indices: Corners, one polygon after the other.

    >>> triangulated(np.array([4]), np.array([5, 6, 7, 8])).tolist()
    [[5, 6, 7], [5, 7, 8]]
    """
    firsts = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    starts = np.repeat(firsts, fans)
    turn = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack(
        [indices[starts], indices[starts + turn + 1], indices[starts + turn + 2]], 1
    )


def vertex_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the unit normal at each vertex ``(N, 3)``, faces weighted by area.

    A vertex without a face, or with faces that cancel out, has the z axis.

    Args:
        points: ``(N, 3)``.
        triangles: Vertices of each, counter-clockwise from outside ``(T, 3)``.

    >>> vertex_normals(np.eye(3)[[0, 1, 1]] * [[1], [1], [0]], np.array([[2, 0, 1]]))
    array([[0., 0., 1.],
           [0., 0., 1.],
           [0., 0., 1.]])
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corners, count = triangles.reshape(-1), len(points)
    sums = np.stack(
        [np.bincount(corners, areas[:, axis], count) for axis in range(3)], axis=1
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    flat = lengths[:, 0] <= np.finfo(np.float64).tiny
    normals: FloatArray = sums / np.where(flat[:, None], 1.0, lengths)
    normals[flat] = (0.0, 0.0, 1.0)
    return normals


# Of the largest spread: what rounding makes of points on a line, or at one place.
FLAT = 1e-9


def rigid_motion(before: ArrayLike, after: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the turn ``(4,)`` and shift ``(3,)`` that bring points nearest to others.

    A point p goes to ``rotate(turn, p) + shift``. Points on a line leave the turn about
    it open, and points at one place any: there the least turn is taken.

    Args:
        before: At least one ``(P, 3)``.
        after: Where they are to go ``(P, 3)``.

    References:
        W. Kabsch, A solution for the best rotation to relate two sets of vectors, 1976.

    >>> turn, shift = rigid_motion([[0, 0, 0]], [[1, 2, 3]])
    >>> turn.tolist(), shift.tolist()
    ([0.0, 0.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    """
    start, end = np.asarray(before, np.float64), np.asarray(after, np.float64)
    middle, target = start.mean(axis=0), end.mean(axis=0)
    turn = _turn((start - middle).T @ (end - target), _scale(start) * _scale(end))
    return turn, np.asarray(target - so3.rotate(turn, middle), np.float64)


def _scale(points: FloatArray) -> float:
    return float(np.abs(points).max(initial=0.0))


def _turn(covariance: FloatArray, scale: float) -> FloatArray:
    ways, spreads, others = np.linalg.svd(covariance)
    if spreads[0] <= FLAT**2 * scale:
        return so3.IDENTITY.copy()
    if spreads[1] <= FLAT * spreads[0]:
        return _least_turn(ways[:, 0], others[0])
    sign = np.sign(np.linalg.det(ways) * np.linalg.det(others))
    return so3.from_matrix(others.T @ np.diag([1.0, 1.0, sign]) @ ways.T)


def _least_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the least turn from a unit vector to another."""
    axis = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(axis), a @ b))
    if not np.linalg.norm(axis) > 0:
        # Any axis across will do for half a turn.
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    return so3.from_axis_angle(axis / np.linalg.norm(axis), angle)
