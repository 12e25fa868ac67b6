"""How a type of frame becomes a prim: its attributes and values, a row of `FORMS`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Vt

from animtool._types import Float32Array, FloatArray, IntArray
from animtool.frames import (
    CurvesFrame,
    Frame,
    MeshFrame,
    PointsFrame,
    TransformsFrame,
)
from animtool.maths import so3
from animtool.maths.faces import triangulated, vertex_normals
from animtool.usd.layers import (
    attribute,
    author_order,
    prim,
    quaternion,
    relationship,
    vector,
)
from animtool.usd.names import UsdNames, distinct_names
from animtool.usd.point_based import (
    ATTRIBUTES,
    Kind,
    author_faces,
    author_linear,
    author_width,
)

_TYPES = Sdf.ValueTypeNames
FrameT = TypeVar("FrameT", CurvesFrame, MeshFrame, PointsFrame, TransformsFrame)


class Writer(Protocol):
    """What writes a prim, as its form needs it."""

    unit: float  # of the layer [m]
    turn: FloatArray  # how the prim stands in the layer (4,)

    @property
    def triangles(self) -> IntArray:
        """Faces of the first frame as triangles ``(T, 3)``."""

    @property
    def parts(self) -> list[str]:
        """Names of the prims below, of a frame that has names."""

    def narrowed(
        self, name: str, values: npt.NDArray[Any], code: float
    ) -> Float32Array:
        """Return values ``(N,)`` or ``(N, 3)`` of an attribute in float32."""

    def write_still(self, layer: Any, path: str, frame: Frame) -> None:
        """Write a frame as a prim that never moves."""


class FrameForm(Generic[FrameT]):
    """How a type of frame is written: its prim, attributes and values."""

    type_name: ClassVar[str]
    sampled: ClassVar[tuple[str, ...]]  # attributes that every frame has, in order
    points: ClassVar[str] = "points"  # what the prim calls its points

    def shape(self, frame: FrameT) -> Mapping[str, IntArray]:  # noqa: ARG002
        """Return attributes of whole numbers that say how points are joined."""
        return {}

    def tears(self, frame: FrameT) -> bool:  # noqa: ARG002
        """Return whether the shape may be another at another frame."""
        return False

    def kinds(self, frame: FrameT) -> dict[str, Kind]:
        """Return what has samples, in order, by name, as `place_of` reads them."""
        kinds = {name: ATTRIBUTES[name] for name in self.sampled}
        for name, values in frame.primvars.items():
            kinds[f"primvars:{name}"] = _primvar_kind(name, values)
        kinds["extent"] = ATTRIBUTES["extent"]
        return kinds

    def divide(self, spec: Any, frame: FrameT) -> None:
        """Write prims below the prim that have samples."""

    def describe(self, writer: Writer, spec: Any, frame: FrameT) -> None:
        """Write what else the prim is, which no frame changes."""

    def values(
        self, writer: Writer, frame: FrameT, points: Float32Array, code: float
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

    def describe(self, writer: Writer, spec: Any, frame: CurvesFrame) -> None:
        """Write kind and width of the curves."""
        author_linear(spec)
        author_width(spec, frame.width / writer.unit)

    def values(
        self,
        writer: Writer,
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

    def tears(self, frame: MeshFrame) -> bool:
        """Return whether its faces may be others."""
        return frame.tears

    def describe(self, writer: Writer, spec: Any, frame: MeshFrame) -> None:  # noqa: ARG002
        """Write that it is no cage, and whether both sides are visible."""
        author_faces(spec, "none", closed=frame.closed)

    def values(
        self,
        writer: Writer,
        frame: MeshFrame,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds and normals; what does not tear has the first frame's faces."""
        faces = writer.triangles
        if frame.tears:
            faces = triangulated(frame.counts, frame.indices)
        normals = vertex_normals(frame.points, faces)
        return {"extent": bounds(points, 0.0), "normals": normals.astype(np.float32)}


