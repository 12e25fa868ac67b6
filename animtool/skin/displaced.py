"""Meshes whose points a simulation has moved away from their joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.maths.faces import triangulated
from animtool.motion import Channel
from animtool.rig.surfaces import Surface
from animtool.skin.deform import Deformed, extents


def displaced_points(
    made: Deformed,
    points: Channel,
    frames: slice,
    surface: Surface | None,
    times: FloatArray | None,
) -> Deformed:
    """Return frames of a mesh at other points than those that its joints give.

    Normals stay in frames whose points are those that they were made for, and are
    those of the faces elsewhere.

    Args:
        made: The frames as joints have them.
        points: Where the points are, in more frames ``(F, V, 3)`` [m].
        frames: Which of those these are.
        surface: Its faces; None of strands.
        times: Of all frames ``(F,)`` [s]; None for no velocities.

    >>> still = Deformed(np.zeros((1, 2, 3)), np.zeros((1, 2, 3)))
    >>> up = Channel(np.zeros((2, 3)), np.arange(2), np.ones((3, 2, 3)))
    >>> displaced_points(still, up, slice(1, 2), None, None).extents.tolist()
    [[[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]]
    """
    margin = 0 if times is None else 1
    low = max(frames.start - margin, 0)
    high = min(frames.stop + margin, len(points.values))
    whole = points.select(slice(low, high)).dense()
    own = slice(frames.start - low, frames.stop - low)
    values = np.ascontiguousarray(whole[own])
    velocities = made.velocities
    if times is not None:
        velocities = np.zeros_like(values)
        if len(whole) > 1:
            velocities = np.gradient(whole, times[low:high], axis=0)[own]
    normals = made.normals
    if normals is not None and surface is not None:
        differ = (values != made.points).any(axis=(1, 2))
        normals = normals.copy()
        normals[differ] = vertex_normals(surface, values[differ])
    return replace(
        made,
        points=values,
        extents=extents(values),
        normals=normals,
        velocities=velocities,
    )


def vertex_normals(surface: Surface, points: FloatArray) -> FloatArray:
    """Return unit normals of the faces about each point ``(F, V, 3)``, by area.

    ``points`` ``(F, V, 3)``.
    """
    corners = triangulated(surface.counts, surface.indices)
    a, b, c = (points[:, corners[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    sums = np.zeros_like(points)
    by_vertex = np.moveaxis(sums, 1, 0)
    for k in range(3):
        np.add.at(by_vertex, corners[:, k], np.moveaxis(areas, 1, 0))
    length = np.linalg.norm(sums, axis=-1, keepdims=True)
    return np.asarray(sums / np.where(length > 0, length, 1.0))
