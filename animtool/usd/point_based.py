"""PointBased prims over time: meshes, curves and points, their samples and bounds.

What is simulated is a record of its prim's values at each frame, and is always sampled.
What joints deform is blocks of frames of one shape, and is sampled where it changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Vt

from animtool._types import Float32Array, FloatArray, IntArray
from animtool.frames import CurvesFrame, Frame, MeshFrame, PointsFrame
from animtool.maths.faces import triangulated, vertex_normals
from animtool.usd.finite import Labels, check_value, largest, narrowed, rounded
from animtool.usd.layers import Samples, attribute, prim

_TYPES = Sdf.ValueTypeNames
FrameT = TypeVar("FrameT", CurvesFrame, MeshFrame, PointsFrame)


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


class FrameForm(Generic[FrameT]):
    """How a type of frame is written: its prim, attributes and values."""

    type_name: ClassVar[str]
    sampled: ClassVar[tuple[str, ...]]  # attributes that every frame has, in order

    def shape(self, frame: FrameT) -> Mapping[str, IntArray]:  # noqa: ARG002
        """Return attributes of whole numbers that say how points are joined."""
        return {}

    def tears(self, frame: FrameT) -> bool:  # noqa: ARG002
        """Return whether the shape may be another at another frame."""
        return False

    def describe(self, spec: Any, frame: FrameT, unit: float) -> None:
        """Write what else the prim is, which no frame changes."""

    def values(
        self, writer: FrameWriter, frame: FrameT, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return what a frame has beside points ``(N, 3)`` and velocities."""
        raise NotImplementedError


