"""Build the particles and springs of scene entries, with named regions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, listed, warning
from animtool.core.record import dataclass
from animtool.documents.check import FileModel
from animtool.documents.document import location_text
from animtool.maths.faces import directed_edges, edge_counts
from animtool.systems.springs import (
    Body,
    Family,
    block,
    join,
    rope,
    sheet,
    strand,
    surface,
    tetrahedra,
)
from animtool.systems.springs.checks import excerpt_numbers
from animtool.systems.springs.drawing import CurveShape, FaceShape, Shape
from animtool.systems.springs.spec import (
    ClothModel,
    RopeModel,
    SpringsModel,
    StrandsModel,
    VolumeModel,
)

# Largest number of particles of a system, limited by memory.
MAX_PARTICLES = 10_000_000
# Smallest allowed mass of a system, or of a particle that sets its own [kg].
MIN_MASS = 1e-30


@dataclass(frozen=True, slots=True)
class SpringBody:
    """Particles and springs of a scene entry, with named regions."""

    body: Body  # particles and springs, at rest in their positions
    regions: Mapping[str, IntArray]  # particle indices by region name
    shape: Shape  # curves or faces to draw
    notices: tuple[Fault, ...] = ()  # warnings about the geometry


@dataclass(slots=True)
class BodyEntry:
    """Builds the body of an entry and collects its faults.

    Faulty values with a safe default are replaced by it, so that other keys are still
    checked. Any other fault prevents the body from being built.
    """

    spec: Any  # keys of the entry
    entry_data: Mapping[str, Any]  # arrays and meshes read for its keys
    # Spring families by name; None for omitted ones.
    families: Mapping[str, Family | None] = field(default_factory=dict)
    mass: float = 1.0  # [kg]
    faults: list[Fault] = field(default_factory=list)
    can_build: bool = True  # whether the body can be built

    def add_fault(
        self, fault: Fault, *keys: str | int, is_recoverable: bool = False
    ) -> None:
        """Add a fault at a key of the entry, extended by the location in the fault."""
        subkeys = (fault.where,) if fault.where else ()
        self.faults.append(replace(fault, where=location_text((*keys, *subkeys))))
        self.can_build &= is_recoverable

    def report_fault(
        self, code: str, message: str, *keys: str | int, hint: str | None = None
    ) -> None:
        """Report a fault at a key of the entry."""
        self.add_fault(Fault(code, message, hint=hint), *keys)

    def checked_mass(self, key: str, mass: float) -> float:
        """Return a mass [kg]; report a fault and return 1 if it is not positive."""
        if mass >= MIN_MASS:
            return mass
        allowed_range = "above 0" if mass <= 0 else f"{MIN_MASS:g} kg or more"
        message = f"its mass must be {allowed_range}, not {mass:g} kg"
        self.add_fault(Fault("SIM040", message), key, is_recoverable=True)
        return 1.0


def _rope(entry: BodyEntry, model: RopeModel) -> SpringBody | None:
    """Build a rope; return None if the keys have faults."""
    if not 2 <= model.count <= MAX_PARTICLES:
        message = f"a rope has 2 to {MAX_PARTICLES} particles, not {model.count}"
        entry.report_fault("SIM050", message, "count")
    if model.start == model.end:
        message = "it starts and ends at the same position"
        hint = "move one end: the rope is as long as their distance"
        entry.report_fault("SIM050", message, "to", hint=hint)
    tip = model.tip_mass
    if tip is not None:
        tip = entry.checked_mass("tip_mass", tip)
    if not entry.can_build:
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
    regions = {"start": np.array([0]), "end": np.array([count - 1])}
    shape = CurveShape(np.array([count]), 2 * model.radius, body.springs)
    return SpringBody(body, regions, shape)


def _strands(entry: BodyEntry, model: StrandsModel) -> SpringBody | None:
    """Build strands; return None if the keys have faults."""
    points = entry.entry_data["points"]
    if points is not None and not (
        points.ndim == 3
        and len(points)
        and points.shape[1] >= 2
        and points.shape[2] == 3
    ):
        message = "strands have the shape (1 or more, 2 or more, 3), not "
        entry.report_fault("SIM050", f"{message}{points.shape}", "points")
    if points is None or not entry.can_build:
        return None
    count, length = points.shape[:2]
    structural, bend = entry.families["structural"], entry.families["bend"]
    mass = entry.mass / (count * length)
    body = join([strand(row, structural, mass=mass, bend=bend) for row in points])
    particle_indices = np.arange(count * length).reshape(count, length)
    regions = {"roots": particle_indices[:, 0], "tips": particle_indices[:, -1]}
    shape = CurveShape(np.full(count, length), 2 * model.radius, body.springs)
    return SpringBody(body, regions, shape)


def _cloth(entry: BodyEntry, model: ClothModel) -> SpringBody | None:
    """Build a sheet or mesh of cloth; return None if the keys have faults."""
    if model.mesh is not None:
        keys = {"corner", "across", "up", "resolution"}
        reason = "applies to a sheet, but this is a mesh"
        _report_unused_keys(entry, model, keys, reason)
        return _mesh_cloth(entry, model.mesh.prim)
    columns, rows = model.resolution
    _check_grid(entry, "cloth", model.resolution)
    _check_area(entry, model)
    if not entry.can_build:
        return None
    families: dict[str, Any] = dict(entry.families)
    diagonals = model.springs.diagonals
    if diagonals is not None and diagonals.ways == "one":
        families["diagonal"] = families.pop("diagonals")
    body = sheet(
        columns,
        rows,
        mass=entry.mass / (columns * rows),
        corner=model.corner,
        across=model.across,
        up=model.up,
        **families,
    )
    grid = np.arange(rows * columns).reshape(rows, columns)
    corners = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    quads = np.stack(corners, axis=-1)
    counts = np.full((rows - 1) * (columns - 1), 4)
    regions = {
        "bottom_left": grid[0, :1],
        "bottom_right": grid[0, -1:],
        "top_left": grid[-1, :1],
        "top_right": grid[-1, -1:],
        **_grid_sides(grid, ("bottom", "top"), ("left", "right")),
    }
    return SpringBody(body, regions, FaceShape(counts, quads.reshape(-1), body.springs))


def _mesh_cloth(entry: BodyEntry, prim: str) -> SpringBody | None:
    """Build cloth from a polygon mesh; return None if the mesh has faults."""
    mesh = entry.entry_data["mesh"]
    if mesh is None:
        return None
    faces: tuple[IntArray, IntArray] = mesh.counts, mesh.indices
    fractions, flat_faces = _area_fractions(mesh.points, *faces)
    massless_points = np.flatnonzero(fractions == 0)
    if len(massless_points):
        points = excerpt_numbers(massless_points)
        message = f"points of {prim} are in no face with an area: {points}"
        entry.report_fault("SIM051", message, "mesh", "prim")
    if not entry.can_build:
        return None
    families: Mapping[str, Any] = entry.families
    body = surface(mesh.points, *faces, mass=entry.mass * fractions, **families)
    edge_table = edge_counts(*faces)
    border_points = np.unique(edge_table[0][edge_table[1] == 1])
    notices = _mesh_warnings(prim, mesh.points, flat_faces, edge_table)
    shape = FaceShape(*faces, body.springs)
    return SpringBody(body, {"border": border_points}, shape, notices)


def _area_fractions(
    points: FloatArray, counts: IntArray, indices: IntArray
) -> tuple[FloatArray, IntArray]:
    """Return each point's fraction of the total area ``(N,)``, and zero-area faces."""
    starts = np.cumsum(counts) - counts
    centres = np.add.reduceat(points[indices], starts) / counts[:, None]
    next_corners = directed_edges(counts, indices)[:, 1]
    face_of_corner = np.repeat(np.arange(len(counts)), counts)
    cross_products = np.cross(
        points[indices] - centres[face_of_corner],
        points[next_corners] - centres[face_of_corner],
    )
    areas = np.linalg.norm(np.add.reduceat(cross_products, starts), axis=1) / 2
    max_size = np.ptp(points, axis=0).max()
    areas[areas <= 1e-12 * max_size * max_size] = 0.0
    fractions = _corner_fractions(areas, counts, indices, len(points))
    return fractions, np.flatnonzero(areas == 0)


