"""Points with velocities that stay the same ones, and the shapes drawn of them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from pxr import Sdf, Vt

from animtool._types import Float32Array, FloatArray, IntArray
from animtool.maths.faces import triangulated, vertex_normals
from animtool.usd.layers import attribute, prim
from animtool.usd.prim_writer import PrimWriter

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class CurvesRow:
    """Curves at one frame.

    Attributes:
        points: One curve after the other ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        counts: Points of each curve ``(C,)``.
        width: Of all [m].
        tears: Whether counts may change.
    """

    points: FloatArray
    velocities: FloatArray
    counts: IntArray
    width: float
    tears: bool = False


@dataclass(frozen=True, slots=True)
class FacesRow:
    """A surface at one frame.

    Attributes:
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
        closed: Whether only its outside is to be seen.
    """

    points: FloatArray
    velocities: FloatArray
    counts: IntArray
    indices: IntArray
    closed: bool = False


Row = TypeVar("Row", CurvesRow, FacesRow)


class _MovedWriter(PrimWriter, Generic[Row]):
    """Writes points, velocities and extent of each frame, and a shape.

    Attributes:
        type_name: Of the prim.
        moving: Types of the attributes that every frame has.
    """

    type_name: ClassVar[str]
    moving: ClassVar[dict[str, Any]] = {
        "points": _TYPES.Point3fArray,
        "velocities": _TYPES.Vector3fArray,
        "extent": _TYPES.Float3Array,
    }

    def begin(self, layer: Any, row: Row) -> None:
        """Write the prim: attributes, what never changes, and the shape."""
        spec = prim(layer, self.report.path, self.type_name)
        for name, kind in self.moving.items():
            interpolation = "vertex" if name == "normals" else ""
            attribute(spec, name, kind, interpolation=interpolation)
        self.report.sampled = list(self.moving)
        for name, values in self.shape(row).items():
            value = None if self.changes(row) else Vt.IntArray.FromNumpy(values)
            attribute(spec, name, _TYPES.IntArray, value)
            self.report.sampled += [name] if self.changes(row) else []
        self.describe(spec, row)

    def add(self, layer: Any, code: float, row: Row) -> None:
        """Write a frame; the shape too where it may change."""
        points, error, _, worst = self.rounded("points", row.points, code)
        speeds = self.rounded("velocities", row.velocities, code)[0][0]
        self.put(layer, code, "points", Vt.Vec3fArray.FromNumpy(points[0]))
        self.put(layer, code, "velocities", Vt.Vec3fArray.FromNumpy(speeds))
        extent = _extent(points[0], self.margin(row))
        self.put(layer, code, "extent", Vt.Vec3fArray.FromNumpy(extent))
        size = 24 * len(row.points) + 24 + self.add_more(layer, code, row)
        for name, values in self.shape(row).items() if self.changes(row) else ():
            self.put(layer, code, name, Vt.IntArray.FromNumpy(values))
            size += values.nbytes
        self.report.vertices = max(self.report.vertices, len(row.points))
        self.count(code, error, worst, size)

    def add_more(self, layer: Any, code: float, row: Row) -> int:  # noqa: ARG002
        """Write what else a frame has; return its size in memory [byte]."""
        return 0

    @abstractmethod
    def shape(self, row: Row) -> dict[str, Any]:
        """Return attributes of whole numbers that say how points are joined."""

    def changes(self, row: Row) -> bool:  # noqa: ARG002
        """Return whether the shape may be another at another frame."""
        return False

    @abstractmethod
    def describe(self, spec: Any, row: Row) -> None:
        """Write what else the prim is, which no frame changes."""

    @abstractmethod
    def margin(self, row: Row) -> float:
        """Return how far what is drawn goes beyond the points, in the layer's unit."""


class CurvesWriter(_MovedWriter[CurvesRow]):
    """Writes linear curves of one width."""

    type_name = "BasisCurves"

    def shape(self, row: CurvesRow) -> dict[str, Any]:
        """Return how many points each curve has."""
        return {"curveVertexCounts": row.counts.astype(np.int32)}

    def changes(self, row: CurvesRow) -> bool:
        """Return whether a curve may become two."""
        return row.tears

    def describe(self, spec: Any, row: CurvesRow) -> None:
        """Write kind and width of the curves."""
        attribute(spec, "type", _TYPES.Token, "linear", uniform=True)
        attribute(spec, "wrap", _TYPES.Token, "nonperiodic", uniform=True)
        widths = Vt.FloatArray([row.width / self.unit])
        attribute(spec, "widths", _TYPES.FloatArray, widths, interpolation="constant")

    def margin(self, row: CurvesRow) -> float:
        """Return half their width."""
        return row.width / self.unit / 2


class FacesWriter(_MovedWriter[FacesRow]):
    """Writes a polygon mesh with a normal at each vertex."""

    type_name = "Mesh"
    moving: ClassVar[dict[str, Any]] = {
        **_MovedWriter.moving,
        "normals": _TYPES.Normal3fArray,
    }

    def begin(self, layer: Any, row: FacesRow) -> None:
        """Write the prim; its faces never change."""
        super().begin(layer, row)
        self._triangles = triangulated(row.counts, row.indices)

    def add_more(self, layer: Any, code: float, row: FacesRow) -> int:
        """Write the normals."""
        normals = vertex_normals(row.points, self._triangles).astype(np.float32)
        self.put(layer, code, "normals", Vt.Vec3fArray.FromNumpy(normals))
        return normals.nbytes

    def shape(self, row: FacesRow) -> dict[str, Any]:
        """Return the faces."""
        return {
            "faceVertexCounts": row.counts.astype(np.int32),
            "faceVertexIndices": row.indices.astype(np.int32),
        }

    def describe(self, spec: Any, row: FacesRow) -> None:
        """Write that it is no cage, and whether both sides are to be seen."""
        attribute(spec, "subdivisionScheme", _TYPES.Token, "none", uniform=True)
        if not row.closed:
            attribute(spec, "doubleSided", _TYPES.Bool, True, uniform=True)

    def margin(self, row: FacesRow) -> float:  # noqa: ARG002
        """Return nothing: faces have no thickness."""
        return 0.0


def _extent(points: Float32Array, margin: float) -> Float32Array:
    """Return bounds of points and what is about them; empty ones of none."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return np.stack([low, high]).astype(np.float32)
