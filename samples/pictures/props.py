"""Boxes, cylinders and rods, and those that stand on a USD stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from picture import Surface
from pxr import Usd, UsdGeom

Array = NDArray[np.float64]

GREY = (0.6, 0.6, 0.6)
SIDES = 32
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
_FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
_SQUARE = ((-1, -1), (-1, 1), (1, 1), (1, -1))
# The columns of a frame whose Z is that axis.
_TURNED = {"X": [1, 2, 0], "Y": [2, 0, 1], "Z": [0, 1, 2]}


def box(world: Array, colour: ArrayLike = GREY) -> Surface:
    """Return the box from -1 to 1, brought somewhere by a matrix ``(4, 4)``."""
    points = _CORNERS[_FACES] @ world[:3, :3].T + world[:3, 3]
    first = 4 * np.arange(6)[:, None]
    triangles = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
    return Surface(points, triangles, np.tile(colour, (len(points), 1)))


def cylinder(world: Array, colour: ArrayLike = GREY, taper: float = 1.0) -> Surface:
    """Return the cylinder of radius 1 about Z from -1 to 1, brought by a matrix.

    Args:
        world: ``(4, 4)``.
        colour: From 0 to 1.
        taper: Radius at the upper end.
    """
    turn = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(SIDES, -1.0)], axis=1)
    top = ring * [taper, taper, -1.0]
    # Rims twice, so that caps are shaded flat.
    points = np.concatenate([ring, top, ring, top, [[0, 0, -1], [0, 0, 1]]])
    a = np.arange(SIDES)
    b = (a + 1) % SIDES
    low, high = np.full(SIDES, 4 * SIDES), np.full(SIDES, 4 * SIDES + 1)
    triangles = [
        np.stack([a, b, SIDES + b], axis=1),
        np.stack([a, SIDES + b, SIDES + a], axis=1),
        np.stack([low, 2 * SIDES + b, 2 * SIDES + a], axis=1),
        np.stack([high, 3 * SIDES + a, 3 * SIDES + b], axis=1),
    ]
    placed = points @ world[:3, :3].T + world[:3, 3]
    colours = np.tile(colour, (len(points), 1))
    return Surface(placed, np.concatenate(triangles), colours)


def rod(
    start: ArrayLike,
    end: ArrayLike,
    radius: float,
    colour: ArrayLike = GREY,
    taper: float = 1.0,
) -> Surface:
    """Return a round rod from one point to another."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (end - start) / 2
    length = np.linalg.norm(along)
    passthrough = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    passthrough *= radius / np.linalg.norm(passthrough)
    world = np.eye(4)
    world[:3, 0], world[:3, 1] = passthrough, np.cross(along, passthrough) / length
    world[:3, 2], world[:3, 3] = along, (start + end) / 2
    return cylinder(world, colour, taper)


def floor(centre: ArrayLike, half: float, colour: ArrayLike = GREY) -> Surface:
    """Return a square of the ground, y = 0, about a point."""
    x, _, z = np.asarray(centre, np.float64)
    corners = [(x + a * half, 0.0, z + b * half) for a, b in _SQUARE]
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return Surface(np.array(corners), triangles, np.tile(colour, (4, 1)))


def stage_surfaces(path: Path, code: float) -> list[Surface]:
    """Return the cubes and cylinders of a USD stage at a time code."""
    stage = Usd.Stage.Open(str(path))
    cache = UsdGeom.XformCache(Usd.TimeCode(code))
    made = []
    for prim in stage.Traverse():
        world = np.array(cache.GetLocalToWorldTransform(prim)).T
        shown = UsdGeom.Gprim(prim).GetDisplayColorAttr() if prim else None
        colour = shown.Get()[0] if shown and shown.Get() else GREY
        if prim.IsA(UsdGeom.Cube):
            half = UsdGeom.Cube(prim).GetSizeAttr().Get() / 2
            made.append(box(world @ np.diag([half, half, half, 1.0]), colour))
        elif prim.IsA(UsdGeom.Cylinder):
            shape = UsdGeom.Cylinder(prim)
            radius = shape.GetRadiusAttr().Get()
            scales = [radius, radius, shape.GetHeightAttr().Get() / 2]
            scaled = np.diag([0.0, 0.0, 0.0, 1.0])
            axes = _TURNED[shape.GetAxisAttr().Get()]
            scaled[axes, [0, 1, 2]] = scales
            made.append(cylinder(world @ scaled, colour))
    return made
