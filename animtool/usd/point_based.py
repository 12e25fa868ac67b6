"""PointBased prims over time: meshes, curves and points, their samples and bounds.

What is simulated is a row of its prim's values at each frame, and is always sampled.
What joints deform is blocks of frames of one shape, and is sampled where it changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Vt

from animtool._types import Float32Array, FloatArray, IntArray
from animtool.maths.faces import triangulated, vertex_normals
from animtool.usd.finite import Labels, check_value, largest, narrowed, rounded
from animtool.usd.layers import attribute, prim
from animtool.usd.samples import Samples

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class _Kind:
    """Type of an attribute, how an array becomes its value, and its interpolation."""

    type_name: Any
    make: Callable[[Any], Any]
    interpolation: str = ""


_INTEGERS = _Kind(_TYPES.IntArray, Vt.IntArray.FromNumpy)
ATTRIBUTES = {
    "points": _Kind(_TYPES.Point3fArray, Vt.Vec3fArray.FromNumpy),
    "velocities": _Kind(_TYPES.Vector3fArray, Vt.Vec3fArray.FromNumpy),
    "extent": _Kind(_TYPES.Float3Array, Vt.Vec3fArray.FromNumpy),
    "normals": _Kind(_TYPES.Normal3fArray, Vt.Vec3fArray.FromNumpy, "vertex"),
    "ids": _Kind(_TYPES.Int64Array, Vt.Int64Array.FromNumpy),
    "widths": _Kind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex"),
    "primvars:age": _Kind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex"),
    "curveVertexCounts": _INTEGERS,
    "faceVertexCounts": _INTEGERS,
    "faceVertexIndices": _INTEGERS,
}


@dataclass(slots=True)
class CachedMesh:
    """What was written of a PointBased prim."""

    path: str
    vertices: int = 0  # of its points, the most at any frame
    samples: int = 0  # time samples of its points; 0 where it never moves
    bytes: int = 0  # size of its samples in memory
    sampled: list[str] = field(default_factory=list)  # attributes that change
    error: float = 0.0  # largest distance that rounding moved a point [m]
    error_code: float = 0.0  # time code of that
    error_vertex: int = 0  # the point that moved

    def moved(self, error: float, code: float, vertex: int) -> None:
        """Keep the larger error [m], its time code and point."""
        if error > self.error:
            self.error, self.error_code, self.error_vertex = error, code, vertex


def author_linear(spec: Any) -> None:
    """State that curves are polylines with two ends."""
    attribute(spec, "type", _TYPES.Token, "linear", uniform=True)
    attribute(spec, "wrap", _TYPES.Token, "nonperiodic", uniform=True)


def author_width(spec: Any, width: float) -> None:
    """State one width of all curves, in the layer's unit."""
    widths = Vt.FloatArray([width])
    attribute(spec, "widths", _TYPES.FloatArray, widths, interpolation="constant")


