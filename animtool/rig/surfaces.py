"""Loads the arrays of a rig's meshes, shapes and strands on demand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError
from animtool.core.names import unused_name
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives
from animtool.maths import so3
from animtool.rig.parts import (
    ArrayRef,
    ArraySource,
    Attachment,
    Inbetween,
    Mesh,
    Shape,
    Skin,
    Subdivision,
)
from animtool.rig.skeleton import Rig


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceInbetween:
    """Deltas of a shape at a weight between 0 and 1, with the arrays in memory."""

    at: float  # weight of the shape at which the deltas apply
    deltas: FloatArray  # vertex offsets of the shape ``(N, 3)`` [m]
    # Likewise for the normals; None leaves them unchanged.
    normals: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceShape:
    """A blend shape of a surface, with its arrays in memory."""

    name: str  # name in the rig
    deltas: FloatArray  # vertex offsets added at weight 1 ``(N, 3)`` [m]
    # Indices of the affected vertices ``(N,)``; None for all of them.
    vertices: IntArray | None = None
    # Added to the normals ``(N, 3)``; None leaves them unchanged.
    normals: FloatArray | None = None
    inbetweens: tuple[SurfaceInbetween, ...] = ()  # ascending by weight


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSkin:
    """Skin binding of a surface, with its arrays in memory."""

    method: str  # ``linear`` or ``dual_quaternion``
    joints: tuple[str, ...]  # joint names that ``indices`` refer to
    indices: IntArray  # ``(V, I)`` into ``joints``
    weights: FloatArray  # ``(V, I)`` [1]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A mesh with its arrays in memory."""

    name: str  # name in the rig
    points: FloatArray  # ``(V, 3)`` [m]
    counts: IntArray  # vertices of each face ``(N,)``
    indices: IntArray  # vertex indices of all faces, concatenated
    normals: FloatArray | None  # ``(V, 3)``; None if there are none
    # World transform of the points at bind time ``(4, 4)``, for column vectors, with
    # its translation in [m].
    geom_bind: FloatArray
    skin: SurfaceSkin | None  # skin binding; None if the mesh follows no joint
    shapes: tuple[SurfaceShape, ...]  # its blend shapes
    subdivision: Subdivision  # subdivision scheme


def surfaces_of(rig: Rig) -> tuple[Surface, ...]:
    """Return the meshes of a rig with their arrays read from files (RIG018)."""
    try:
        with Archives() as archives:
            return tuple(_surface(rig, mesh, archives) for mesh in rig.meshes)
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{rig.name!r}: {error}")) from error


def rotate_unskinned(
    surfaces: Sequence[Surface], rotation: ArrayLike | None
) -> tuple[Surface, ...]:
    """Return meshes rotated, except skinned ones, which joints move."""
    if rotation is None:
        return tuple(surfaces)
    transform = np.eye(4)
    transform[:3, :3] = so3.to_matrix(rotation)
    return tuple(
        surface
        if surface.skin is not None
        else replace(surface, geom_bind=transform @ surface.geom_bind)
        for surface in surfaces
    )


def _surface(rig: Rig, mesh: Mesh, archives: Archives) -> Surface:
    """Return a mesh with its arrays in memory."""
    unit = rig.meters_per_unit
    faces = mesh.faces.load(archives).astype(np.int64)
    is_corner = faces >= 0
    bind = np.eye(4)
    if mesh.geom_bind is not None:
        bind = np.array(mesh.geom_bind).reshape(4, 4)
        bind[:3, 3] *= unit
    points = mesh.points.load(archives) * unit
    return Surface(
        mesh.name,
        points,
        is_corner.sum(axis=1),
        faces[is_corner],
        None if mesh.normals is None else mesh.normals.load(archives),
        bind,
        None if mesh.skin is None else _surface_skin(mesh.skin, archives),
        tuple(
            _surface_shape(shape, len(points), unit, archives)
            for shape in rig.shapes
            if shape.mesh == mesh.name and _has_deltas(shape)
        ),
        _subdivision_scheme(mesh),
    )


def _subdivision_scheme(mesh: Mesh) -> Subdivision:
    """Return the subdivision scheme of a mesh; see `Mesh`."""
    if mesh.subdivision is not None:
        return mesh.subdivision
    has_no_normals = mesh.normals is None
    return Subdivision.CATMULL_CLARK if has_no_normals else Subdivision.NONE


def _surface_skin(skin: Skin, archives: Archives) -> SurfaceSkin:
    """Return a skin binding with its arrays in memory."""
    indices = skin.indices.load(archives).astype(np.int64)
    return SurfaceSkin(skin.method, skin.joints, indices, skin.weights.load(archives))


def _has_deltas(shape: Shape) -> bool:
    """Return whether a shape or its inbetweens change points or normals."""
    arrays = (shape.deltas, shape.normals, *shape.inbetweens)
    return any(array is not None for array in arrays)


