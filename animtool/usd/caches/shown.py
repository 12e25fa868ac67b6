"""Finds the visible prims of a stage that are not characters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import time_fraction
from animtool.core.files.reading import record_input
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name, up_from_up
from animtool.maths import so3, solids
from animtool.usd.caches.reader import (
    PointReader,
    PointSample,
    PointSource,
    all_prims,
    mesh_fault,
    prototype_paths,
    transform_points,
)
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import bound_meshes
from animtool.usd.rigs.meshes import MESH_COLORS
from animtool.usd.rigs.prims import (
    find_skeletons,
    number_rows,
    open_stage,
    search_root,
    self_and_ancestors,
    up_axis,
    varying_xformables,
)
from animtool.usd.rigs.skinned import is_bone_mesh, skinned_prims

_IMPLICIT_SHAPES = (
    UsdGeom.Cube,
    UsdGeom.Sphere,
    UsdGeom.Cylinder,
    UsdGeom.Cone,
    UsdGeom.Capsule,
)


@dataclass(frozen=True, slots=True)
class VisibleMesh:
    """A mesh in local space [m], with the stage's axes."""

    points: FloatArray  # ``(N, 3)``
    counts: IntArray  # number of corners of each face ``(M,)``
    indices: IntArray  # point index of each corner, face by face
    color: tuple[float, float, float] | None  # None if not authored
    # Linear, per point ``(N, 3)``; None if points have no colors.
    colors: FloatArray | None = None


