"""Volumes: blocks and tetrahedra."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from animtool._types import ArrayLike, IntArray
from animtool.sim.springs.body import Body, Family, built


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
        counts: Particles along x, y and z.
        size: Along x, y and z ``(3,)`` [m].
        mass: Of each particle [kg].
        structural: Springs between neighbours along the axes.
        face_diagonals: Springs across the sides of each cell.
        body_diagonals: Springs through each cell.
        corner: Where particle 0 is ``(3,)`` [m].

    >>> cube = block((2, 2, 2), [1, 1, 1], mass=1.0, structural=Family(1.0),
    ...              face_diagonals=Family(1.0), body_diagonals=Family(1.0))
    >>> len(cube.springs.rest), len(cube.triangles)
    (28, 12)
    """
    grid = np.arange(np.prod(counts)).reshape(counts[::-1])
    z, y, x = np.indices(grid.shape)
    steps = np.maximum(np.array(counts) - 1, 1)
    shares = np.stack([x, y, z], axis=-1).reshape(-1, 3) / steps
    places = np.asarray(corner, np.float64) + shares * np.asarray(size, np.float64)
    ways = [way for way in product((-1, 0, 1), repeat=3) if way > (0, 0, 0)]
    by_axes = [
        np.concatenate(
            [_pairs(grid, way) for way in ways if sum(map(abs, way)) == axes]
        )
        for axes in (1, 2, 3)
    ]
    families = list(
        zip(by_axes, (structural, face_diagonals, body_diagonals), strict=True)
    )
    return built(places, mass, families, _skin(grid))


def tetrahedra(
    points: ArrayLike, cells: ArrayLike, edges: Family, *, mass: ArrayLike
) -> Body:
    """Return the body of tetrahedra, with springs along their edges.

    Args:
        points: ``(N, 3)`` [m].
        cells: Corners of each ``(C, 4)``.
        edges: Their springs.
        mass: Of each particle, or of all ``(N,)`` [kg].

    >>> body = tetrahedra(np.eye(4, 3), [[0, 1, 2, 3]], Family(1.0), mass=1.0)
    >>> len(body.springs.rest), len(body.triangles)
    (6, 4)
    """
    corners = np.asarray(cells, np.int64).reshape(-1, 4)
    pairs = np.concatenate([corners[:, list(two)] for two in combinations(range(4), 2)])
    sides = np.concatenate(
        [corners[:, side] for side in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])]
    )
    _, first, often = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    # A side of two cells is inside.
    outside = sides[np.sort(first[often == 1])]
    unique = np.unique(np.sort(pairs, axis=1), axis=0)
    return built(points, mass, [(unique, edges)], outside)


def _pairs(grid: IntArray, way: tuple[int, ...]) -> IntArray:
    here = tuple(slice(max(-step, 0), -step if step > 0 else None) for step in way)
    there = tuple(slice(max(step, 0), step if step < 0 else None) for step in way)
    return np.stack([grid[here].ravel(), grid[there].ravel()], axis=1)


def _skin(grid: IntArray) -> IntArray:
    """Return the triangles around a grid, their fronts outside."""
    found = []
    for axis in range(3):
        for end, flip in ((0, axis != 1), (-1, axis == 1)):
            side = np.take(grid, end, axis=axis)
            a, b = side[:-1, :-1].ravel(), side[:-1, 1:].ravel()
            c, d = side[1:, 1:].ravel(), side[1:, :-1].ravel()
            if flip:
                b, d = d, b
            found += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return np.concatenate(found)