def _mesh_warnings(
    prim: str,
    points: FloatArray,
    flat_faces: IntArray,
    edge_table: tuple[IntArray, IntArray],
) -> tuple[Fault, ...]:
    """Return warnings about degenerate faces, duplicate points and shared edges."""
    _, unique_indices, counts = np.unique(
        points, axis=0, return_inverse=True, return_counts=True
    )
    duplicate_points = np.flatnonzero(counts[unique_indices.reshape(-1)] > 1)
    hints = {}
    if len(flat_faces):
        text = f"faces without an area: {excerpt_numbers(flat_faces)}"
        hints[text] = "the air does not act on them"
    if len(duplicate_points):
        text = "points at the same position that nothing connects: "
        text += excerpt_numbers(duplicate_points)
        hints[text] = "merge them"
    nonmanifold_edges = edge_table[0][edge_table[1] > 2]
    if len(nonmanifold_edges):
        edges, (first, second) = len(nonmanifold_edges), nonmanifold_edges[0]
        text = f"{counted(edges, 'edge')} of more than two faces, such as "
        text += f"{first} to {second}"
        hints[text] = "it bends less there"
    return tuple(
        warning("SIM153", f"{prim} has {text}", hint) for text, hint in hints.items()
    )


def _volume(entry: BodyEntry, model: VolumeModel) -> SpringBody | None:
    """Build a block or tetrahedra; return None if the keys have faults."""
    if model.tetrahedra is not None:
        reason = "applies to a block, but this has tetrahedra"
        _report_unused_keys(entry, model, {"corner", "size", "resolution"}, reason)
        return _tetrahedra(entry)
    x, y, z = model.resolution
    _check_grid(entry, "a volume", model.resolution)
    if min(model.size) <= 0:
        size = listed(model.size)
        message = f"its size must be above 0 in each direction, not {size}"
        entry.report_fault("SIM050", message, "size")
    if not entry.can_build:
        return None
    count, families = x * y * z, entry.families
    mass = entry.mass / count
    body = block((x, y, z), model.size, mass=mass, corner=model.corner, **families)
    grid = np.arange(count).reshape(z, y, x)
    names = ("back", "front"), ("bottom", "top"), ("left", "right")
    return SpringBody(body, _grid_sides(grid, *names), _skin_shape(body))


