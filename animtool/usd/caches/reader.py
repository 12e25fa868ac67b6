"""Reads points of prims over time: meshes, curves, particles, instances.

All readers of points and faces use `PointReader`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, counted, excerpt
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.prims import (
    array_or_empty,
    array_value,
    decompose,
    find_prim,
    find_skeletons,
    integer_array,
    nearest_prim,
    number_rows,
    open_stage,
    transform_times,
    up_axis,
)

# Tolerance of a quaternion's length; half-float ones are within it.
UNIT_TOLERANCE = 5e-3


class PointReader:
    """Reads the points of a PointBased prim or the positions of a PointInstancer."""

    def __init__(self, prim: Any) -> None:
        self.prim = prim
        self.is_instancer = bool(prim.IsA(UsdGeom.PointInstancer))
        self.points_attr = prim.GetAttribute(
            "positions" if self.is_instancer else "points"
        )

    @property
    def times(self) -> list[float]:
        """Time codes of the samples; empty if the points are static."""
        return list(self.points_attr.GetTimeSamples())

    @property
    def codes(self) -> list[float]:
        """Time codes at which points or transforms have samples."""
        return sorted({*self.times, *transform_times(self.prim)})

    def has_value(self, name: str) -> bool:
        """Return whether the prim authors values of an attribute."""
        attribute = self.prim.GetAttribute(name)
        return bool(attribute and attribute.HasAuthoredValue())

    def points_at(self, time: Any) -> FloatArray:
        """Return the points at a time ``(N, 3)``, in local space and stage units."""
        return number_rows(self.points_attr, 3, time)

    def point_count(self) -> int:
        """Return the number of points at the earliest time."""
        return len(self.points_attr.Get(Usd.TimeCode.EarliestTime()) or ())

    def world_from_prim(self, time: Any) -> FloatArray:
        """Return the prim's transform at a time, for row vectors ``(4, 4)``."""
        world = UsdGeom.Imageable(self.prim).ComputeLocalToWorldTransform(time)
        return np.array(world, np.float64)

    def faces(self, time: Any) -> tuple[IntArray, IntArray]:
        """Return vertex counts per face ``(M,)`` and the face vertex indices."""
        mesh = UsdGeom.Mesh(self.prim)
        counts = integer_array(mesh.GetFaceVertexCountsAttr(), time)
        return counts, integer_array(mesh.GetFaceVertexIndicesAttr(), time)