class Row(ABC):
    """One prim at one frame: points ``(N, 3)`` [m], velocities ``(N, 3)`` [m/s]."""

    type_name: ClassVar[str]
    sampled: ClassVar[tuple[str, ...]]  # attributes that every frame has, in order
    tears: bool = False  # whether the shape may be another at another frame
    points: FloatArray
    velocities: FloatArray

    def shape(self) -> Mapping[str, IntArray]:
        """Return attributes of whole numbers that say how points are joined."""
        return {}

    def describe(self, spec: Any, unit: float) -> None:  # noqa: B027
        """Write what else the prim is, which no frame changes."""

    @abstractmethod
    def values(
        self, writer: RowWriter, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return what a frame has beside points ``(N, 3)`` and velocities."""


@dataclass(frozen=True, slots=True)
class CurvesRow(Row):
    """Linear curves of one width at one frame."""

    points: FloatArray  # one curve after the other (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # points of each curve (C,)
    width: float  # [m]
    tears: bool = False  # whether a curve may become two
    type_name: ClassVar[str] = "BasisCurves"
    sampled: ClassVar[tuple[str, ...]] = ("points", "velocities", "extent")

    def shape(self) -> Mapping[str, IntArray]:
        """Return how many points each curve has."""
        return {"curveVertexCounts": self.counts.astype(np.int32)}

    def describe(self, spec: Any, unit: float) -> None:
        """Write kind and width of the curves."""
        author_linear(spec)
        author_width(spec, self.width / unit)

    def values(
        self,
        writer: RowWriter,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds of what is drawn."""
        return {"extent": bounds(points, self.width / writer.unit / 2)}


@dataclass(frozen=True, slots=True)
class FacesRow(Row):
    """A polygon mesh at one frame, with a normal at each vertex."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # corners of each face (M,)
    indices: IntArray  # corners, face by face
    closed: bool = False  # whether only its outside is to be seen
    type_name: ClassVar[str] = "Mesh"
    sampled: ClassVar[tuple[str, ...]] = ("points", "velocities", "extent", "normals")

    def shape(self) -> Mapping[str, IntArray]:
        """Return the faces."""
        return {
            "faceVertexCounts": self.counts.astype(np.int32),
            "faceVertexIndices": self.indices.astype(np.int32),
        }

    def describe(self, spec: Any, unit: float) -> None:  # noqa: ARG002
        """Write that it is no cage, and whether both sides are to be seen."""
        attribute(spec, "subdivisionScheme", _TYPES.Token, "none", uniform=True)
        if not self.closed:
            attribute(spec, "doubleSided", _TYPES.Bool, True, uniform=True)

    def values(
        self,
        writer: RowWriter,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds and normals; the faces are those of the first frame."""
        normals = vertex_normals(self.points, writer.triangles)
        return {"extent": bounds(points, 0.0), "normals": normals.astype(np.float32)}


@dataclass(frozen=True, slots=True)
class PointsRow(Row):
    """Points that come and go, at one frame."""

    ids: IntArray  # (N,)
    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    radii: FloatArray  # (N,) [m]
    ages: FloatArray  # (N,) [s]
    type_name: ClassVar[str] = "Points"
    sampled: ClassVar[tuple[str, ...]] = (
        *("points", "velocities", "ids", "widths", "primvars:age", "extent"),
    )

    def values(
        self, writer: RowWriter, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return ids, widths, ages and bounds of the balls."""
        widths = writer.narrowed("widths", 2 * self.radii / writer.unit, code)
        ages = writer.narrowed("primvars:age", self.ages, code)
        extent = bounds(points, widths[:, None] / 2)
        return {
            "ids": self.ids,
            "widths": widths,
            "primvars:age": ages,
            "extent": extent,
        }


def bounds(
    points: Float32Array, margin: float | FloatArray | Float32Array
) -> Float32Array:
    """Return bounds ``(2, 3)`` of points and what is about them; zeros of none."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    if isinstance(margin, float):
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    else:
        low, high = (points - margin).min(axis=0), (points + margin).max(axis=0)
    return np.stack([low, high]).astype(np.float32)


class RowWriter:
    """Writes the rows of one prim: its attributes once, then all of every frame."""

    def __init__(self, path: str, meters_per_unit: float) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit  # of the layer [m]
        self._first: Any = None
        self._last: dict[str, Any] = {}
        self._letters: dict[str, str] = {}

    @cached_property
    def triangles(self) -> IntArray:
        """Faces of the first row as triangles ``(T, 3)``."""
        return triangulated(self._first.counts, self._first.indices)

    def begin(self, layer: Any, row: Row) -> None:
        """Write the prim of a first row: attributes, and what no frame changes."""
        self._first = row
        spec = prim(layer, self.report.path, row.type_name)
        for name in row.sampled:
            kind = ATTRIBUTES[name]
            attribute(spec, name, kind.type_name, interpolation=kind.interpolation)
        self.report.sampled = list(row.sampled)
        for name, values in row.shape().items():
            kind = ATTRIBUTES[name]
            value = None if row.tears else kind.make(values)
            attribute(spec, name, kind.type_name, value)
            self.report.sampled += [name] if row.tears else []
        row.describe(spec, self.unit)

    def add(self, layer: Any, code: float, row: Row) -> int:
        """Write a frame to a layer that has the prim; return its size [byte]."""
        report = self.report
        points, error, vertex = self._rounded("points", row.points, code)
        values = {"points": points, **row.values(self, points, code)}
        values["velocities"] = self._rounded("velocities", row.velocities, code)[0]
        for name in row.sampled:
            self.put(layer, code, name, ATTRIBUTES[name].make(values[name]))
        size = sum(array.nbytes for array in values.values())
        for name, array in row.shape().items() if row.tears else ():
            self.put(layer, code, name, ATTRIBUTES[name].make(array))
            size += array.nbytes
        report.vertices = max(report.vertices, len(points))
        report.samples += 1
        report.bytes += size
        report.moved(error, code, vertex)
        return size

    def repeat(self, layer: Any, code: float) -> None:
        """Write the last frame into another layer too, which is not counted."""
        for name, value in self._last.items():
            self.put(layer, code, name, value)

    def put(self, layer: Any, code: float, name: str, value: Any) -> None:
        """Write the value of an attribute at a time code; the first is its default.

        Raises:
            OutputError: USD holds it as no finite number (USD170).
        """
        path = f"{self.report.path}.{name}"
        if name not in self._last:
            spec = layer.GetAttributeAtPath(path)
            self._letters[name] = largest(spec.typeName)
            spec.default = value
        if letter := self._letters[name]:
            check_value(value, letter, self._labels(name), code)
        self._last[name] = value
        layer.SetTimeSample(path, code, value)

    def narrowed(self, name: str, values: FloatArray, code: float) -> Float32Array:
        """Return values ``(N,)`` of an attribute in float32."""
        labels, codes = self._labels(name), np.array([code])
        return np.asarray(narrowed(values[None], "f", labels, codes)[0], np.float32)

    def _rounded(
        self, name: str, values: FloatArray, code: float
    ) -> tuple[Float32Array, float, int]:
        """Return ``(N, 3)`` in the layer's unit, the largest error [m], its point."""
        labels, codes = self._labels(name), np.array([code])
        rows, error, _, vertex = rounded(values[None], self.unit, labels, codes)
        return rows[0], error, vertex

    def _labels(self, name: str) -> Labels:
        return Labels(f"{self.report.path}.{name}", "point")


@dataclass(frozen=True, slots=True)
class PointSpace:
    """Where the points of a mesh are written."""

    # Mesh from skeleton space, in the layer's unit (4, 4); None where they are one.
    placement: FloatArray | None = None
    margin: float = 0.0  # half the width of curves, in the layer's unit


@dataclass(frozen=True, slots=True)
class PointBlock:
    """Frames of one mesh, or of strands, as the layer will hold them, in its unit."""

    mesh: int  # place in the job
    codes: FloatArray  # time codes (F,)
    points: Float32Array  # (F, V, 3), in the mesh's own space
    extents: Float32Array  # bounds of the points, or of curves about them (F, 2, 3)
    normals: Float32Array | None  # (F, V, 3); None where they are not written
    velocities: Float32Array | None  # (F, V, 3), per second; None likewise
    error: float  # largest distance that rounding moved a point [m]
    error_code: float  # time code of that
    error_vertex: int  # the point that moved

    def values(self) -> Iterator[tuple[str, Float32Array]]:
        """Yield the attributes that frames have, and their values ``(F, …)``."""
        for name, rows in (
            ("points", self.points),
            ("extent", self.extents),
            ("normals", self.normals),
            ("velocities", self.velocities),
        ):
            if rows is not None:
                yield name, rows

    def count(self, report: CachedMesh) -> None:
        """Add these frames to a report."""
        report.vertices = self.points.shape[1]
        report.samples += len(self.codes)
        report.bytes += sum(rows.nbytes for _, rows in self.values())
        report.moved(self.error, self.error_code, self.error_vertex)

    def select(self, frames: slice) -> PointBlock:
        """Return some of the frames; the error stays that of all."""
        return replace(
            self,
            codes=self.codes[frames],
            points=self.points[frames],
            extents=self.extents[frames],
            normals=None if self.normals is None else self.normals[frames],
            velocities=None if self.velocities is None else self.velocities[frames],
        )


class BlockWriter:
    """Writes blocks of one prim: samples of what changes, a default of what does not.

    The prim is there already, with its shape and what it has at rest.
    """

    def __init__(self, spec: Any) -> None:
        self._spec = spec
        self._report = CachedMesh(str(spec.path))
        self._channels: dict[str, Samples] = {}

    def add(self, block: PointBlock) -> None:
        """Write a block of frames."""
        block.count(self._report)
        for name, rows in block.values():
            if name not in self._channels:
                self._channels[name] = empty_attribute(self._spec, name)
            self._channels[name].add(block.codes, rows)

    def release(self) -> None:
        """Sample everything, whether it changes or not."""
        for channel in self._channels.values():
            channel.release()

    def rest(self) -> None:
        """Write defaults of what has samples, but for velocities: a mesh at no time."""
        for name, channel in self._channels.items():
            if name != "velocities":
                channel.rest()

    def finish(self, *, rest: bool) -> CachedMesh:
        """Write the defaults of what never changed; return what there is now.

        With ``rest``, what has samples has a default too; a rig has its own.
        """
        report, channels = self._report, self._channels
        velocities = channels.pop("velocities", None)
        moves = bool(channels) and channels["points"].sampled
        if velocities is not None:
            if moves:
                # UsdGeomPointBased uses them beside points of the same times only.
                velocities.release()
                channels["velocities"] = velocities
            else:
                _remove(self._spec, "velocities")
        if rest:
            self.rest()
        nothing = np.zeros((0, 3), np.float32)
        for channel in channels.values():
            channel.finish(nothing)
        report.sampled = [name for name, made in channels.items() if made.sampled]
        if not moves:
            report.samples = report.bytes = 0
        return report


def empty_attribute(spec: Any, name: str) -> Samples:
    """Return an attribute without value in place of what a mesh at rest has."""
    _remove(spec, name)
    kind = ATTRIBUTES[name]
    return Samples(
        spec, name, kind.type_name, kind.make, interpolation=kind.interpolation
    )


def _remove(spec: Any, name: str) -> None:
    if name in spec.attributes:
        spec.RemoveProperty(spec.attributes[name])
