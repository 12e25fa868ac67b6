"""Bodies of entries: lines, cloth and volumes."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, Severity, counted, listed
from animtool.maths.faces import edge_counts, sides
from animtool.systems.springs import (
    Body,
    block,
    join,
    rope,
    sheet,
    strand,
    surface,
    tetrahedra,
)
from animtool.systems.springs.bodies import (
    MOST,
    BodyEntry,
    SpringBody,
    check_grid,
    refuse_keys,
    share_out,
    some_of,
)
from animtool.systems.springs.drawing import Curves, Faces
from animtool.systems.springs.spec import (
    ClothModel,
    RopeModel,
    StrandsModel,
    VolumeModel,
)


def rope_body(entry: BodyEntry, model: RopeModel) -> SpringBody | None:
    """Return a rope; None where what is noted leaves none."""
    if not 2 <= model.count <= MOST:
        message = f"a rope has 2 to {MOST} particles, not {model.count}"
        entry.note("SIM050", message, "count")
    if model.start == model.end:
        message = "it begins and ends at one place"
        entry.note("SIM050", message, "to")
    tip = model.tip_mass
    if tip is not None:
        tip = entry.mass_of("tip_mass", tip)
    if not entry.sound:
        return None
    count = model.count
    body = rope(
        model.start,
        model.end,
        count,
        entry.families["structural"],
        mass=entry.mass / count,
        tip_mass=tip,
        bend=entry.families["bend"],
    )
    places = {"start": np.array([0]), "end": np.array([count - 1])}
    shape = Curves(np.array([count]), 2 * model.radius, body.springs)
    return SpringBody(body, places, shape)


def strands_body(entry: BodyEntry, model: StrandsModel) -> SpringBody | None:
    """Return strands; None where what is noted leaves none."""
    points = entry.parts["points"]
    if points is not None and not _are_strands(points):
        message = f"strands have the shape (strands, 2 or more, 3), not {points.shape}"
        entry.note("SIM050", message, "points")
    if points is None or not entry.sound:
        return None
    many, length = points.shape[:2]
    each = entry.mass / (many * length)
    along, bend = entry.families["structural"], entry.families["bend"]
    body = join([strand(row, along, mass=each, bend=bend) for row in points])
    numbers = np.arange(many * length).reshape(many, length)
    places = {"roots": numbers[:, 0], "tips": numbers[:, -1]}
    shape = Curves(np.full(many, length), 2 * model.radius, body.springs)
    return SpringBody(body, places, shape)


def _are_strands(points: FloatArray) -> bool:
    return points.ndim == 3 and points.shape[1] >= 2 and points.shape[2] == 3


def cloth_body(entry: BodyEntry, model: ClothModel) -> SpringBody | None:
    """Return cloth; None where what is noted leaves none."""
    if model.mesh is not None:
        why = "is for a sheet, and this is of a mesh"
        refuse_keys(entry, model, {"corner", "across", "up", "resolution"}, why)
        return _mesh_cloth(entry, model)
    columns, rows = model.resolution
    check_grid(entry, "cloth", model.resolution)
    if not np.cross(model.across, model.up).any():
        message = "it has no area: across and up are nothing, or along each other"
        entry.note("SIM050", message, "across")
    if not entry.sound:
        return None
    both = model.springs.diagonals is None or model.springs.diagonals.ways == "both"
    crossing = entry.families["diagonals"]
    body = sheet(
        columns,
        rows,
        mass=entry.mass / (columns * rows),
        structural=entry.families["structural"],
        diagonal=None if both else crossing,
        diagonals=crossing if both else None,
        bend=entry.families["bend"],
        corner=model.corner,
        across=model.across,
        up=model.up,
    )
    grid = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack(
        [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-1
    )
    counts = np.full((rows - 1) * (columns - 1), 4)
    shape = Faces(counts, quads.reshape(-1), body.springs)
    return SpringBody(body, _sheet_places(grid), shape)


def _sheet_places(grid: IntArray) -> dict[str, IntArray]:
    return {
        "bottom_left": grid[0, :1],
        "bottom_right": grid[0, -1:],
        "top_left": grid[-1, :1],
        "top_right": grid[-1, -1:],
        "bottom": grid[0],
        "top": grid[-1],
        "left": grid[:, 0],
        "right": grid[:, -1],
    }


def _mesh_cloth(entry: BodyEntry, model: ClothModel) -> SpringBody | None:
    mesh = entry.parts["mesh"]
    if mesh is None:
        return None
    assert model.mesh is not None
    share, flat = _shares(mesh.points, mesh.counts, mesh.indices)
    light = np.flatnonzero(share == 0)
    if len(light):
        message = f"points of {model.mesh.prim} are in no face with an area: "
        message += some_of(light)
        entry.note("SIM051", message, "mesh", "prim")
    if not entry.sound:
        return None
    body = surface(
        mesh.points,
        mesh.counts,
        mesh.indices,
        mass=entry.mass * share,
        **entry.families,
    )
    often = edge_counts(mesh.counts, mesh.indices)
    border = np.unique(often[0][often[1] == 1])
    shape = Faces(mesh.counts, mesh.indices, body.springs)
    notices = _odd_mesh(model.mesh.prim, mesh.points, flat, often)
    return SpringBody(body, {"border": border}, shape, notices)


def _shares(
    points: FloatArray, counts: IntArray, indices: IntArray
) -> tuple[FloatArray, IntArray]:
    """Return each point's share of the area ``(N,)``, and faces that have none."""
    starts = np.cumsum(counts) - counts
    middle = np.add.reduceat(points[indices], starts) / counts[:, None]
    ahead = sides(counts, indices)[:, 1]
    face = np.repeat(np.arange(len(counts)), counts)
    spans = np.cross(points[indices] - middle[face], points[ahead] - middle[face])
    areas = np.linalg.norm(np.add.reduceat(spans, starts), axis=1) / 2
    size = np.ptp(points, axis=0).max()
    areas[areas <= 1e-12 * size * size] = 0.0
    return share_out(areas, counts, indices, len(points)), np.flatnonzero(areas == 0)