def transform_points(points: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return points ``(N, 3)`` transformed by a row-vector matrix ``(4, 4)``.

    Callers must check that the result is finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        result: FloatArray = points @ matrix[:3, :3] + matrix[3, :3]
    return result


def time_codes_of(times: Sequence[float]) -> list[Any]:
    """Return times as `Usd.TimeCode` values, or the default time code if empty."""
    return [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]


def array_lengths(attribute: Any, codes: Sequence[Any]) -> list[int | None]:
    """Return the length of an array attribute at each time; None if it has no value."""
    values = (attribute.Get(code) for code in codes)
    return [None if value is None else len(array_or_empty(value)) for value in values]


def all_prims(stage: Any) -> Iterator[Any]:
    """Yield every prim, including overs and instance proxies."""
    yield from Usd.PrimRange.Stage(
        stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    )


def has_character(stage: Any) -> bool:
    """Return whether a stage has a Skeleton or a SkelAnimation."""
    animations = (prim.IsA(UsdSkel.Animation) for prim in all_prims(stage))
    return bool(find_skeletons(stage)) or any(animations)


def point_prims(stage: Any) -> Iterator[Any]:
    """Yield prims with points, except prototypes of a PointInstancer."""
    prims = [prim for prim in all_prims(stage) if _has_points(prim)]
    prototypes = {
        path
        for prim in prims
        if prim.IsA(UsdGeom.PointInstancer)
        for path in prototype_paths(prim)
        if not prim.GetPath().HasPrefix(path)
    }
    for prim in prims:
        if not any(path in prototypes for path in prim.GetPath().GetPrefixes()):
            yield prim


def prototype_paths(instancer: Any) -> list[Any]:
    """Return the paths of the prototypes of a PointInstancer."""
    prototypes = UsdGeom.PointInstancer(instancer).GetPrototypesRel()
    return list(prototypes.GetForwardedTargets())


def _has_points(prim: Any) -> bool:
    if prim.IsAbstract():
        return False
    if prim.IsA(UsdGeom.PointInstancer):
        return True
    points = prim.GetAttribute("points")
    is_untyped = not prim.GetTypeName() and points and points.HasAuthoredValue()
    return bool(prim.IsA(UsdGeom.PointBased) or is_untyped)


@dataclass(frozen=True, slots=True)
class PointSample:
    """Points, ids and instance transforms of a prim at a time code, world space."""

    points: FloatArray  # (N, 3) [m]
    ids: IntArray | None  # (N,); None if points have no ids
    orientations: FloatArray | None = None  # x, y, z, w (N, 4); None unless instances
    scales: FloatArray | None = None  # as authored (N, 3) [1]; None unless instances
    # Prototype index (N,); None unless instances.
    prototype_indices: IntArray | None = None


class PointSource:
    """The prims with points of an open stage, sampled by time."""

    def __init__(self, path: Path, stage: Any) -> None:
        self._path, self._stage = path, stage
        root = stage.GetDefaultPrim()
        default_path = root.GetPath() if root else Sdf.Path.absoluteRootPath
        # Names are relative to the default prim, so that its name does not matter.
        self._readers = {
            str(prim.GetPath().MakeRelativePath(default_path)): PointReader(prim)
            for prim in point_prims(stage)
        }
        self.fps = rate_from_float(stage.GetTimeCodesPerSecond())
        self.unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        self.up = up_axis(stage)

    @property
    def names(self) -> list[str]:
        """Paths of the prims, below the default prim."""
        return list(self._readers)

    def prim_type(self, name: str) -> str:
        """Return the type of a prim."""
        return str(self._readers[name].prim.GetTypeName())

    def codes(self, name: str) -> list[float]:
        """Return the time codes of a prim's samples; empty if the prim is static."""
        return [float(code) for code in self._readers[name].codes]

    def sample(self, name: str, code: float | None) -> PointSample:
        """Return the sample of a prim at a time code; None is the default time.

        Instances without orientations or scales get the identity.

        Raises:
            FormatError: The arrays do not match (USD269), or contain non-finite numbers
                (USD265) or invalid rotations (USD288).
        """
        reader = self._readers[name]
        time = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
        prim, location = reader.prim, PrimLocation.from_prim(self._path, reader.prim)
        points_local, matrix = reader.points_at(time), reader.world_from_prim(time)
        if not (np.isfinite(points_local).all() and np.isfinite(matrix).all()):
            location.fail("USD265", "points are not finite")
        points = transform_points(points_local, matrix) * self.unit
        count = len(points)

        def array_rows(*names: str, width: int = 0) -> Any:
            """Return the rows of the first of these attributes with a value, else None.

            ``width`` 0 reads integers.
            """
            attr = next(
                (prim.GetAttribute(n) for n in names if reader.has_value(n)), None
            )
            if attr is None:
                return None
            values = (
                number_rows(attr, width, time) if width else integer_array(attr, time)
            )
            if not len(values) == len(array_value(attr, time)) in {0, count}:
                location.at_prim(attr).fail(
                    "USD269", f"{len(values)} for {count} points"
                )
            return values if len(values) else None

        ids = array_rows("ids")
        if not reader.is_instancer:
            return PointSample(points, ids)
        orientations = array_rows("orientationsf", "orientations", width=4)
        if orientations is None:
            orientations = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        lengths = np.linalg.norm(orientations, axis=1, keepdims=True)
        if not (np.abs(lengths - 1) < UNIT_TOLERANCE).all():
            location.fail("USD288", "a quaternion is not of length 1")
        orientations = so3.multiply(
            decompose(matrix[None])[1][0], orientations / lengths
        )
        scales = array_rows("scales", width=3)
        if scales is None:
            scales = np.ones((count, 3))
        if not np.isfinite(scales).all():
            location.fail("USD265", "scales are not finite")
        prototype_indices = array_rows("protoIndices")
        if prototype_indices is None:
            prototype_indices = np.full(count, -1)
        return PointSample(points, ids, orientations, scales, prototype_indices)


def open_points(path: Path) -> PointSource | None:
    """Return the points of a stage that has prims with points but no character."""
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        source = None if has_character(stage) else PointSource(path, stage)
    return source if source and source.names else None


@dataclass(frozen=True, slots=True)
class StaticMesh:
    """Points and faces of a mesh at one time, world space."""

    points: FloatArray  # ``(N, 3)`` [m]
    counts: IntArray  # number of corners of each face ``(M,)``
    indices: IntArray  # point index of each corner, face by face


def read_static_mesh(path: Path, prim: str, up: UpAxis) -> StaticMesh:
    """Return a mesh at its earliest time sample."""
    return open_mesh(path, prim, up).sample(None)


class MeshSource:
    """A mesh of an open stage, sampled by time.

    ``span`` is the first and last time code at which points or transform change;
    None if the mesh is static.
    """

    def __init__(self, stage: Any, prim: Any, up: UpAxis) -> None:
        # A prim is only valid while its stage exists.
        self._stage, self._reader = stage, PointReader(prim)
        self._unit = UsdGeom.GetStageMetersPerUnit(stage)
        self._up_rotation = up_from_up(up, up_axis(stage))
        self.fps = float(stage.GetTimeCodesPerSecond())
        times = self._reader.codes
        self.span = (float(times[0]), float(times[-1])) if times else None

    def sample(self, code: float | None) -> StaticMesh:
        """Return the mesh at a time code; None is the earliest sample.

        Raises:
            OptionError: The points, faces or transform are invalid (SIM051).
        """
        time = Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)
        points = self._reader.points_at(time)
        counts, indices = self._reader.faces(time)
        if message := mesh_fault(points, counts, indices):
            path = self._reader.prim.GetPath()
            raise OptionError(Fault("SIM051", f"{path} {message}"))
        world = self._reader.world_from_prim(time)
        world_points = transform_points(points, world) * self._unit
        if not np.isfinite(world_points).all():
            message = f"the transform of {self._reader.prim.GetPath()} is not finite"
            raise OptionError(
                Fault("SIM051", message, hint="check the transforms above it")
            )
        if self._up_rotation is not None:
            world_points = so3.rotate(np.array(self._up_rotation), world_points)
        return StaticMesh(np.asarray(world_points, np.float64), counts, indices)


