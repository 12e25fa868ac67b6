"""Polygons: their sides, their edges, and their triangles."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray


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
    found, often = np.unique(ends, axis=0, return_counts=True)
    return found, often


def of_one_edge(pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Return each two of some sides ``(C, 2)`` that have the same ends: their numbers.

    >>> one, other = of_one_edge(np.array([[0, 1], [1, 2], [1, 0]]))
    >>> one.tolist(), other.tolist()
    ([0], [2])
    """
    ends = np.sort(pairs, axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends = ends[order]
    found = [np.zeros((0, 2), np.int64)]
    for apart in range(1, len(order)):
        same = (ends[apart:] == ends[:-apart]).all(axis=1)
        if not same.any():
            break
        found.append(np.stack([order[:-apart][same], order[apart:][same]], axis=1))
    one, other = np.concatenate(found).T
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
