"""Builders of ropes, strands, sheets, cloth and volumes."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from animtool.core.array_types import ArrayLike, IntArray, as_floats
from animtool.maths.faces import (
    coincident_edges,
    directed_edges,
    edges,
    triangulate,
    unique_pairs,
)
from animtool.systems.springs.body import Body, build_body
from animtool.systems.springs.records import Family


def rope(
    start: ArrayLike,
    end: ArrayLike,
    count: int,
    along: Family | None,
    *,
    mass: float,
    tip_mass: float | None = None,
    bend: Family | None = None,
) -> Body:
    """Return a straight rope.

    Args:
        start: Start point ``(3,)`` [m].
        end: End point ``(3,)`` [m].
        count: Number of particles, two or more.
        along: Springs between neighbours; None leaves them out.
        mass: Mass of each particle [kg].
        tip_mass: Mass of the last particle [kg]; None is `mass`.
        bend: Springs between every second particle, against bending.

    >>> rope([0, 0, 0], [0, 0, -1], 3, Family(1e4), mass=0.1).positions[1].tolist()
    [0.0, 0.0, -0.5]
    """
    fractions = np.linspace(0.0, 1.0, count)[:, None]
    start_point, end_point = (np.asarray(point, np.float64) for point in (start, end))
    masses = np.full(count, float(mass))
    if tip_mass is not None:
        masses[-1] = tip_mass
    return strand(
        start_point + fractions * (end_point - start_point),
        along,
        mass=masses,
        bend=bend,
    )


def strand(
    points: ArrayLike,
    along: Family | None,
    *,
    mass: ArrayLike,
    bend: Family | None = None,
) -> Body:
    """Return a strand through points, at rest in them.

    Args:
        points: ``(N, 3)`` [m].
        along: Springs between neighbours; None leaves them out.
        mass: Mass of each particle ``(N,)``, or one for all [kg].
        bend: Springs between every second particle, against bending.
    """
    positions = as_floats(points, ("N", 3), "points")
    line = np.arange(len(positions))
    families = [(grid_pairs(line, 1), along), (grid_pairs(line, 2), bend)]
    return build_body(positions, mass, families)


def sheet(
    columns: int,
    rows: int,
    *,
    mass: float,
    structural: Family | None = None,
    diagonal: Family | None = None,
    diagonals: Family | None = None,
    bend: Family | None = None,
    corner: ArrayLike = (0.0, 0.0, 0.0),
    across: ArrayLike = (1.0, 0.0, 0.0),
    up: ArrayLike = (0.0, 1.0, 0.0),
) -> Body:
    """Return a flat sheet; particle ``row * columns + column``.

    Each family is optional. Structural springs alone resist neither shear nor bending.
    One diagonal per cell resists shear unevenly, both diagonals evenly. Springs between
    every second particle resist bending.

    Args:
        columns: Number of particles across.
        rows: Number of particles up.
        mass: Mass of each particle [kg].
        structural: Springs between neighbours.
        diagonal: Springs along one diagonal of each cell, from its first corner.
        diagonals: Springs along both diagonals.
        bend: Springs between every second particle.
        corner: Position of particle 0 ``(3,)`` [m].
        across: Vector from it to the end of the row ``(3,)`` [m].
        up: Vector from it to the end of the column ``(3,)`` [m].

    >>> body = sheet(3, 2, mass=0.1, structural=Family(1e3), bend=Family(10.0))
    >>> body.springs.ends.tolist()
    [[0, 1], [1, 2], [3, 4], [4, 5], [0, 3], [1, 4], [2, 5], [0, 2], [3, 5]]
    """
    grid = np.arange(rows * columns).reshape(rows, columns)
    row_numbers, column_numbers = np.indices(grid.shape).reshape(2, -1, 1)
    origin, across_vector, up_vector = (
        np.asarray(vector, np.float64) for vector in (corner, across, up)
    )
    positions = origin + column_numbers / max(columns - 1, 1) * across_vector
    positions = positions + row_numbers / max(rows - 1, 1) * up_vector
    grid_edges, diagonal_pairs, bend_pairs = (
        np.concatenate([grid_pairs(grid, *offset) for offset in offsets])
        for offsets in ([(0, 1), (1, 0)], [(1, 1), (1, -1)], [(0, 2), (2, 0)])
    )
    rising_diagonals = grid_pairs(grid, 1, 1)
    families = [
        (grid_edges, structural),
        (rising_diagonals, diagonal),
        (diagonal_pairs, diagonals),
        (bend_pairs, bend),
    ]
    return build_body(positions, mass, families, _grid_triangles(grid))


def surface(
    points: ArrayLike,
    counts: ArrayLike,
    indices: ArrayLike,
    *,
    mass: ArrayLike,
    structural: Family | None = None,
    diagonals: Family | None = None,
    bend: Family | None = None,
) -> Body:
    """Return cloth from a polygon mesh, at rest in its points.

    Args:
        points: ``(N, 3)`` [m].
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
        mass: Mass of each particle ``(N,)``, or one for all [kg].
        structural: Springs along the edges.
        diagonals: Springs between non-adjacent corners of faces with four corners or
            more.
        bend: Springs across each shared edge, between the opposite corners of its
            triangles; larger faces are triangulated as fans.

    >>> body = surface(np.eye(4, 3), [3, 3], [0, 1, 2, 2, 1, 3], mass=1.0,
    ...                structural=Family(10.0), bend=Family(1.0))
    >>> body.springs.ends.tolist()
    [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [0, 3]]
    """
    positions = as_floats(points, ("N", 3), "points")
    face_sizes, corners = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    triangles = triangulate(face_sizes, corners)
    mesh_edges = edges(face_sizes, corners)
    diagonal_pairs = face_diagonals(face_sizes, corners)
    # Inner edges of a fan are not mesh edges and get no bend springs.
    triangle_sizes = np.full(len(triangles), 3)
    bends = hinge_pairs(triangle_sizes, triangles.ravel(), mesh_edges)
    families = [(mesh_edges, structural), (diagonal_pairs, diagonals), (bends, bend)]
    return build_body(positions, mass, families, triangles)


def face_diagonals(counts: IntArray, indices: IntArray) -> IntArray:
    """Return pairs of non-adjacent corners of each face ``(D, 2)``.

    >>> face_diagonals(np.array([4]), np.array([0, 1, 2, 3])).tolist()
    [[0, 2], [1, 3]]
    """
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    corner_offsets, sizes = np.arange(len(indices)) - starts, np.repeat(counts, counts)
    pairs = [np.zeros((0, 2), np.int64)]
    for step in range(2, int(counts.max(initial=0)) // 2 + 1):
        partners = indices[starts + (corner_offsets + step) % sizes]
        has_diagonal = sizes >= 2 * step
        pairs.append(np.stack([indices, partners], axis=1)[has_diagonal])
    return unique_pairs(np.concatenate(pairs))


def hinge_pairs(
    counts: IntArray, indices: IntArray, hinges: IntArray | None = None
) -> IntArray:
    """Return pairs of points for bend springs across shared edges ``(L, 2)``.

    For two triangles these are the opposite corners, for two quadrangles the neighbours
    of both ends. An edge of three faces bends between each two of them. With
    ``hinges``, only these edges bend ``(E, 2)``.

    >>> hinge_pairs(np.array([3, 3]), np.array([0, 1, 2, 1, 0, 3])).tolist()
    [[2, 3]]
    """
    starts = np.cumsum(counts) - counts
    first_corners, sizes = np.repeat([starts, counts], counts, axis=1)
    corner_offsets = np.arange(len(indices)) - first_corners
    edge_corners = directed_edges(counts, indices)
    # Neighbours of the first end of a side, and of the second.
    neighbours = np.stack(
        [indices[first_corners + (corner_offsets + k) % sizes] for k in (-1, 2)], axis=1
    )
    is_reversed = edge_corners[:, 0] > edge_corners[:, 1]
    neighbours[is_reversed] = neighbours[is_reversed, ::-1]
    first_edges, second_edges = coincident_edges(edge_corners)
    if hinges is not None:
        size = int(max(indices.max(initial=0), hinges.max(initial=0))) + 1
        keys = np.sort(edge_corners[first_edges], axis=1) @ [size, 1]
        is_hinge = np.isin(keys, hinges @ [size, 1])
        first_edges, second_edges = first_edges[is_hinge], second_edges[is_hinge]
    pairs = np.stack([neighbours[first_edges], neighbours[second_edges]], axis=-1)
    return unique_pairs(pairs.reshape(-1, 2))


def block(
    counts: tuple[int, int, int],
    size: ArrayLike,
    *,
    mass: float,
    structural: Family | None = None,
    face_diagonals: Family | None = None,
    body_diagonals: Family | None = None,
    corner: ArrayLike = (0.0, 0.0, 0.0),
) -> Body:
    """Return a solid block of particles on a grid; x runs fastest, then y, then z.

    Args:
        counts: Number of particles along x, y and z.
        size: Size along x, y and z ``(3,)`` [m].
        mass: Mass of each particle [kg].
        structural: Springs between neighbours along the axes.
        face_diagonals: Springs across the sides of each cell.
        body_diagonals: Springs through each cell.
        corner: Position of particle 0 ``(3,)`` [m].

    >>> cube = block((2, 2, 2), [1, 1, 1], mass=1.0, structural=Family(1.0),
    ...              face_diagonals=Family(1.0), body_diagonals=Family(1.0))
    >>> len(cube.springs.rest), len(cube.triangles)
    (28, 12)
    """
    grid = np.arange(np.prod(counts)).reshape(counts[::-1])
    z, y, x = np.indices(grid.shape)
    steps = np.maximum(np.array(counts) - 1, 1)
    origin, lengths = (np.asarray(vector, np.float64) for vector in (corner, size))
    fractions = np.stack([x, y, z], axis=-1).reshape(-1, 3) / steps
    positions = origin + fractions * lengths
    offsets = [offset for offset in product((-1, 0, 1), repeat=3) if offset > (0, 0, 0)]
    families = [
        (grid_pairs(grid, *offset), family)
        for axes, family in enumerate((structural, face_diagonals, body_diagonals), 1)
        for offset in offsets
        if sum(map(abs, offset)) == axes
    ]
    return build_body(positions, mass, families, _grid_surface(grid))


def tetrahedra(
    points: ArrayLike, cells: ArrayLike, edges: Family, *, mass: ArrayLike
) -> Body:
    """Return a body of tetrahedra with springs along their edges.

    Args:
        points: ``(N, 3)`` [m].
        cells: Corners of each tetrahedron ``(C, 4)``.
        edges: Springs along the edges.
        mass: Mass of each particle ``(N,)``, or one for all [kg].

    >>> body = tetrahedra(np.eye(4, 3), [[0, 1, 2, 3]], Family(1.0), mass=1.0)
    >>> len(body.springs.rest), len(body.triangles)
    (6, 4)
    """
    corners = np.asarray(cells, np.int64).reshape(-1, 4)
    corner_pairs = map(list, combinations(range(4), 2))
    cell_edges = np.concatenate([corners[:, ends] for ends in corner_pairs])
    faces = np.concatenate(
        [corners[:, side] for side in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])]
    )
    _, first_rows, counts = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    # A face shared by two cells is inside.
    outer_faces = faces[np.sort(first_rows[counts == 1])]
    unique_edges = np.unique(np.sort(cell_edges, axis=1), axis=0)
    return build_body(points, mass, [(unique_edges, edges)], outer_faces)


def grid_pairs(grid: IntArray, *offsets: int) -> IntArray:
    """Return pairs of grid particles at a fixed offset along the axes ``(P, 2)``."""
    first_slices = tuple(
        slice(max(-step, 0), -step if step > 0 else None) for step in offsets
    )
    second_slices = tuple(
        slice(max(step, 0), step if step < 0 else None) for step in offsets
    )
    return np.stack([grid[first_slices].ravel(), grid[second_slices].ravel()], axis=1)


def _grid_triangles(grid: IntArray, *, is_flipped: bool = False) -> IntArray:
    """Return two triangles for each cell of a grid ``(T, 3)``, reversed if flipped."""
    a, b = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel()
    c, d = grid[1:, 1:].ravel(), grid[1:, :-1].ravel()
    if is_flipped:
        b, d = d, b
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def _grid_surface(grid: IntArray) -> IntArray:
    """Return the outward-facing triangles around a grid of particles ``(T, 3)``."""
    sides = [
        _grid_triangles(np.take(grid, end, axis), is_flipped=is_flipped)
        for axis in range(3)
        for end, is_flipped in ((0, axis != 1), (-1, axis == 1))
    ]
    return np.concatenate(sides)


def connected_groups(count: int, pairs: IntArray) -> IntArray:
    """Return the group of each of ``count`` points that pairs connect ``(N,)``.

    >>> connected_groups(4, np.array([[0, 2], [1, 3]])).tolist()
    [0, 1, 0, 1]
    """
    first, second = np.asarray(pairs, np.int64).reshape(-1, 2).T
    smallest = np.arange(count)  # smallest point known to be connected
    while True:
        least = np.minimum(smallest[first], smallest[second])
        merged = smallest.copy()
        for ends in (first, second):
            np.minimum.at(merged, ends, least)
            np.minimum.at(merged, smallest[ends], least)
        merged = merged[merged]
        if (merged == smallest).all():
            return np.unique(smallest, return_inverse=True)[1].reshape(-1)
        smallest = merged