class VisiblePrim:
    """A visible prim with points, or an implicit shape, over time.

    Attributes:
        name: Path below the default prim.
        kind: ``mesh``, ``curves``, ``points`` or ``copies``.
    """

    def __init__(self, stage: StageContents, prim: Any, name: str, kind: str) -> None:
        self.prim, self.name, self.kind = prim, name, kind
        self._stage, self._reader = stage, PointReader(prim)

    @cached_property
    def is_deforming(self) -> bool:
        """Whether the prim's points in local space may change over time."""
        attr = self._reader.points_attr
        return bool(attr and attr.ValueMightBeTimeVarying())

    @cached_property
    def is_moving(self) -> bool:
        """Whether the prim's world transform changes over time."""
        return any(True for _ in varying_xformables(self.prim))

    @property
    def is_animated(self) -> bool:
        """Whether the prim's points in world space may change over time."""
        return self.is_deforming or self.is_moving

    @cached_property
    def has_changing_faces(self) -> bool:
        """Whether the prim's topology may change over time."""
        names = ("faceVertexIndices", "faceVertexCounts", "curveVertexCounts")
        attributes = (self.prim.GetAttribute(name) for name in names)
        return any(a and a.ValueMightBeTimeVarying() for a in attributes)

    def world(self, code: float) -> FloatArray:
        """Return the prim's world transform for column vectors, Y up ``(4, 4)`` [m]."""
        matrix = self._reader.world_from_prim(Usd.TimeCode(code)).T.copy()
        matrix[:3, 3] *= self._stage.meters_per_unit
        return self._stage.matrix_to_y_up(matrix)

    def points(self, code: float) -> FloatArray:
        """Return the prim's points in world space, Y up ``(N, 3)`` [m]."""
        time = Usd.TimeCode(code)
        world_points = transform_points(
            self._reader.points_at(time), self._reader.world_from_prim(time)
        )
        return self._stage.to_y_up(world_points * self._stage.meters_per_unit)

    def local_mesh(self) -> VisibleMesh | None:
        """Return the mesh in local space at the earliest time; None if invalid."""
        time = Usd.TimeCode.EarliestTime()
        if self.prim.IsA(UsdGeom.Mesh):
            points = self._reader.points_at(time)
            counts, indices = self._reader.faces(time)
            if mesh_fault(points, counts, indices):
                return None
        else:
            points, counts, indices = _implicit_mesh(self.prim)
        colors = self.colors(self._stage.stage.GetStartTimeCode())
        vertex_colors = colors if len(colors) == len(points) > 1 else None
        metric_points = points * self._stage.meters_per_unit
        return VisibleMesh(metric_points, counts, indices, self.color, vertex_colors)

    def curve_counts(self) -> IntArray:
        """Return the number of points of each curve ``(C,)``."""
        counts = UsdGeom.Curves(self.prim).GetCurveVertexCountsAttr()
        return np.array(counts.Get(Usd.TimeCode.EarliestTime()) or (), np.int64)

    def widths(self, code: float) -> FloatArray:
        """Return the authored widths ``(N,)`` or ``(1,)`` [m]; empty if absent."""
        attr = self.prim.GetAttribute("widths")
        if not attr or not attr.HasAuthoredValue():
            return np.zeros(0)
        return number_rows(attr, 1, Usd.TimeCode(code)) * self._stage.meters_per_unit

    def ids(self, code: float) -> IntArray | None:
        """Return the ids of the points ``(N,)``; None if the prim has no ids."""
        attr = self.prim.GetAttribute("ids")
        value = attr.Get(Usd.TimeCode(code)) if attr else None
        return None if value is None else np.array(value, np.int64)

    def colors(self, code: float) -> FloatArray:
        """Return a linear color per point, or one for all ``(N or 1, 3)``, or none."""
        return _display_colors(self.prim, code)

    @cached_property
    def color(self) -> tuple[float, float, float] | None:
        """Mean linear color of the prim at the start; None if it has none."""
        code = self._stage.stage.GetStartTimeCode()
        colors = self.colors(code)
        if not len(colors):
            return None
        red, green, blue = colors.mean(axis=0).clip(0, 1).round(4).tolist()
        return red, green, blue

    def instances(self, code: float) -> PointSample:
        """Return the prim's instances in world space, Y up."""
        sample = self._stage.source.sample(self.name, code)
        up_rotation = self._stage.up_rotation
        assert sample.orientations is not None
        rotations = sample.orientations
        if up_rotation is not None:
            rotations = so3.multiply(up_rotation, rotations)
        points = self._stage.to_y_up(sample.points)
        return replace(sample, points=points, orientations=rotations)

    def prototypes(self) -> list[list[tuple[VisibleMesh, FloatArray]]]:
        """Return the meshes of each prototype, with their transforms ``(4, 4)`` [m]."""
        stage = self._stage.stage
        prototypes = []
        for path in prototype_paths(self.prim):
            root = stage.GetPrimAtPath(path)
            meshes = []
            for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
                kind = _prim_kind(prim)
                if kind != "mesh" or is_bone_mesh(prim):
                    continue
                mesh = VisiblePrim(self._stage, prim, "", kind).local_mesh()
                if mesh is not None:
                    unit = self._stage.meters_per_unit
                    meshes.append((mesh, _relative_transform(prim, root, unit)))
            prototypes.append(meshes)
        return prototypes

    def visibility(self, codes: FloatArray) -> BoolArray:
        """Return whether the prim is visible at each time code ``(F,)``."""
        return _is_visible(self.prim, codes)


