"""Writes PointBased prims: their attributes, and blocks of frames.

Both deformed and simulated points are blocks of named values; one table has the types
of all attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Vt

from animtool.core.array_types import Float32Array, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.usd.layers.finite import ValueLabels
from animtool.usd.layers.sdf import (
    SampleWriter,
    attribute_spec,
    gf_quaternion,
    gf_vector,
)

if TYPE_CHECKING:
    from animtool.motion.frames import (
        CurvesFrame,
        Frame,
        MeshFrame,
        PointsFrame,
        TransformsFrame,
    )

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class AttributeKind:
    """Type, value conversion and interpolation of an attribute."""

    type_name: Any
    convert: Callable[[Any], Any]
    interpolation: str = ""
    is_uniform: bool = False


_INTEGER_ATTRIBUTE = AttributeKind(_TYPES.IntArray, Vt.IntArray.FromNumpy)
_TOKEN_ATTRIBUTE = AttributeKind(_TYPES.Token, str, is_uniform=True)
ATTRIBUTE_KINDS = {
    "points": AttributeKind(_TYPES.Point3fArray, Vt.Vec3fArray.FromNumpy),
    "velocities": AttributeKind(_TYPES.Vector3fArray, Vt.Vec3fArray.FromNumpy),
    "extent": AttributeKind(_TYPES.Float3Array, Vt.Vec3fArray.FromNumpy),
    "normals": AttributeKind(_TYPES.Normal3fArray, Vt.Vec3fArray.FromNumpy, "vertex"),
    "ids": AttributeKind(_TYPES.Int64Array, Vt.Int64Array.FromNumpy),
    "positions": AttributeKind(_TYPES.Point3fArray, Vt.Vec3fArray.FromNumpy),
    "orientationsf": AttributeKind(_TYPES.QuatfArray, Vt.QuatfArray.FromNumpy),
    "angularVelocities": AttributeKind(_TYPES.Vector3fArray, Vt.Vec3fArray.FromNumpy),
    "scales": AttributeKind(_TYPES.Float3Array, Vt.Vec3fArray.FromNumpy),
    "protoIndices": _INTEGER_ATTRIBUTE,
    "widths": AttributeKind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex"),
    "curveVertexCounts": _INTEGER_ATTRIBUTE,
    "faceVertexCounts": _INTEGER_ATTRIBUTE,
    "faceVertexIndices": _INTEGER_ATTRIBUTE,
    "subdivisionScheme": _TOKEN_ATTRIBUTE,
    "doubleSided": AttributeKind(_TYPES.Bool, bool, is_uniform=True),
    "purpose": _TOKEN_ATTRIBUTE,
    "type": _TOKEN_ATTRIBUTE,
    "wrap": _TOKEN_ATTRIBUTE,
    "xformOp:translate": AttributeKind(_TYPES.Double3, gf_vector),
    "xformOp:orient": AttributeKind(_TYPES.Quatd, gf_quaternion),
}


def attribute_kind(name: str, values: npt.NDArray[Any]) -> AttributeKind:
    """Return the USD type of an attribute; for primvars, based on their values.

    ``name`` is one that `split_attribute` parses.
    """
    if not name.startswith("primvars:"):
        return ATTRIBUTE_KINDS[name.rpartition(".")[2]]
    if np.issubdtype(values.dtype, np.integer):
        return AttributeKind(_TYPES.IntArray, Vt.IntArray.FromNumpy, "vertex")
    if values.ndim == 1:
        return AttributeKind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex")
    is_color = name == "primvars:displayColor"
    type_name = _TYPES.Color3fArray if is_color else _TYPES.Float3Array
    return AttributeKind(type_name, Vt.Vec3fArray.FromNumpy, "vertex")


def author_values(spec: Any, values: Mapping[str, Any]) -> None:
    """Author constant values of `ATTRIBUTE_KINDS`, in order."""
    for name, value in values.items():
        kind = ATTRIBUTE_KINDS[name]
        attribute_spec(
            spec,
            name,
            kind.type_name,
            kind.convert(value),
            is_uniform=kind.is_uniform,
            interpolation=kind.interpolation,
        )


# Curves are polylines with two ends.
POLYLINE_TOKENS = {"type": "linear", "wrap": "nonperiodic"}


def author_width(spec: Any, width: float) -> None:
    """Author one constant width for all curves, in stage units."""
    widths = Vt.FloatArray([width])
    attribute_spec(spec, "widths", _TYPES.FloatArray, widths, interpolation="constant")


def split_attribute(path: str, name: str) -> tuple[str, str]:
    """Return the prim path and attribute name of a dotted attribute below a path.

    >>> split_attribute("/it", "brick_3.xformOp:orient")
    ('/it/brick_3', 'xformOp:orient')
    """
    child, _, leaf = name.rpartition(".")
    return f"{path}/{child}" if child else path, leaf


@dataclass(slots=True)
class CharactersReport:
    """Counts of written characters, samples and errors."""

    own: int = 0  # characters with a separate animation
    shared: int = 0  # characters that share an animation
    samples: int = 0  # samples of animations of single characters
    frames: int = 0  # frames of animations of single characters
    error: float = 0.0  # largest joint error between samples [m]
    slide: float = 0.0  # largest error of a planted foot between samples [m]


@dataclass(frozen=True, slots=True)
class FrameBlock:
    """Frames of one prim as written, in stage units."""

    prim_index: int  # index of the written prim
    codes: FloatArray  # time codes (F,)
    # Values ``(F, …)`` by attribute, in order; see `split_attribute`.
    values: Mapping[str, npt.NDArray[Any]]
    vertex_count: int  # most points of any frame
    error: float = 0.0  # largest distance that rounding moved a point [m]
    error_code: float = 0.0  # time code of the largest error
    error_vertex: int = 0  # point of the largest error

    @property
    def bytes(self) -> int:
        """Size of the values in memory."""
        return sum(rows.nbytes for rows in self.values.values())

    def select_frames(self, frames: slice) -> FrameBlock:
        """Return a block of a subset of the frames, with the error of all frames."""
        values = {name: rows[frames] for name, rows in self.values.items()}
        return replace(self, codes=self.codes[frames], values=values)


@dataclass(frozen=True, slots=True)
class PointSpace:
    """Space that the points of a mesh are written in."""

    # mesh_from_skeleton in the layer's unit ``(4, 4)``; None if the spaces are equal.
    placement: FloatArray | None = None
    margin: float = 0.0  # half the width of curves, in the layer's unit


@dataclass(slots=True)
class CachedMesh:
    """Counts and errors of one written PointBased prim, as reported."""

    path: str
    vertices: int = 0  # most points of any frame
    samples: int = 0  # time samples of its points; 0 if static
    bytes: int = 0  # size of its samples in memory
    sampled: list[str] = field(default_factory=list)  # attributes with time samples
    error: float = 0.0  # largest distance that rounding moved a point [m]
    error_code: float = 0.0  # time code of the largest error
    error_vertex: int = 0  # point of the largest error
    names: Sequence[str] = ()  # names of points that are bodies
    notices: list[Fault] = field(default_factory=list)
    characters: CharactersReport | None = None  # counts of crowd characters, if any

    def add_block(self, block: FrameBlock) -> None:
        """Add the counts of a block of frames, and update the largest error."""
        self.vertices = max(self.vertices, block.vertex_count)
        self.samples += len(block.codes)
        self.bytes += block.bytes
        if block.error > self.error:
            self.error, self.error_code = block.error, block.error_code
            self.error_vertex = block.error_vertex


def attribute_labels(report: CachedMesh, name: str) -> ValueLabels:
    """Return labels for messages about an attribute's values."""
    names = () if name == "extent" else report.names
    noun = "body" if names else "point"
    location = ".".join(split_attribute(report.path, name))
    return ValueLabels(location, "" if "." in name else noun, names)


