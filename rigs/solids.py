"""Solids, their smooth unions, and what scripts that make surfaces ask of them.

A solid is a field: the distance to its surface, negative inside. Lengths are metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Field = Callable[[Array], Array]


def length(vectors: Array) -> Array:
    """Return the lengths of vectors ``(..., 3)``."""
    return np.sqrt((vectors**2).sum(-1))


def smoothstep(low: ArrayLike, high: ArrayLike, x: ArrayLike) -> Array:
    """Return the cubic step from 0 at low to 1 at high."""
    low, high, x = np.asarray(low), np.asarray(high), np.asarray(x)
    u = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(u * u * (3 - 2 * u))


def join(a: Array, b: Array, blend: float) -> Array:
    """Return the union of two solids, rounded where they meet over a width."""
    h = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - h * h * h * blend / 6


def cut(a: Array, b: Array, blend: float) -> Array:
    """Return the first solid without the second."""
    return -join(-a, b, blend)


def ellipsoid(points: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """Return the distance to an ellipsoid along the axes, exact to first order."""
    radii = np.asarray(radii, np.float64)
    scaled = (points - np.asarray(centre)) / radii
    k0 = length(scaled)
    k1 = length(scaled / radii)
    return np.asarray(k0 * (k0 - 1.0) / np.maximum(k1, 1e-9))


def cone(points: Array, a: ArrayLike, b: ArrayLike, ra: float, rb: float) -> Array:
    """Return the distance to a capsule with a radius at each end."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    axis = b - a
    along = np.clip((points - a) @ axis / (axis @ axis), 0.0, 1.0)
    near = a + along[..., None] * axis
    return length(points - near) - (ra + (rb - ra) * along)


def gradient(field: Field, points: Array) -> Array:
    """Return unit gradients of a field ``(V, 3)``."""
    step = 1e-5
    slopes = [
        field(points + step * axis) - field(points - step * axis) for axis in np.eye(3)
    ]
    made = np.stack(slopes, axis=-1)
    return np.asarray(made / np.maximum(length(made), 1e-12)[..., None])


def project(
    field: Field, points: Array, level: ArrayLike = 0.0, steps: int = 4
) -> Array:
    """Return points moved along the gradient to a level of a field."""
    for _ in range(steps):
        step = 1e-5
        slopes = np.stack(
            [
                (field(points + step * a) - field(points - step * a)) / (2 * step)
                for a in np.eye(3)
            ],
            axis=-1,
        )
        square = np.maximum((slopes**2).sum(-1), 0.05)
        points = points - ((field(points) - level) / square)[..., None] * slopes
    return points


def cast(field: Field, starts: Array, directions: Array, reach: float) -> Array:
    """Return where rays from outside first meet the skin ``(V, 3)``."""
    gone = np.zeros(len(starts))
    for _ in range(40):
        here = starts + gone[:, None] * directions
        gone = np.minimum(gone + 0.85 * field(here), reach)
    return starts + gone[:, None] * directions


def falloff(points: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """Return a bump: 1 at the centre, 0 and smooth from the radii outwards."""
    square = (((points - np.asarray(centre)) / np.asarray(radii)) ** 2).sum(-1)
    return np.asarray(np.maximum(1 - square, 0.0) ** 2)


def curve(knots: ArrayLike, values: ArrayLike, x: ArrayLike) -> Array:
    """Return piecewise linear values, for tables ``(K,)`` or ``(K, D)``."""
    table = np.asarray(values, np.float64)
    if table.ndim == 1:
        return np.asarray(np.interp(x, knots, table))
    return np.stack([np.interp(x, knots, column) for column in table.T], axis=-1)


def surface_normals(points: Array, faces: Ints) -> Array:
    """Return unit normals, faces ``(N, 4)`` weighted by area ``(V, 3)``."""
    made = np.zeros_like(points)
    corners = np.where(faces >= 0, faces, faces[:, [2]])
    a, b, c, d = (points[corners[:, k]] for k in range(4))
    across = np.cross(c - a, d - b)
    for k in range(4):
        real = faces[:, k] >= 0
        np.add.at(made, faces[real, k], across[real])
    return np.asarray(made / np.maximum(length(made), 1e-12)[:, None])


def neighbours(faces: Ints) -> Ints:
    """Return every pair of points that share an edge, once ``(E, 2)``."""
    ring = np.where(faces >= 0, faces, faces[:, :1])
    pairs = np.concatenate([ring[:, [k, (k + 1) % 4]] for k in range(4)])
    return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def relaxed(
    points: Array, faces: Ints, field: Field, loose: NDArray[np.bool_], steps: int
) -> Array:
    """Return points spread evenly over a surface, those that are not loose kept.

    Points with x = 0 stay there.
    """
    pairs, middle = neighbours(faces), points[:, 0] == 0
    count = np.bincount(pairs.ravel(), minlength=len(points))[:, None]
    points = points.copy()
    for _ in range(steps):
        total = np.zeros_like(points)
        np.add.at(total, pairs[:, 0], points[pairs[:, 1]])
        np.add.at(total, pairs[:, 1], points[pairs[:, 0]])
        moved = points + 0.5 * (total / count - points)
        moved[middle, 0] = 0.0
        points[loose] = project(field, moved[loose], steps=2)
        points[middle, 0] = 0.0
    points[loose] = project(field, points[loose], steps=6)
    points[middle, 0] = 0.0
    return points
