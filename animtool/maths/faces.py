"""Polygon meshes: edges, triangles and normals; rigid motion between points."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.maths import so3


def directed_edges(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the directed edges of polygons: each corner and the next ``(C, 2)``.

    Args:
        counts: Number of corners of each polygon ``(M,)``.
        indices: Corners, one polygon after the other ``(C,)``.

    >>> directed_edges(np.array([3]), np.array([5, 6, 7])).tolist()
    [[5, 6], [6, 7], [7, 5]]
    """
    corner_ends = np.cumsum(counts)
    next_corners = np.roll(indices, -1)
    next_corners[corner_ends - 1] = indices[corner_ends - counts]
    return np.stack([indices, next_corners], axis=1)


def unique_pairs(pairs: IntArray) -> IntArray:
    """Return distinct unordered pairs ``(P, 2)``, without pairs of equal numbers.

    The pairs are sorted, and so are the numbers of each pair.

    >>> unique_pairs(np.array([[2, 1], [1, 2], [0, 3], [4, 4]])).tolist()
    [[0, 3], [1, 2]]
    """
    sorted_pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    return np.unique(sorted_pairs, axis=0)


def edges(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the distinct edges of polygons, ascending ``(E, 2)``.

    The arguments are those of `directed_edges`.

    >>> edges(np.array([3, 3]), np.array([0, 1, 2, 0, 2, 3])).tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    """
    return unique_pairs(directed_edges(counts, indices))


def edge_counts(counts: IntArray, indices: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct edges of polygons ``(E, 2)`` and their face counts ``(E,)``.

    The arguments are those of `directed_edges`.

    >>> edge_counts(np.array([3, 3]), np.array([0, 1, 2, 0, 2, 3]))[1].tolist()
    [1, 2, 1, 1, 1]
    """
    sorted_edges = np.sort(directed_edges(counts, indices), axis=1)
    unique_edges, face_counts = np.unique(sorted_edges, axis=0, return_counts=True)
    return unique_edges, face_counts


def is_closed(counts: IntArray, indices: IntArray) -> bool:
    """Return whether polygons form a closed mesh: every edge has two faces.

    The arguments are those of `directed_edges`.

    >>> tetrahedron = np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3])
    >>> is_closed(np.full(4, 3), tetrahedron), is_closed(np.full(3, 3), tetrahedron[:9])
    (True, False)
    """
    low, high = np.sort(directed_edges(counts, indices), axis=1).astype(np.int64).T
    edge_keys = np.sort(low * (high.max(initial=0) + 1) + high).reshape(-1)
    key_pairs = edge_keys[: len(edge_keys) // 2 * 2].reshape(-1, 2)
    is_even = len(edge_keys) % 2 == 0 and bool(
        (key_pairs[:, 0] == key_pairs[:, 1]).all()
    )
    return is_even and bool((np.diff(key_pairs[:, 0]) > 0).all())


def coincident_edges(edge_ends: IntArray) -> tuple[IntArray, IntArray]:
    """Return the indices of all pairs of edges ``(C, 2)`` with the same ends.

    >>> one, other = coincident_edges(np.array([[0, 1], [1, 2], [1, 0]]))
    >>> one.tolist(), other.tolist()
    ([0], [2])
    """
    sorted_ends = np.sort(edge_ends, axis=1)
    sort_order = np.lexsort((sorted_ends[:, 1], sorted_ends[:, 0]))
    sorted_ends = sorted_ends[sort_order]
    pairs = [np.zeros((0, 2), np.int64)]
    for gap in range(1, len(sort_order)):
        is_equal = (sorted_ends[gap:] == sorted_ends[:-gap]).all(axis=1)
        if not is_equal.any():
            break
        pairs.append(
            np.stack([sort_order[:-gap][is_equal], sort_order[gap:][is_equal]], axis=1)
        )
    first, second = np.concatenate(pairs).T
    return first, second


def triangulate(counts: IntArray, indices: IntArray) -> IntArray:
    """Return the triangle fans of polygons ``(T, 3)``.

    The arguments are those of `directed_edges`.

    >>> triangulate(np.array([4]), np.array([5, 6, 7, 8])).tolist()
    [[5, 6, 7], [5, 7, 8]]
    """
    first_corners = np.cumsum(counts) - counts
    triangle_counts = np.maximum(counts - 2, 0)
    fan_starts = np.repeat(first_corners, triangle_counts)
    step_in_fan = np.arange(triangle_counts.sum()) - np.repeat(
        np.cumsum(triangle_counts) - triangle_counts, triangle_counts
    )
    second_corners = fan_starts + step_in_fan + 1
    third_corners = fan_starts + step_in_fan + 2
    return np.stack(
        [indices[fan_starts], indices[second_corners], indices[third_corners]], 1
    )


def vertex_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the unit normal at each vertex ``(N, 3)``, faces weighted by area.

    A vertex without faces, or whose faces cancel out, gets the z axis.

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
    corners, point_count = triangles.reshape(-1), len(points)
    columns = [np.bincount(corners, areas[:, axis], point_count) for axis in range(3)]
    sums = np.stack(columns, axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    is_undefined = lengths[:, 0] <= np.finfo(np.float64).tiny
    normals: FloatArray = sums / np.where(is_undefined[:, None], 1.0, lengths)
    normals[is_undefined] = (0.0, 0.0, 1.0)
    return normals


# Relative spread below which points count as collinear or coincident.
COLLINEAR_TOLERANCE = 1e-9


def rigid_motion(
    source_points: ArrayLike, target_points: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the best-fit rotation ``(4,)`` and translation ``(3,)`` between points.

    A point p maps to ``rotate(rotation, p) + translation``. For collinear or coincident
    points, which leave the rotation undetermined, the smallest rotation is returned.

    Args:
        source_points: At least one source point ``(P, 3)``.
        target_points: Positions that the source points should reach ``(P, 3)``.

    References:
        W. Kabsch, A solution for the best rotation to relate two sets of vectors, 1976.

    >>> rotation, translation = rigid_motion([[0, 0, 0]], [[1, 2, 3]])
    >>> rotation.tolist(), translation.tolist()
    ([0.0, 0.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    """
    start = np.asarray(source_points, np.float64)
    end = np.asarray(target_points, np.float64)
    centre, target_centre = start.mean(axis=0), end.mean(axis=0)
    covariance = (start - centre).T @ (end - target_centre)
    scale = np.abs(start).max(initial=0.0) * np.abs(end).max(initial=0.0)
    rotation = _best_rotation(covariance, float(scale))
    return rotation, np.asarray(target_centre - so3.rotate(rotation, centre))


def _best_rotation(covariance: FloatArray, scale: float) -> FloatArray:
    """Return the rotation that maximises the trace with a covariance (Kabsch)."""
    left, singular_values, right_t = np.linalg.svd(covariance)
    if singular_values[0] <= COLLINEAR_TOLERANCE**2 * scale:
        return so3.IDENTITY.copy()
    if singular_values[1] <= COLLINEAR_TOLERANCE * singular_values[0]:
        return _least_rotation(left[:, 0], right_t[0])
    sign = np.sign(np.linalg.det(left) * np.linalg.det(right_t))
    return so3.from_matrix(right_t.T @ np.diag([1.0, 1.0, sign]) @ left.T)


def _least_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the shortest rotation from one unit vector to another."""
    axis = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(axis), a @ b))
    if not np.linalg.norm(axis) > 0:
        # At 180 degrees any perpendicular axis is valid.
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    return so3.from_axis_angle(axis / np.linalg.norm(axis), angle)
