"""Meshes of balls and boxes, closed and counter-clockwise as seen from outside."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray

BOX_FACES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ]
)  # fmt: skip


def box_mesh(size: float) -> tuple[FloatArray, IntArray]:
    """Return points and triangles of a box about the origin with these sides."""
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    return corners * (size / 2), BOX_FACES


def ball_mesh(levels: int, radius: float = 1.0) -> tuple[FloatArray, IntArray]:
    """Return points and triangles of an octahedron, halved so often, on a ball."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array(
        [
            [0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
            [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5],
        ]
    )  # fmt: skip
    for _ in range(levels):
        sides = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]))
        edges, which = np.unique(sides, axis=0, return_inverse=True)
        middles = len(points) + which.reshape(3, -1)
        points = np.concatenate([points, points[edges].sum(axis=1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        a, b, c = faces.T
        ab, bc, ca = middles
        parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        faces = np.concatenate([np.stack(part, axis=1) for part in parts])
    return points * radius, faces