def _display_colors(prim: Any, code: float) -> FloatArray:
    """Return the linear display colors of a prim, also inherited; empty if absent."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    value = primvar.ComputeFlattened(Usd.TimeCode(code)) if primvar else None
    if value is None:
        return np.zeros((0, 3))
    colors = np.array(value, np.float64).reshape(-1, 3)
    return colors if np.isfinite(colors).all() else colors[:0]


class StageContents:
    """The visible contents of an open stage over time.

    Attributes:
        stage: The stage.
        meters_per_unit: Length unit of the stage [m].
        up: Up axis of the stage.
        fps: Time codes per second.
        up_rotation: Rotation from the stage's up axis to Y; None for no rotation.
    """

    def __init__(self, path: Path, stage: Any, root_path: str) -> None:
        self.path, self.stage = path, stage
        self.meters_per_unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        self.up = up_axis(stage)
        self.fps = rate_from_float(stage.GetTimeCodesPerSecond())
        up_rotation = up_from_up(UpAxis.Y, self.up)
        self.up_rotation = None if up_rotation is None else np.array(up_rotation)
        self._root_path = root_path

    @property
    def unit(self) -> str:
        """Name of the stage's length unit."""
        return unit_name(self.meters_per_unit)

    @cached_property
    def source(self) -> PointSource:
        """Source of the prims with points."""
        return PointSource(self.path, self.stage)

    def to_y_up(self, points: FloatArray) -> FloatArray:
        """Return points ``(N, 3)`` rotated to Y up."""
        return (
            points if self.up_rotation is None else so3.rotate(self.up_rotation, points)
        )

    def matrix_to_y_up(self, matrix: FloatArray) -> FloatArray:
        """Return a column-vector transform ``(4, 4)`` rotated to Y up."""
        if self.up_rotation is not None:
            matrix[:3] = so3.to_matrix(self.up_rotation) @ matrix[:3]
        return matrix

    @cached_property
    def prims(self) -> list[VisiblePrim]:
        """Visible prims that no skeleton deforms."""
        skinned_paths = {
            query.GetPrim().GetPath()
            for skeleton in find_skeletons(self.stage)
            for query in skinned_prims(skeleton, UsdGeom.PointBased)
        }
        prototypes = {
            path
            for prim in all_prims(self.stage)
            if prim.IsA(UsdGeom.PointInstancer)
            for path in prototype_paths(prim)
        }
        root = self.stage.GetDefaultPrim()
        visible_prims = []
        for prim in self._visible_prims():
            kind, path = _prim_kind(prim), prim.GetPath()
            if not kind or path in skinned_paths or is_bone_mesh(prim):
                continue
            if any(path.HasPrefix(prototype) for prototype in prototypes):
                continue
            default_path = root.GetPath() if root else path.absoluteRootPath
            name = str(path.MakeRelativePath(default_path))
            visible_prims.append(VisiblePrim(self, prim, name, kind))
        return visible_prims

    def _visible_prims(self) -> Iterator[Any]:
        root_prim = self.stage.GetPrimAtPath(self._root_path)
        purposes = {UsdGeom.Tokens.default_, UsdGeom.Tokens.render}
        for prim in Usd.PrimRange(root_prim, Usd.TraverseInstanceProxies()):
            imageable = UsdGeom.Imageable(prim)
            if not imageable or imageable.ComputePurpose() not in purposes:
                continue
            attr = imageable.GetVisibilityAttr()
            is_constant = attr and not attr.ValueMightBeTimeVarying()
            if (
                is_constant
                and imageable.ComputeVisibility() == UsdGeom.Tokens.invisible
            ):
                continue
            yield prim

    def visibility(self, path: str, codes: FloatArray) -> BoolArray:
        """Return whether a prim is visible at each time code ``(F,)``."""
        return _is_visible(self.stage.GetPrimAtPath(path), codes)

    def mesh_visibility(self, path: str, codes: FloatArray) -> dict[str, BoolArray]:
        """Return visibility by mesh name for the meshes of a Skeleton."""
        skeleton = UsdSkel.Skeleton(self.stage.GetPrimAtPath(path))
        return {
            name: _is_visible(query.GetPrim(), codes)
            for name, query in bound_meshes(skeleton)
        }

    def is_animation(self) -> bool:
        """Return whether the stage has a joint animation but no Skeleton."""
        prims = all_prims(self.stage)
        return not find_skeletons(self.stage) and any(
            prim.IsA(UsdSkel.Animation) for prim in prims
        )

    @cached_property
    def bone_names(self) -> set[str]:
        """Names of meshes that visualize the bones of skeletons."""
        return {str(p.GetName()) for p in all_prims(self.stage) if is_bone_mesh(p)}

    def bound_colors(self, skeleton: str) -> dict[str, FloatArray]:
        """Return linear colors of skinned meshes by name.

        Colors are per point or one per mesh ``(N or 1, 3)``. Default colors that
        animtool authors are omitted.
        """
        prim = self.stage.GetPrimAtPath(skeleton)
        colors_by_name = {}
        code = self.stage.GetStartTimeCode()
        for name, query in bound_meshes(UsdSkel.Skeleton(prim)):
            colors = _display_colors(query.GetPrim(), code)
            is_default = len(colors) == 1 and np.isclose(
                colors, MESH_COLORS, atol=1e-6
            ).all(1)
            if len(colors) and not np.any(is_default):
                colors_by_name[name] = colors
        return colors_by_name

    def cameras(self) -> list[str]:
        """Return the prim paths of the stage's cameras."""
        return [
            str(prim.GetPath())
            for prim in all_prims(self.stage)
            if prim.IsA(UsdGeom.Camera) and not prim.IsAbstract()
        ]

    @property
    def authored_span(self) -> tuple[Fraction, Fraction] | None:
        """Authored start and end time codes of the stage; None if not authored."""
        if not self.stage.HasAuthoredTimeCodeRange():
            return None
        time_codes = self.stage.GetStartTimeCode(), self.stage.GetEndTimeCode()
        first_code, last_code = map(time_fraction, time_codes)
        return (first_code, last_code) if last_code > first_code else None

    @property
    def span(self) -> tuple[Fraction, Fraction]:
        """First and last time code: the authored range, or the range of the samples."""
        if self.stage.HasAuthoredTimeCodeRange():
            codes = [self.stage.GetStartTimeCode(), self.stage.GetEndTimeCode()]
        else:
            codes = [t for p in self.prims for t in PointReader(p.prim).codes] or [1.0]
        return time_fraction(min(codes)), time_fraction(max(codes))