class _Curves(FrameForm[CurvesFrame]):
    type_name = "BasisCurves"
    sampled = ("points", "velocities", "extent")

    def shape(self, frame: CurvesFrame) -> Mapping[str, IntArray]:
        """Return how many points each curve has."""
        return {"curveVertexCounts": frame.counts.astype(np.int32)}

    def tears(self, frame: CurvesFrame) -> bool:
        """Return whether a curve may become two."""
        return frame.tears

    def describe(self, spec: Any, frame: CurvesFrame, unit: float) -> None:
        """Write kind and width of the curves."""
        author_linear(spec)
        author_width(spec, frame.width / unit)

    def values(
        self,
        writer: FrameWriter,
        frame: CurvesFrame,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds of what is drawn."""
        return {"extent": bounds(points, frame.width / writer.unit / 2)}


class _Mesh(FrameForm[MeshFrame]):
    type_name = "Mesh"
    sampled = ("points", "velocities", "extent", "normals")

    def shape(self, frame: MeshFrame) -> Mapping[str, IntArray]:
        """Return the faces."""
        return {
            "faceVertexCounts": frame.counts.astype(np.int32),
            "faceVertexIndices": frame.indices.astype(np.int32),
        }

    def describe(self, spec: Any, frame: MeshFrame, unit: float) -> None:  # noqa: ARG002
        """Write that it is no cage, and whether both sides are visible."""
        attribute(spec, "subdivisionScheme", _TYPES.Token, "none", uniform=True)
        if not frame.closed:
            attribute(spec, "doubleSided", _TYPES.Bool, True, uniform=True)

    def values(
        self,
        writer: FrameWriter,
        frame: MeshFrame,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds and normals; the faces are those of the first frame."""
        normals = vertex_normals(frame.points, writer.triangles)
        return {"extent": bounds(points, 0.0), "normals": normals.astype(np.float32)}


class _Points(FrameForm[PointsFrame]):
    type_name = "Points"
    sampled = ("points", "velocities", "ids", "widths")

    def values(
        self, writer: FrameWriter, frame: PointsFrame, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return ids, widths and bounds of the balls."""
        widths = writer.narrowed("widths", 2 * frame.radii / writer.unit, code)
        extent = bounds(points, widths[:, None] / 2)
        return {"ids": frame.ids, "widths": widths, "extent": extent}


FORMS: dict[type[Frame], FrameForm[Any]] = {
    CurvesFrame: _Curves(),
    MeshFrame: _Mesh(),
    PointsFrame: _Points(),
}


def _primvar_kind(name: str, values: npt.NDArray[Any]) -> _Kind:
    """Return how a named array of points ``(N,)`` or ``(N, 3)`` is written."""
    if np.issubdtype(values.dtype, np.integer):
        return _Kind(_TYPES.IntArray, Vt.IntArray.FromNumpy, "vertex")
    if values.ndim == 1:
        return _Kind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex")
    color = name == "displayColor"
    kind = _TYPES.Color3fArray if color else _TYPES.Float3Array
    return _Kind(kind, Vt.Vec3fArray.FromNumpy, "vertex")


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


class FrameWriter:
    """Writes the frames of one prim: its attributes once, then all of every frame."""

    def __init__(self, path: str, meters_per_unit: float) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit  # of the layer [m]
        self._first: Any = None
        self._kinds: dict[str, _Kind] = {}  # of what every frame has, in order
        self._letters: dict[str, str] = {}  # of what has a default

    @cached_property
    def triangles(self) -> IntArray:
        """Faces of the first frame as triangles ``(T, 3)``."""
        return triangulated(self._first.counts, self._first.indices)

    def begin(self, layer: Any, frame: Frame) -> None:
        """Write the prim of a first frame: attributes, and what no frame changes."""
        self._first, form = frame, FORMS[type(frame)]
        self._kinds = {name: ATTRIBUTES[name] for name in form.sampled}
        for name, values in frame.primvars.items():
            self._kinds[f"primvars:{name}"] = _primvar_kind(name, values)
        self._kinds["extent"] = ATTRIBUTES["extent"]
        spec = prim(layer, self.report.path, form.type_name)
        for name, kind in self._kinds.items():
            attribute(spec, name, kind.type_name, interpolation=kind.interpolation)
        self.report.sampled = list(self._kinds)
        tears = form.tears(frame)
        for name, values in form.shape(frame).items():
            kind = ATTRIBUTES[name]
            value = None if tears else kind.make(values)
            attribute(spec, name, kind.type_name, value)
            self.report.sampled += [name] if tears else []
        form.describe(spec, frame, self.unit)

    def values(self, code: float, frame: Frame) -> tuple[dict[str, Any], int]:
        """Return attributes of a frame, counted in the report, and their bytes."""
        report, form = self.report, FORMS[type(frame)]
        points, error, vertex = self._rounded("points", frame.points, code)
        values = {"points": points, **form.values(self, frame, points, code)}
        for name, array in frame.primvars.items():
            values[f"primvars:{name}"] = (
                array.astype(np.int32)
                if np.issubdtype(array.dtype, np.integer)
                else self.narrowed(f"primvars:{name}", array, code)
            )
        values["velocities"] = self._rounded("velocities", frame.velocities, code)[0]
        size = sum(array.nbytes for array in values.values())
        held = {name: kind.make(values[name]) for name, kind in self._kinds.items()}
        for name, array in form.shape(frame).items() if form.tears(frame) else ():
            held[name] = ATTRIBUTES[name].make(array)
            size += array.nbytes
        report.vertices = max(report.vertices, len(points))
        report.samples += 1
        report.bytes += size
        report.moved(error, code, vertex)
        return held, size

    def write(self, layer: Any, code: float, values: Mapping[str, Any]) -> None:
        """Write attributes of a frame to a layer that has the prim."""
        for name, value in values.items():
            self.put(layer, code, name, value)

    def put(self, layer: Any, code: float, name: str, value: Any) -> None:
        """Write the value of an attribute at a time code; the first is its default."""
        path = f"{self.report.path}.{name}"
        if name not in self._letters:
            spec = layer.GetAttributeAtPath(path)
            self._letters[name] = largest(spec.typeName)
            spec.default = value
        if letter := self._letters[name]:
            check_value(value, letter, self._labels(name), code)
        layer.SetTimeSample(path, code, value)

    def narrowed(
        self, name: str, values: npt.NDArray[Any], code: float
    ) -> Float32Array:
        """Return values ``(N,)`` or ``(N, 3)`` of an attribute in float32."""
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

    def put(self, writers: Sequence[BlockWriter], frames: slice) -> None:
        """Write some of the frames; the error stays that of all."""
        some = replace(
            self,
            codes=self.codes[frames],
            points=self.points[frames],
            extents=self.extents[frames],
            normals=None if self.normals is None else self.normals[frames],
            velocities=None if self.velocities is None else self.velocities[frames],
        )
        with Sdf.ChangeBlock():
            writers[self.mesh].add(some)


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