def open_mesh(path: Path, prim: str, up: UpAxis) -> MeshSource:
    """Return a mesh source that can be sampled over time."""
    with usd_errors(path):
        stage = open_stage(path)
        mesh_prim = find_prim(stage, prim)
        if mesh_prim is None or not mesh_prim.IsA(UsdGeom.Mesh):
            problem = "no prim" if mesh_prim is None else "no mesh"
            hint = nearest_prim(stage, prim) if mesh_prim is None else None
            message = f"{path.name} holds {problem} {excerpt(prim)}"
            raise OptionError(Fault("SIM051", message, hint=hint))
        return MeshSource(stage, mesh_prim, up)


def mesh_fault(points: FloatArray, counts: IntArray, indices: IntArray) -> str:
    """Return why points ``(N, 3)`` and faces are not a valid mesh; empty if valid."""
    if not len(points) or not len(counts):
        return "has no points or no faces"
    if not np.isfinite(points).all():
        return "has a point that is not finite"
    if (counts < 3).any():
        return f"has a face of only {counted(int(counts.min()), 'corner')}"
    if counts.sum() != len(indices):
        return f"has {len(indices)} corners, but its faces need {counts.sum()}"
    out_of_range = indices[(indices < 0) | (indices >= len(points))]
    if len(out_of_range):
        count = counted(len(points), "point")
        return f"has a face that refers to point {out_of_range[0]}, but only {count}"
    return ""