def _tetrahedra(entry: BodyEntry) -> SpringBody | None:
    """Build a volume of tetrahedra; return None if the arrays have faults."""
    points, cells = (
        entry.entry_data["tetrahedra"][name] for name in ("points", "cells")
    )
    edges = entry.families["structural"]
    if edges is None:
        message = "tetrahedra have structural springs, along their edges"
        hint = "add structural to the springs"
        entry.report_fault("SIM050", message, "springs", hint=hint)
    for name in ("face_diagonals", "body_diagonals"):
        if entry.families[name] is not None:
            message = f"{name} apply to a block, but this has tetrahedra"
            hint = f"remove {name}"
            entry.report_fault("SIM050", message, "springs", name, hint=hint)
    if points is None or cells is None or edges is None:
        return None
    message = _tetrahedra_fault(points, cells)
    if message:
        entry.report_fault("SIM051", message, "tetrahedra")
    if not entry.can_build:
        return None
    corners = cells.astype(np.int64)
    fractions = _volume_fractions(points, corners)
    body = tetrahedra(points, corners, edges, mass=entry.mass * fractions)
    return SpringBody(body, {"skin": np.unique(body.triangles)}, _skin_shape(body))


def _tetrahedra_fault(points: FloatArray, cells: FloatArray) -> str:
    """Return what is wrong with arrays of tetrahedra; empty if they are valid."""
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(points):
        return f"points have the shape (particles, 3), not {points.shape}"
    if cells.ndim != 2 or cells.shape[1:] != (4,) or not len(cells):
        return f"cells have the shape (tetrahedra, 4), not {cells.shape}"
    if cells.min() < 0 or cells.max() >= len(points):
        return f"a corner is outside the {len(points)} points"
    massless_points = np.flatnonzero(
        _volume_fractions(points, cells.astype(np.int64)) == 0
    )
    if len(massless_points):
        numbers = excerpt_numbers(massless_points)
        return f"points are in no tetrahedron with a volume: {numbers}"
    return ""