def _surface_shape(
    shape: Shape, point_count: int, unit: float, archives: Archives
) -> SurfaceShape:
    """Read a shape of a mesh; deltas are 0 if it only changes normals."""
    vertices = None if shape.vertices is None else shape.vertices.load(archives)
    zeros = np.zeros((point_count if vertices is None else len(vertices), 3))
    deltas = zeros if shape.deltas is None else shape.deltas.load(archives)
    return SurfaceShape(
        shape.name,
        deltas * unit,
        None if vertices is None else vertices.astype(np.int64),
        None if shape.normals is None else shape.normals.load(archives),
        tuple(
            SurfaceInbetween(
                inbetween.at,
                inbetween.deltas.load(archives) * unit,
                None if inbetween.normals is None else inbetween.normals.load(archives),
            )
            for inbetween in shape.inbetweens
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """Strands of an attachment, with their arrays in memory."""

    name: str
    joint: str  # name of the joint that carries all strands
    # World positions at bind time, each strand from root to tip ``(S, K, 3)`` [m].
    points: FloatArray


def strands_of(rig: Rig) -> tuple[Strands, ...]:
    """Return the strands of a rig with their points read from files (RIG018)."""
    strands = []
    for entry in rig.attach:
        if entry.points is None:
            continue
        try:
            points = entry.points.load() * rig.meters_per_unit
        except ValueError as error:
            raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error
        strands.append(Strands(entry.name, entry.joints[0], points))
    return tuple(strands)


StoredArrays = dict[str, npt.NDArray[np.generic]]


def with_array_file(
    rig: Rig, path: Path, *, copies_all: bool = False
) -> tuple[Rig, StoredArrays]:
    """Return the rig with references to an npz file for its arrays, and the arrays.

    With ``copies_all``, referenced arrays are stored too, for a rig file in another
    folder.
    """
    store = _ArrayStore(path, copies_all)
    meshes, shapes = [], []
    for mesh in rig.meshes:
        stored_mesh = store.with_references(mesh, mesh.name)
        skin = mesh.skin and store.with_references(mesh.skin, mesh.name)
        meshes.append(replace(stored_mesh, skin=skin))
    for shape in rig.shapes:
        stored_shape = store.with_references(shape, shape.name)
        inbetweens = tuple(
            store.with_references(inbetween, f"{shape.name}_{inbetween.at:g}")
            for inbetween in shape.inbetweens
        )
        shapes.append(replace(stored_shape, inbetweens=inbetweens))
    attach = tuple(store.with_references(entry, entry.name) for entry in rig.attach)
    stored_rig = replace(rig, meshes=tuple(meshes), shapes=tuple(shapes), attach=attach)
    return stored_rig, store.arrays


Part = TypeVar("Part", Mesh, Skin, Shape, Inbetween, Attachment)
# Suffix of the array's name in a file, by field of each part.
_ARRAY_SUFFIXES: dict[type, dict[str, str]] = {
    Mesh: {"points": "_points", "faces": "_faces", "normals": "_normals"},
    Skin: {"indices": "_joints", "weights": "_weights"},
    Shape: {"deltas": "", "normals": "_normals", "vertices": "_vertices"},
    Inbetween: {"deltas": "", "normals": "_normals"},
    Attachment: {"pins": "_pins", "points": "_points"},
}
# Fields of whole numbers.
_INTEGER_FIELDS = frozenset({"faces", "indices", "vertices", "pins"})


@dataclass(slots=True)
class _ArrayStore:
    """Collects arrays for an npz file, and replaces them by references."""

    path: Path
    copies_all: bool
    arrays: StoredArrays = field(default_factory=dict)

    def with_references(self, part: Part, name: str) -> Part:
        """Return a part of a rig whose arrays are references to files."""
        reference_by_field: dict[str, Any] = {
            key: self._store_array(
                getattr(part, key), name + suffix, is_integer=key in _INTEGER_FIELDS
            )
            for key, suffix in _ARRAY_SUFFIXES[type(part)].items()
        }
        return replace(part, **reference_by_field)

    def _store_array(
        self, source: ArraySource | None, name: str, *, is_integer: bool
    ) -> ArraySource | None:
        """Return a reference to an array; store the array if no file contains it."""
        if source is None or (isinstance(source, ArrayRef) and not self.copies_all):
            return source
        try:
            values = source.load()
        except ValueError as error:
            raise FormatError(Fault("RIG018", str(error))) from error
        key = unused_name(re.sub(r"\W", "_", name), self.arrays)
        self.arrays[key] = _to_32_bits(values, is_integer=is_integer)
        return ArrayRef(f"{self.path.name}#{key}", self.path, key)


def _to_32_bits(values: FloatArray, *, is_integer: bool) -> npt.NDArray[np.generic]:
    """Convert values to a 32-bit type if that is lossless."""
    narrow_type = np.int32 if is_integer else np.float32
    with np.errstate(over="ignore", invalid="ignore"):
        narrowed_values = values.astype(narrow_type)
    return narrowed_values if (narrowed_values == values).all() else values
