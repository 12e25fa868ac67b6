"""Cloth of a mesh: springs along edges, across cells and against bending."""

from __future__ import annotations

import numpy as np

from animtool._types import ArrayLike, BoolArray, IntArray, as_floats
from animtool.maths.faces import (
    distinct_pairs,
    edges,
    of_one_edge,
    triangulated,
)
from animtool.sim.springs.body import Body, Family, built


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
    """Return the cloth of a polygon mesh, at rest where its points are.

    Args:
        points: ``(N, 3)`` [m].
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
        mass: Of each particle, or of all ``(N,)`` [kg].
        structural: Springs along the edges.
        diagonals: Springs across faces of four corners or more, to corners that are
            not neighbours.
        bend: Springs over each edge of two triangles, between the corners off it; of
            faces with more corners, triangles are those of their fans. An edge of more
            than two joins all of them.

    >>> body = surface(np.eye(4, 3), [3, 3], [0, 1, 2, 2, 1, 3], mass=1.0,
    ...                structural=Family(10.0), bend=Family(1.0))
    >>> body.springs.ends.tolist()
    [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [0, 3]]
    """
    places = as_floats(points, ("N", 3), "points")
    sizes, corners = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    triangles = triangulated(sizes, corners)
    along = edges(sizes, corners)
    crossing = _crossing(sizes, corners)
    # A fan's inner edges are no edges of the mesh, and are not bent over.
    hinges = _hinges(triangles, along)
    families = [(along, structural), (crossing, diagonals), (hinges, bend)]
    return built(places, mass, families, triangles)


def _crossing(counts: IntArray, indices: IntArray) -> IntArray:
    found = [np.zeros((0, 2), np.int64)]
    for step in range(2, int(counts.max(initial=0)) // 2 + 1):
        wide = np.repeat(counts >= 2 * step, counts)
        found.append(_steps(counts, indices, np.full_like(counts, step))[wide])
    return distinct_pairs(np.concatenate(found))


def _steps(counts: IntArray, indices: IntArray, steps: IntArray) -> IntArray:
    """Return each corner with that some steps further round its face."""
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    around, sizes = np.arange(len(indices)) - starts, np.repeat(counts, counts)
    ahead = starts + (around + np.repeat(steps, counts)) % np.maximum(sizes, 1)
    return np.stack([indices, indices[ahead]], axis=1)


def _hinges(triangles: IntArray, kept: IntArray) -> IntArray:
    """Return the corners off each of some edges that triangles share ``(B, 2)``."""
    own = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    off = np.concatenate([triangles[:, (k + 2) % 3] for k in range(3)])
    one, other = of_one_edge(own)
    wanted = _among(np.sort(own[one], axis=1), kept)
    return distinct_pairs(np.stack([off[one], off[other]], axis=1)[wanted])


def _among(pairs: IntArray, kept: IntArray) -> BoolArray:
    size = int(max(pairs.max(initial=0), kept.max(initial=0))) + 1
    return np.isin(pairs @ [size, 1], kept @ [size, 1])
