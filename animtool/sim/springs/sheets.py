"""Sheets: particles on a grid, with the families of springs that cloth is made of."""

from __future__ import annotations

import numpy as np

from animtool._types import ArrayLike, FloatArray, IntArray
from animtool.sim.springs.body import Body, Family, built


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

    Each family of springs may be there or not. Structural springs alone resist neither
    shearing nor bending; one diagonal a cell resists shearing, one way more than the
    other; both, alike; springs that skip one particle resist bending.

    Args:
        columns: Particles across.
        rows: Particles up.
        mass: Of each [kg].
        structural: Springs between neighbours.
        diagonal: Springs along one diagonal of each cell, from its first corner.
        diagonals: Springs along both.
        bend: Springs that skip one.
        corner: Where particle 0 is ``(3,)`` [m].
        across: From it to the end of the row ``(3,)`` [m].
        up: From it to the end of the column ``(3,)`` [m].

    >>> body = sheet(3, 2, mass=0.1, structural=Family(1e3), bend=Family(10.0))
    >>> body.springs.ends.tolist()
    [[0, 1], [1, 2], [3, 4], [4, 5], [0, 3], [1, 4], [2, 5], [0, 2], [3, 5]]
    """
    grid = np.arange(rows * columns).reshape(rows, columns)
    along, upward = np.meshgrid(_shares(columns), _shares(rows), indexing="xy")
    first, right, top = (np.asarray(each, np.float64) for each in (corner, across, up))
    places = first + along.reshape(-1, 1) * right + upward.reshape(-1, 1) * top
    rising = _pairs(grid[:-1, :-1], grid[1:, 1:])
    falling = _pairs(grid[:-1, 1:], grid[1:, :-1])
    families = [
        (_both_ways(grid, 1), structural),
        (rising, diagonal),
        (np.concatenate([rising, falling]), diagonals),
        (_both_ways(grid, 2), bend),
    ]
    return built(places, mass, families, _triangles(grid))


def _shares(count: int) -> FloatArray:
    return np.arange(count) / max(count - 1, 1)


def _pairs(first: IntArray, second: IntArray) -> IntArray:
    return np.stack([first.ravel(), second.ravel()], axis=1)


def _both_ways(grid: IntArray, step: int) -> IntArray:
    right = _pairs(grid[:, :-step], grid[:, step:])
    return np.concatenate([right, _pairs(grid[:-step], grid[step:])])


def _triangles(grid: IntArray) -> IntArray:
    a, b = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel()
    c, d = grid[1:, 1:].ravel(), grid[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
