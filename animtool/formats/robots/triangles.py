"""Primitive shapes as triangles with flat sides."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.formats.robots.parts import SimpleShape, Triangles
from animtool.maths import so3

AROUND, ALONG = 24, 12  # corners of a circle, and of half of one


def joined(parts: list[Triangles]) -> Triangles:
    """Return several surfaces as one."""
    counts = np.cumsum([0, *(len(part.points) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, counts, strict=False)]
    return Triangles(
        np.concatenate([part.points for part in parts]), np.concatenate(faces)
    )


def triangles_of(solid: SimpleShape) -> Triangles:
    """Return the surface of a shape, placed on its link.

    >>> box = triangles_of(SimpleShape("box", (1.0, 2.0, 3.0)))
    >>> len(box.points), len(box.faces), box.points.max(axis=0).tolist()
    (24, 12, [0.5, 1.0, 1.5])
    """
    if solid.kind == "box":
        shape = _box(np.array(solid.size))
    elif solid.kind == "cylinder":
        radius, length = solid.size
        shape = _cylinder(radius, length)
    else:
        length = solid.size[1] if solid.kind == "capsule" else 0.0
        shape = _round(solid.size[0], length)
    points = so3.rotate(np.array(solid.rotation), shape.points)
    return Triangles(points + np.array(solid.position), shape.faces)


def _box(size: FloatArray) -> Triangles:
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    sides = []
    for axis in range(3):
        for end in (-0.5, 0.5):
            points = np.full((4, 3), end)
            across = [(axis + 1) % 3, (axis + 2) % 3]
            points[:, across] = square if end > 0 else square[::-1]
            sides.append(Triangles(points * size, np.array([[0, 1, 2], [0, 2, 3]])))
    return joined(sides)


def _circle(count: int = AROUND) -> FloatArray:
    angles = 2 * math.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _cylinder(radius: float, length: float) -> Triangles:
    ring = _circle() * radius
    ends = [np.column_stack([ring, np.full(AROUND, z * length)]) for z in (-0.5, 0.5)]
    sides = Triangles(np.concatenate(ends), _band(0, AROUND))
    fan = np.array([[0, k, k + 1] for k in range(1, AROUND - 1)])
    return joined([sides, Triangles(ends[0], fan[:, ::-1]), Triangles(ends[1], fan)])


def _band(below: int, above: int) -> IntArray:
    """Return faces between two rings, counterclockwise from outside."""
    k = np.arange(AROUND)
    after = (k + 1) % AROUND
    first = np.stack([below + k, below + after, above + after], axis=1)
    second = np.stack([below + k, above + after, above + k], axis=1)
    return np.concatenate([first, second])


def _round(radius: float, length: float) -> Triangles:
    """Return a sphere, or a capsule along z."""
    heights = np.linspace(-math.pi / 2, math.pi / 2, ALONG + 1)
    rows = [(h, -0.5 if h <= 0 else 0.5) for h in heights]
    if length:
        rows.insert(ALONG // 2 + 1, (0.0, 0.5))
    rings = [
        np.column_stack(
            [
                _circle() * radius * math.cos(h),
                np.full(AROUND, radius * math.sin(h) + side * length),
            ]
        )
        for h, side in rows
    ]
    bands = [_band(k * AROUND, (k + 1) * AROUND) for k in range(len(rows) - 1)]
    return Triangles(np.concatenate(rings), np.concatenate(bands))
