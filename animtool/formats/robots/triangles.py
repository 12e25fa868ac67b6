"""Triangulates boxes, cylinders, spheres and capsules."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.formats.robots.parts import SimpleShape, Triangles
from animtool.maths import so3

CIRCLE_CORNERS, ARC_CORNERS = 24, 12  # corners of a circle, and of half of one


def merge_surfaces(surfaces: list[Triangles]) -> Triangles:
    """Merge triangle surfaces into one."""
    point_offsets = np.cumsum([0, *(len(surface.points) for surface in surfaces)])
    faces = [
        s.faces + point_offset
        for s, point_offset in zip(surfaces, point_offsets, strict=False)
    ]
    return Triangles(
        np.concatenate([surface.points for surface in surfaces]), np.concatenate(faces)
    )


def triangulate_shape(solid: SimpleShape) -> Triangles:
    """Return the surface of a shape in the frame of its link.

    >>> box = triangulate_shape(SimpleShape("box", (1.0, 2.0, 3.0)))
    >>> len(box.points), len(box.faces), box.points.max(axis=0).tolist()
    (24, 12, [0.5, 1.0, 1.5])
    """
    if solid.kind == "box":
        surface = _box_faces(np.array(solid.size))
    elif solid.kind == "cylinder":
        radius, length = solid.size
        surface = _cylinder_faces(radius, length)
    else:
        length = solid.size[1] if solid.kind == "capsule" else 0.0
        surface = _sphere_or_capsule(solid.size[0], length)
    points = so3.rotate(np.array(solid.rotation), surface.points)
    return Triangles(points + np.array(solid.position), surface.faces)


def _box_faces(size: FloatArray) -> Triangles:
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    sides = []
    for axis in range(3):
        for face_side in (-0.5, 0.5):
            points = np.full((4, 3), face_side)
            other_axes = [(axis + 1) % 3, (axis + 2) % 3]
            points[:, other_axes] = corners if face_side > 0 else corners[::-1]
            sides.append(Triangles(points * size, np.array([[0, 1, 2], [0, 2, 3]])))
    return merge_surfaces(sides)


def _circle_points() -> FloatArray:
    angles = 2 * math.pi * np.arange(CIRCLE_CORNERS) / CIRCLE_CORNERS
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _cylinder_faces(radius: float, length: float) -> Triangles:
    circle = _circle_points() * radius
    rings = [
        np.column_stack([circle, np.full(CIRCLE_CORNERS, z * length)])
        for z in (-0.5, 0.5)
    ]
    sides = Triangles(np.concatenate(rings), _side_faces(0, CIRCLE_CORNERS))
    fan = np.array([[0, k, k + 1] for k in range(1, CIRCLE_CORNERS - 1)])
    return merge_surfaces(
        [sides, Triangles(rings[0], fan[:, ::-1]), Triangles(rings[1], fan)]
    )


def _side_faces(lower: int, upper: int) -> IntArray:
    """Return the triangles between two rings, counterclockwise as seen from outside."""
    corner_indices = np.arange(CIRCLE_CORNERS)
    next_corner = (corner_indices + 1) % CIRCLE_CORNERS
    lower_triangles = np.stack(
        [lower + corner_indices, lower + next_corner, upper + next_corner], axis=1
    )
    upper_triangles = np.stack(
        [lower + corner_indices, upper + next_corner, upper + corner_indices], axis=1
    )
    return np.concatenate([lower_triangles, upper_triangles])


def _sphere_or_capsule(radius: float, length: float) -> Triangles:
    """Return the triangles of a sphere, or of a capsule along z."""
    latitudes = np.linspace(-math.pi / 2, math.pi / 2, ARC_CORNERS + 1)
    rows = [(latitude, -0.5 if latitude <= 0 else 0.5) for latitude in latitudes]
    if length:
        rows.insert(ARC_CORNERS // 2 + 1, (0.0, 0.5))
    rings = [
        np.column_stack(
            [
                _circle_points() * radius * math.cos(latitude),
                np.full(CIRCLE_CORNERS, radius * math.sin(latitude) + side * length),
            ]
        )
        for latitude, side in rows
    ]
    side_faces = [
        _side_faces(k * CIRCLE_CORNERS, (k + 1) * CIRCLE_CORNERS)
        for k in range(len(rows) - 1)
    ]
    return Triangles(np.concatenate(rings), np.concatenate(side_faces))