class PointWriter:
    """Writes blocks of frames of one existing prim to a layer.

    Animated attributes get samples, static ones a default. With `writes_every_frame`,
    each frame is a sample, as for simulated prims; with `with_default`, the first frame
    is also the default.
    """

    def __init__(
        self,
        layer: Any,
        report: CachedMesh,  # report with the path of the prim
        *,
        writes_every_frame: bool = False,
        with_default: bool = True,
        on_added: Callable[[int], object]
        | None = None,  # called with block sizes [byte]
    ) -> None:
        self._layer, self._report = layer, report
        self._writes_every_frame = writes_every_frame
        self._with_default = with_default
        self._on_added = on_added
        self._sample_writers: dict[str, SampleWriter] = {}

    def add(self, block: FrameBlock) -> None:
        """Write a block of frames of the prim."""
        with Sdf.ChangeBlock():
            for name, rows in block.values.items():
                if name not in self._sample_writers:
                    self._sample_writers[name] = self._attribute_writer(name, rows)
                self._sample_writers[name].add(block.codes, rows)
        if self._on_added is not None:
            self._on_added(block.bytes)

    def _attribute_writer(self, name: str, rows: npt.NDArray[Any]) -> SampleWriter:
        if not self._writes_every_frame:
            return empty_attribute(self._prim_spec, name)
        labels = attribute_labels(self._report, name)
        attr = self._layer.GetAttributeAtPath(labels.attribute)
        convert = attribute_kind(name, rows[0]).convert
        return SampleWriter(
            attr,
            convert,
            writes_every_frame=True,
            with_default=self._with_default,
            noun=labels.noun,
            names=labels.names,
        )

    @property
    def _prim_spec(self) -> Any:
        return self._layer.GetPrimAtPath(self._report.path)

    def sample_all(self, *, with_defaults: bool) -> None:
        """Write samples of every attribute, even of constant ones.

        ``with_defaults`` also authors defaults, except of velocities.
        """
        for name, writer in self._sample_writers.items():
            writer.start_sampling()
            if with_defaults and name != "velocities":
                writer.author_default()

    def finish(self, *, with_defaults: bool) -> None:
        """Author constant values as defaults; report the sampled attributes.

        ``with_defaults`` also authors defaults of sampled attributes; a rig already has
        them.
        """
        writers, report = self._sample_writers, self._report
        velocities = writers.pop("velocities", None)
        is_animated = bool(writers) and writers["points"].has_samples
        if velocities is not None:
            if is_animated:
                # UsdGeomPointBased uses velocities only if points have samples at the
                # same times.
                velocities.start_sampling()
                writers["velocities"] = velocities
            else:
                remove_attribute(self._prim_spec, "velocities")
        for name, writer in writers.items():
            if with_defaults and name != "velocities":
                writer.author_default()
        no_velocities = np.zeros((0, 3), np.float32)
        for writer in writers.values():
            writer.finish(no_velocities)
        report.sampled = [
            name for name, writer in writers.items() if writer.has_samples
        ]
        if not is_animated:
            report.samples = report.bytes = 0


