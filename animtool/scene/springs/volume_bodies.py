"""Volumes of entries: blocks and tetrahedra."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.document import Location
from animtool.errors import Fault, listed
from animtool.scene.springs.bodies import (
    Families,
    SpringBody,
    check_grid,
    refuse_keys,
    share_out,
    some_of,
)
from animtool.scene.springs.schema import VolumeModel
from animtool.scene.springs.shapes import Faces
from animtool.scene.systems.entries import EntryReader
from animtool.sim.springs import Body, block, tetrahedra


def volume_body(
    reader: EntryReader,
    at: Location,
    model: VolumeModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    """Return a volume; None where what is noted leaves none."""
    if model.tetrahedra is not None:
        why = "is for a block, and this is of tetrahedra"
        refuse_keys(reader, at, model, {"corner", "size", "resolution"}, why)
        return _tetrahedra(reader, at, model, families, mass)
    x, y, z = model.resolution
    check_grid(reader, at, "a volume", model.resolution)
    if min(model.size) <= 0:
        message = f"its size must be above 0 each way, not {listed(model.size)}"
        reader.note((*at, "size"), Fault("SIM050", message))
    if not reader.sound:
        return None
    body = block(
        (x, y, z), model.size, mass=mass / (x * y * z), corner=model.corner, **families
    )
    grid = np.arange(x * y * z).reshape(z, y, x)
    places = {
        "back": grid[0].ravel(),
        "front": grid[-1].ravel(),
        "bottom": grid[:, 0].ravel(),
        "top": grid[:, -1].ravel(),
        "left": grid[:, :, 0].ravel(),
        "right": grid[:, :, -1].ravel(),
    }
    return SpringBody(body, places, _skin(body))


def _tetrahedra(
    reader: EntryReader,
    at: Location,
    model: VolumeModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    assert model.tetrahedra is not None
    place = (*at, "tetrahedra")
    points = reader.array((*place, "points"), model.tetrahedra.points, "points")
    cells = reader.array((*place, "cells"), model.tetrahedra.cells, "cells")
    edges = families["structural"]
    if edges is None:
        message = "tetrahedra have structural springs, along their edges"
        reader.note((*at, "springs"), Fault("SIM050", message))
    for name in ("face_diagonals", "body_diagonals"):
        if families[name] is not None:
            message = f"{name} are for a block, and this is of tetrahedra"
            reader.note((*at, "springs", name), Fault("SIM050", message))
    if points is None or cells is None or edges is None:
        return None
    message = _tetrahedra_fault(points, cells)
    if message:
        reader.note(place, Fault("SIM051", message))
    if not reader.sound:
        return None
    corners = cells.astype(np.int64)
    share = _volumes(points, corners)
    body = tetrahedra(points, corners, edges, mass=mass * share)
    return SpringBody(body, {"skin": np.unique(body.triangles)}, _skin(body))


def _tetrahedra_fault(points: FloatArray, cells: FloatArray) -> str:
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(points):
        return f"points have the shape (particles, 3), not {points.shape}"
    if cells.ndim != 2 or cells.shape[1:] != (4,) or not len(cells):
        return f"cells have the shape (tetrahedra, 4), not {cells.shape}"
    if cells.min() < 0 or cells.max() >= len(points):
        return f"a corner is none of the {len(points)} points"
    light = np.flatnonzero(_volumes(points, cells.astype(np.int64)) == 0)
    if len(light):
        return f"points are in no tetrahedron with a volume: {some_of(light)}"
    return ""


def _volumes(points: FloatArray, cells: IntArray) -> FloatArray:
    """Return each point's share of the volume ``(N,)``."""
    sides = points[cells[:, 1:]] - points[cells[:, :1]]
    volumes = np.abs(np.linalg.det(sides))
    size = np.ptp(points, axis=0).max()
    volumes[volumes <= 1e-12 * size**3] = 0.0
    corners = np.full(len(cells), 4)
    return share_out(volumes, corners, cells.ravel(), len(points))


def _skin(body: Body) -> Faces:
    triangles = body.triangles
    counts = np.full(len(triangles), 3)
    return Faces(counts, triangles.ravel(), body.springs, closed=True)