def _volume_fractions(points: FloatArray, cells: IntArray) -> FloatArray:
    """Return each point's fraction of the total volume ``(N,)``."""
    edge_vectors = points[cells[:, 1:]] - points[cells[:, :1]]
    volumes = np.abs(np.linalg.det(edge_vectors))
    max_size = np.ptp(points, axis=0).max()
    volumes[volumes <= 1e-12 * max_size**3] = 0.0
    corners = np.full(len(cells), 4)
    return _corner_fractions(volumes, corners, cells.ravel(), len(points))


def _skin_shape(body: Body) -> FaceShape:
    """Return the surface triangles of a volume, for display."""
    triangles = body.triangles
    counts = np.full(len(triangles), 3)
    return FaceShape(counts, triangles.ravel(), body.springs, closed=True)


def _corner_fractions(
    sizes: FloatArray, counts: IntArray, corners: IntArray, point_count: int
) -> FloatArray:
    """Distribute cell sizes to their corners; return fractions ``(N,)`` [1].

    Cells have sizes ``(M,)`` and corner counts ``(M,)``, cell by cell. Fractions add up
    to 1, or are all 0 if every cell has size 0.
    """
    corner_sizes = np.repeat(sizes / counts, counts)
    sizes_by_point = np.bincount(corners, corner_sizes, point_count)
    total = float(sizes_by_point.sum())
    return np.asarray(sizes_by_point / (total if total > 0 else 1.0), np.float64)


def _check_grid(entry: BodyEntry, subject: str, resolution: Sequence[int]) -> None:
    """Report a fault if a grid has too few particles along an axis, or too many."""
    if min(resolution) < 2 or math.prod(resolution) > MAX_PARTICLES:
        *first, last = resolution
        resolution_text = f"{listed(first)} and {last}"
        message = f"{subject} needs 2 to {MAX_PARTICLES} particles in each direction"
        message += f", not {resolution_text}"
        entry.report_fault("SIM050", message, "resolution")


def _check_area(entry: BodyEntry, model: ClothModel) -> None:
    """Report a fault if the sides of a sheet are zero or parallel."""
    if np.cross(model.across, model.up).any():
        return
    # Of two parallel sides, up is the one to change.
    key, other = ("up", model.across) if any(model.across) else ("across", model.up)
    cause, change = f"{key} is zero", "give it a length"
    if any(model.across) and any(model.up):
        cause = "across and up are parallel"
        change = "point up in another direction"
    axes = ([1, 0, 0], [0, 1, 0]) if key == "across" else ([0, 1, 0], [0, 0, 1])
    axis = next(axis for axis in axes if not any(other) or np.cross(axis, other).any())
    hint = f"{change}, such as along {axis}"
    key = key if key in model.model_fields_set else "across"
    entry.report_fault("SIM050", f"it has no area: {cause}", key, hint=hint)


def _grid_sides(grid: IntArray, *names: tuple[str, str]) -> dict[str, IntArray]:
    """Return the particles at both ends of each grid axis by region name."""
    return {
        name: np.take(grid, end, axis).ravel()
        for axis, end_names in enumerate(names)
        for name, end in zip(end_names, (0, -1), strict=True)
    }


def _report_unused_keys(
    entry: BodyEntry, model: FileModel, keys: set[str], reason: str
) -> None:
    """Report a fault for each specified key that does not apply."""
    for key in sorted(keys & model.model_fields_set):
        hint = f"remove {key}"
        entry.report_fault("SIM050", f"{key} {reason}", key, hint=hint)


BODY_BUILDERS: dict[type[SpringsModel], Callable[..., SpringBody | None]] = {
    ClothModel: _cloth,
    RopeModel: _rope,
    StrandsModel: _strands,
    VolumeModel: _volume,
}