def _odd_mesh(
    prim: str, points: FloatArray, flat: IntArray, shared: tuple[IntArray, IntArray]
) -> tuple[Fault, ...]:
    """Return warnings of what cloth bears, and nobody means."""
    _, same, often = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    double = np.flatnonzero(often[same.reshape(-1)] > 1)
    remarks = []
    if len(flat):
        remarks.append(
            (f"faces without an area: {some_of(flat)}", "the air passes them")
        )
    if len(double):
        text = f"points at one place, which nothing holds together: {some_of(double)}"
        remarks.append((text, "merge them"))
    many = shared[0][shared[1] > 2]
    if len(many):
        text = f"{counted(len(many), 'side')} of more than two faces, such as "
        remarks.append((text + f"{many[0, 0]} to {many[0, 1]}", "it bends less there"))
    return tuple(
        Fault("SIM153", f"{prim} has {text}", hint=hint, severity=Severity.WARNING)
        for text, hint in remarks
    )


def volume_body(entry: BodyEntry, model: VolumeModel) -> SpringBody | None:
    """Return a volume; None where what is noted leaves none."""
    if model.tetrahedra is not None:
        why = "is for a block, and this is of tetrahedra"
        refuse_keys(entry, model, {"corner", "size", "resolution"}, why)
        return _tetrahedra(entry)
    x, y, z = model.resolution
    check_grid(entry, "a volume", model.resolution)
    if min(model.size) <= 0:
        message = f"its size must be above 0 each way, not {listed(model.size)}"
        entry.note("SIM050", message, "size")
    if not entry.sound:
        return None
    body = block(
        (x, y, z),
        model.size,
        mass=entry.mass / (x * y * z),
        corner=model.corner,
        **entry.families,
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


def _tetrahedra(entry: BodyEntry) -> SpringBody | None:
    points, cells = (entry.parts["tetrahedra"][name] for name in ("points", "cells"))
    edges = entry.families["structural"]
    if edges is None:
        message = "tetrahedra have structural springs, along their edges"
        entry.note("SIM050", message, "springs")
    for name in ("face_diagonals", "body_diagonals"):
        if entry.families[name] is not None:
            message = f"{name} are for a block, and this is of tetrahedra"
            entry.note("SIM050", message, "springs", name)
    if points is None or cells is None or edges is None:
        return None
    message = _tetrahedra_fault(points, cells)
    if message:
        entry.note("SIM051", message, "tetrahedra")
    if not entry.sound:
        return None
    corners = cells.astype(np.int64)
    share = _volumes(points, corners)
    body = tetrahedra(points, corners, edges, mass=entry.mass * share)
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
