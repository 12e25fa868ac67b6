"""Meshes of boxes, spheres, cylinders, cones and capsules, about the z axis."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray, IntArray

# Points ``(N, 3)``, corner counts of faces ``(M,)``, and corner indices face by face.
Solid: TypeAlias = tuple[FloatArray, IntArray, IntArray]

SIDE_COUNT, RING_COUNT = 24, 12


def box(size: float) -> Solid:
    """Return a cube of six faces about the origin.

    >>> points, counts, indices = box(2.0)
    >>> points.min().item(), points.max().item(), len(counts)
    (-1.0, 1.0, 6)
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ]
    return corners * (size / 2), np.full(6, 4), np.array(faces).reshape(-1)


def revolve(profile: FloatArray) -> Solid:
    """Return the surface of revolution about z of radii and heights ``(P, 2)``.

    >>> len(revolve(np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]]))[0])
    72
    """
    angles = np.arange(SIDE_COUNT) * (2 * math.pi / SIDE_COUNT)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = [
        np.concatenate([radius * circle, np.full((SIDE_COUNT, 1), height)], axis=1)
        for radius, height in profile.tolist()
    ]
    rows = np.arange(len(profile) - 1)[:, None] * SIDE_COUNT
    columns = np.arange(SIDE_COUNT)[None]
    next_columns = (np.arange(SIDE_COUNT) + 1)[None] % SIDE_COUNT
    a, b = rows + columns, rows + next_columns
    faces = np.stack([a, b, b + SIDE_COUNT, a + SIDE_COUNT], axis=-1).reshape(-1)
    return np.concatenate(rings), np.full(len(faces) // 4, 4), faces


def sphere(radius: float) -> Solid:
    """Return a sphere about the origin, with poles on the z axis."""
    return capsule(radius, 0.0)


def capsule(radius: float, height: float) -> Solid:
    """Return a capsule; ``height`` is the height of its cylinder."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, RING_COUNT + 1)
    z = radius * np.sin(angles)
    z += np.where(angles > 1e-9, height / 2, -height / 2)
    return revolve(np.stack([radius * np.cos(angles), z], axis=1))


def cylinder(radius: float, height: float, top: float | None = None) -> Solid:
    """Return a closed cylinder; ``top``: radius of its top, 0 for a cone."""
    top_radius = radius if top is None else top
    low, high = -height / 2, height / 2
    profile = [[0.0, low], [radius, low], [top_radius, high], [0.0, high]]
    return revolve(np.array(profile))