def empty_attribute(spec: Any, name: str) -> SampleWriter:
    """Replace a rest mesh's attribute by an empty one; return its sample writer."""
    remove_attribute(spec, name)
    kind = ATTRIBUTE_KINDS[name]
    attr = attribute_spec(spec, name, kind.type_name, interpolation=kind.interpolation)
    return SampleWriter(attr, kind.convert)


def remove_attribute(spec: Any, name: str) -> None:
    """Remove an attribute from the prim if present."""
    if name in spec.attributes:
        spec.RemoveProperty(spec.attributes[name])


class FramePrimWriter(Protocol):
    """Interface of a prim writer that a `FrameEncoder` fills."""

    unit: float  # unit of the layer [m]
    rotation: FloatArray  # orientation of the prim in the layer (4,)

    @property
    def triangles(self) -> IntArray:
        """Faces of the first frame as triangles ``(T, 3)``."""

    @property
    def child_names(self) -> list[str]:
        """Legal, unique names of the child prims, from the names of the first frame."""

    def to_float32(
        self, name: str, values: npt.NDArray[Any], code: float
    ) -> Float32Array:
        """Return values ``(N,)`` or ``(N, 3)`` of an attribute as float32."""

    def write_static(self, layer: Any, path: str, frame: Frame) -> None:
        """Write a frame as a static prim."""


FrameT = TypeVar("FrameT", "CurvesFrame", "MeshFrame", "PointsFrame", "TransformsFrame")


class FrameEncoder(Generic[FrameT]):
    """Maps one frame type to a prim type, its attributes and their values."""

    type_name: ClassVar[str]
    sampled_names: ClassVar[tuple[str, ...]]  # attributes of every frame, in order
    points: ClassVar[str] = "points"  # attribute name of the points

    def topology(self, frame: FrameT) -> Mapping[str, IntArray]:  # noqa: ARG002
        """Return the integer topology attributes of a frame."""
        return {}

    def can_tear(self, frame: FrameT) -> bool:  # noqa: ARG002
        """Return whether the topology may change between frames."""
        return False

    def attribute_kinds(self, frame: FrameT) -> dict[str, AttributeKind]:
        """Return the sampled attributes, in order, by name; see `split_attribute`."""
        primvar_rows = {
            f"primvars:{name}": rows for name, rows in frame.primvars.items()
        }
        attribute_kinds = {name: ATTRIBUTE_KINDS[name] for name in self.sampled_names}
        attribute_kinds |= {
            name: attribute_kind(name, rows) for name, rows in primvar_rows.items()
        }
        return {**attribute_kinds, "extent": ATTRIBUTE_KINDS["extent"]}

    def author_children(self, spec: Any, frame: FrameT) -> None:
        """Create the child prims that have samples."""

    def author_constants(
        self, writer: FramePrimWriter, spec: Any, frame: FrameT
    ) -> None:
        """Author the constant attributes of the prim."""

    def values(
        self, writer: FramePrimWriter, frame: FrameT, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return the values of a frame, except points ``(N, 3)`` and velocities."""
        raise NotImplementedError


def bounds(
    points: Float32Array, padding: float | FloatArray | Float32Array
) -> Float32Array:
    """Return the padded bounds of points ``(2, 3)``; zeros if there are none."""
    if not len(points):
        return np.zeros((2, 3), np.float32)
    if isinstance(padding, float):
        lowest, highest = points.min(axis=0) - padding, points.max(axis=0) + padding
    else:
        lowest, highest = (points - padding).min(axis=0), (points + padding).max(axis=0)
    return np.stack([lowest, highest]).astype(np.float32)


def bounds_corners(points: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the corners ``(8, 3)`` of the bounds of points ``(N, 3)``."""
    lowest_and_highest = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.asarray(
        lowest_and_highest[np.indices((2, 2, 2)).reshape(3, 8), np.arange(3)[:, None]].T
    )