class _Points(FrameForm[PointsFrame]):
    type_name = "Points"
    sampled = ("points", "velocities", "ids", "widths")

    def values(
        self, writer: Writer, frame: PointsFrame, points: Float32Array, code: float
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return ids, widths and bounds of the balls."""
        widths = writer.narrowed("widths", 2 * frame.radii / writer.unit, code)
        extent = bounds(points, widths[:, None] / 2)
        return {"ids": frame.ids, "widths": widths, "extent": extent}


class _Transforms(FrameForm[TransformsFrame]):
    type_name = "PointInstancer"
    sampled = (
        "positions",
        "velocities",
        "ids",
        "orientationsf",
        "angularVelocities",
        "scales",
        "protoIndices",
    )
    points = "positions"

    def describe(self, writer: Writer, spec: Any, frame: TransformsFrame) -> None:
        """Write the meshes below the prim."""
        relationship(spec, "prototypes", *_prototypes(writer, spec, frame.meshes))

    def values(
        self,
        writer: Writer,
        frame: TransformsFrame,
        points: Float32Array,
        code: float,
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return which mesh each is, its turn and scale, and bounds of all."""
        boxes = np.stack([_corners(mesh.points) for mesh in frame.meshes])
        corners = boxes[frame.copied] * (frame.scales[:, None] / writer.unit)
        corners = so3.rotate(frame.rotations[:, None], corners) + points[:, None]
        extent = writer.narrowed("extent", corners.reshape(-1, 3), code)
        return {
            "ids": frame.ids,
            "orientationsf": writer.narrowed("orientationsf", frame.rotations, code),
            "angularVelocities": writer.narrowed(
                "angularVelocities", np.degrees(frame.spins), code
            ),
            "scales": writer.narrowed("scales", frame.scales, code),
            "protoIndices": frame.copied.astype(np.int32),
            "extent": bounds(extent, 0.0),
        }


class _Xforms(FrameForm[TransformsFrame]):
    """Copies with names: an Xform each, with a mesh that refers to a prototype."""

    type_name = "Xform"
    points = ""

    def kinds(self, frame: TransformsFrame) -> dict[str, Kind]:
        """Return the operations of those that move."""
        return {
            f"{part}.{name}": kind
            for i, part in enumerate(part_names(frame.names).names)
            if i not in frame.still
            for name, kind in _OPERATIONS.items()
        }

    def divide(self, spec: Any, frame: TransformsFrame) -> None:
        """Write the Xforms, in order."""
        for part in part_names(frame.names).names:
            prim(spec.layer, f"{spec.path}/{part}", "Xform")

    def describe(self, writer: Writer, spec: Any, frame: TransformsFrame) -> None:
        """Write meshes, in which order operations follow, and where the still ones are.

        The prototypes are a class, which nothing shows.
        """
        layer, paths = spec.layer, _prototypes(writer, spec, frame.meshes)
        layer.GetPrimAtPath(f"{spec.path}/{PROTOTYPES}").specifier = Sdf.SpecifierClass
        for i, part in enumerate(writer.parts):
            own = layer.GetPrimAtPath(f"{spec.path}/{part}")
            names = list(_OPERATIONS)
            if i in frame.still:
                for name, value in zip(
                    names, _placed(frame, i, writer.unit), strict=True
                ):
                    attribute(own, name, _OPERATIONS[name].type_name, value)
            if not (frame.scales[i] == 1.0).all():
                scale = Gf.Vec3f(*frame.scales[i].tolist())
                attribute(own, "xformOp:scale", _TYPES.Float3, scale)
                names.append("xformOp:scale")
            author_order(own, *names)
            mesh = prim(layer, f"{own.path}/mesh")
            mesh.referenceList.Prepend(Sdf.Reference("", paths[frame.copied[i]]))
        if frame.physics is not None:
            from animtool.usd.body_physics import PhysicsWriter

            own = PhysicsWriter(
                spec, writer.parts, frame.physics, writer.unit, writer.turn
            )
            own.write()

    def values(
        self,
        writer: Writer,
        frame: TransformsFrame,
        points: Float32Array,  # noqa: ARG002
        code: float,  # noqa: ARG002
    ) -> Mapping[str, Any]:
        """Return where those are that move."""
        return {
            f"{part}.{name}": value
            for i, part in enumerate(writer.parts)
            if i not in frame.still
            for name, value in zip(
                _OPERATIONS, _placed(frame, i, writer.unit), strict=True
            )
        }


# Operations of an Xform; a value is what USD takes already.
_OPERATIONS = {
    "xformOp:translate": Kind(_TYPES.Double3, Gf.Vec3d),
    "xformOp:orient": Kind(_TYPES.Quatd, Gf.Quatd),
}
PROTOTYPES, PHYSICS = "Prototypes", "Physics"  # prims that are no copy


def _placed(frame: TransformsFrame, i: int, unit: float) -> tuple[Any, Any]:
    """Return translation, in a unit [m], and rotation of a copy."""
    return vector(frame.points[i] / unit), quaternion(frame.rotations[i])


def part_names(names: Sequence[str]) -> UsdNames:
    """Return legal and distinct names of copies.

    >>> part_names(["brick[3]", "brick_3"]).names
    ['brick_3', 'brick_3_2']
    """
    every = [PROTOTYPES, PHYSICS, *names]
    distinct = distinct_names(every, [name.removesuffix("]") for name in every], every)
    return replace(distinct, names=distinct.names[2:])


def _prototypes(writer: Writer, spec: Any, meshes: Sequence[MeshFrame]) -> list[str]:
    """Write meshes below a prim; return their paths."""
    above = prim(spec.layer, f"{spec.path}/{PROTOTYPES}", "Scope")
    paths = [f"{above.path}/mesh_{i + 1}" for i in range(len(meshes))]
    for path, mesh in zip(paths, meshes, strict=True):
        writer.write_still(spec.layer, path, mesh)
    return paths


def place_of(path: str, name: str) -> tuple[str, str]:
    """Return the prim that has an attribute of a writer at a path, and its name there.

    >>> place_of("/it", "points"), place_of("/it", "brick_3.xformOp:orient")
    (('/it', 'points'), ('/it/brick_3', 'xformOp:orient'))
    """
    part, _, own = name.rpartition(".")
    return f"{path}/{part}" if part else path, own


def _corners(points: FloatArray) -> FloatArray:
    """Return the corners ``(8, 3)`` of the box about points ``(N, 3)``."""
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    return ends[np.indices((2, 2, 2)).reshape(3, 8), np.arange(3)[:, None]].T


FORMS: dict[type[Frame], FrameForm[Any]] = {
    CurvesFrame: _Curves(),
    MeshFrame: _Mesh(),
    PointsFrame: _Points(),
    TransformsFrame: _Transforms(),
}
_XFORMS = _Xforms()


def form_of(frame: Frame) -> FrameForm[Any]:
    """Return how a frame is written."""
    divided = isinstance(frame, TransformsFrame) and frame.xforms
    return _XFORMS if divided else FORMS[type(frame)]


def _primvar_kind(name: str, values: npt.NDArray[Any]) -> Kind:
    """Return how a named array of points ``(N,)`` or ``(N, 3)`` is written."""
    if np.issubdtype(values.dtype, np.integer):
        return Kind(_TYPES.IntArray, Vt.IntArray.FromNumpy, "vertex")
    if values.ndim == 1:
        return Kind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex")
    color = name == "displayColor"
    kind = _TYPES.Color3fArray if color else _TYPES.Float3Array
    return Kind(kind, Vt.Vec3fArray.FromNumpy, "vertex")


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
