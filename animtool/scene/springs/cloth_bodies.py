"""Cloth of entries: sheets, and meshes of USD files."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.document import Location
from animtool.errors import Fault, OptionError, Severity, counted
from animtool.maths.faces import edge_counts, sides
from animtool.scene.springs.bodies import (
    Families,
    SpringBody,
    check_grid,
    refuse_keys,
    share_out,
    some_of,
)
from animtool.scene.springs.schema import ClothModel
from animtool.scene.springs.shapes import Faces
from animtool.scene.systems.entries import EntryReader
from animtool.sim.springs import sheet, surface
from animtool.units import UpAxis


def cloth_body(
    reader: EntryReader,
    at: Location,
    model: ClothModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    """Return cloth; None where what is noted leaves none."""
    if model.mesh is not None:
        why = "is for a sheet, and this is of a mesh"
        refuse_keys(reader, at, model, {"corner", "across", "up", "resolution"}, why)
        return _mesh_cloth(reader, at, model, families, mass)
    columns, rows = model.resolution
    check_grid(reader, at, "cloth", model.resolution)
    if not np.cross(model.across, model.up).any():
        message = "it has no area: across and up are nothing, or along each other"
        reader.note((*at, "across"), Fault("SIM050", message))
    if not reader.sound:
        return None
    both = model.springs.diagonals is None or model.springs.diagonals.ways == "both"
    crossing = families["diagonals"]
    body = sheet(
        columns,
        rows,
        mass=mass / (columns * rows),
        structural=families["structural"],
        diagonal=None if both else crossing,
        diagonals=crossing if both else None,
        bend=families["bend"],
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


def _mesh_cloth(
    reader: EntryReader,
    at: Location,
    model: ClothModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    from animtool.usd.still_mesh import read_still_mesh

    assert model.mesh is not None
    path = reader.input((*at, "mesh", "file"), model.mesh.file)
    if path is None:
        return None
    try:
        mesh = read_still_mesh(path, model.mesh.prim, UpAxis.Y)
    except OptionError as error:
        reader.note((*at, "mesh", "prim"), error.faults[0])
        return None
    share, flat = _shares(mesh.points, mesh.counts, mesh.indices)
    light = np.flatnonzero(share == 0)
    if len(light):
        message = f"points of {model.mesh.prim} are in no face with an area: "
        message += some_of(light)
        reader.note((*at, "mesh", "prim"), Fault("SIM051", message))
    if not reader.sound:
        return None
    body = surface(
        mesh.points,
        mesh.counts,
        mesh.indices,
        mass=mass * share,
        structural=families["structural"],
        diagonals=families["diagonals"],
        bend=families["bend"],
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
    prim: str,
    points: FloatArray,
    flat: IntArray,
    shared: tuple[IntArray, IntArray],
) -> tuple[Fault, ...]:
    """Return warnings of what cloth bears, and nobody means."""
    _, same, often = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    double = np.flatnonzero(often[same.reshape(-1)] > 1)
    said = []
    if len(flat):
        said.append((f"faces without an area: {some_of(flat)}", "the air passes them"))
    if len(double):
        text = f"points at one place, which nothing holds together: {some_of(double)}"
        said.append((text, "merge them"))
    many = shared[0][shared[1] > 2]
    if len(many):
        text = f"{counted(len(many), 'side')} of more than two faces, such as "
        said.append((text + f"{many[0, 0]} to {many[0, 1]}", "it bends less there"))
    return tuple(
        Fault("SIM153", f"{prim} has {text}", hint=hint, severity=Severity.WARNING)
        for text, hint in said
    )
