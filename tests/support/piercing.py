"""Distances and crossings of triangles, pairs at once in numpy."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray

__all__ = ["distances", "pierced"]


def distances(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return how far points ``(N, 3)`` are from triangles ``(T, 3, 3)``."""
    p, (a, b, c) = points[:, None], corners.transpose(1, 0, 2)

    def along(first: FloatArray, second: FloatArray) -> FloatArray:
        way = second - first
        share = ((p - first) * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-300)
        near = first + np.clip(share, 0, 1)[..., None] * way
        return np.asarray(np.linalg.norm(p - near, axis=-1))

    sides = np.minimum(np.minimum(along(a, b), along(b, c)), along(c, a))
    normals = np.cross(b - a, c - a)
    area = np.maximum((normals * normals).sum(-1), 1e-300)
    shares = [
        (np.cross(second - first, p - first) * normals).sum(-1) / area
        for first, second in ((a, b), (b, c), (c, a))
    ]
    height = np.abs(((p - a) * normals).sum(-1)) / np.sqrt(area)
    over = np.all(np.array(shares) >= 0, axis=0)
    return np.where(over, height, sides)


def pierced(x: FloatArray, triangles: IntArray) -> int:
    """Return how many edges go through triangles that they have no corner of."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    low, high = (pick(x[edges], axis=1) for pick in (np.min, np.max))
    least, most = (pick(x[triangles], axis=1) for pick in (np.min, np.max))
    # Boxes that overlap; few do, and only these pairs are looked at.
    near = np.ones((len(edges), len(triangles)), bool)
    for k in range(3):
        near &= low[:, None, k] <= most[None, :, k]
        near &= high[:, None, k] >= least[None, :, k]
    one, other = np.nonzero(near)
    ends, corners = edges[one], triangles[other]
    p, q = x[ends].transpose(1, 0, 2)
    a, b, c = x[corners].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    first, last = (((end - a) * normals).sum(-1) for end in (p, q))
    through = first * last < 0
    share = np.where(through, first, 0.0) / np.where(through, first - last, 1.0)
    hit = p + share[..., None] * (q - p)
    inside = [
        (np.cross(second - one, hit - one) * normals).sum(-1) > 0
        for one, second in ((a, b), (b, c), (c, a))
    ]
    apart = (ends[:, :, None] != corners[:, None, :]).all(axis=(1, 2))
    return int((apart & through & np.all(inside, axis=0)).sum())