def open_contents(path: Path, prim_path: str | None = None) -> StageContents:
    """Open the visible contents of a stage; ``prim_path`` limits them to a subtree."""
    record_input(path)
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        root_path = "/" if prim_path is None else search_root(stage, prim_path)
        return StageContents(path, stage, root_path)


def _is_visible(prim: Any, codes: FloatArray) -> BoolArray:
    """Return whether a prim is visible at each time code ``(F,)``."""
    imageable, invisible_token = UsdGeom.Imageable(prim), UsdGeom.Tokens.invisible
    if not any(
        UsdGeom.Imageable(ancestor).GetVisibilityAttr().ValueMightBeTimeVarying()
        for ancestor in self_and_ancestors(prim)
        if UsdGeom.Imageable(ancestor)
    ):
        return np.full(len(codes), imageable.ComputeVisibility() != invisible_token)
    times = [Usd.TimeCode(code) for code in codes.tolist()]
    return np.array([imageable.ComputeVisibility(t) != invisible_token for t in times])


def _prim_kind(prim: Any) -> str:
    if prim.IsA(UsdGeom.Mesh) or any(prim.IsA(schema) for schema in _IMPLICIT_SHAPES):
        return "mesh"
    if prim.IsA(UsdGeom.Curves):
        return "curves"
    if prim.IsA(UsdGeom.PointInstancer):
        return "copies"
    return "points" if prim.IsA(UsdGeom.Points) else ""


def _relative_transform(prim: Any, root: Any, unit: float) -> FloatArray:
    """Return a prim's transform relative to the parent of its prototype root [m]."""
    world = UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(0)
    # The prototype's own transform applies, but not those above it.
    parent_transform = UsdGeom.Imageable(root).ComputeParentToWorldTransform(0)
    matrix = np.array(world * parent_transform.GetInverse(), np.float64).T.copy()
    matrix[:3, 3] *= unit
    return matrix


# Order of coordinates that rotates an implicit shape from z to its axis.
_AXIS_ORDERS = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}


def _implicit_mesh(prim: Any) -> solids.Solid:
    """Return the mesh of an implicit shape in stage units."""

    def attribute_value(name: str) -> float:
        return float(prim.GetAttribute(name).Get(Usd.TimeCode.EarliestTime()))

    if prim.IsA(UsdGeom.Cube):
        return solids.box(attribute_value("size"))
    if prim.IsA(UsdGeom.Sphere):
        return solids.sphere(attribute_value("radius"))
    radius, height = attribute_value("radius"), attribute_value("height")
    if prim.IsA(UsdGeom.Capsule):
        points, counts, indices = solids.capsule(radius, height)
    elif prim.IsA(UsdGeom.Cone):
        points, counts, indices = solids.cylinder(radius, height, 0.0)
    else:
        points, counts, indices = solids.cylinder(radius, height)
    axis_order = _AXIS_ORDERS[str(prim.GetAttribute("axis").Get() or "Z")]
    return points[:, axis_order], counts, indices
