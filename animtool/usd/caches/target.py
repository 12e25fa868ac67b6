"""Finds the meshes and strands of a rig layer that a point cache overrides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, OutputError, Severity, listed
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.rig.parts import Attachment
from animtool.usd.caches.reader import PointReader
from animtool.usd.caches.writer import PointSpace
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import attribute_spec, author_xform_order, prim_spec
from animtool.usd.rigs.mesh_read import bound_meshes, bound_strands
from animtool.usd.rigs.skinned import MAX_LISTED_PRIMS, skeleton_bindings
from animtool.usd.rigs.target import RigTarget, compose_over_rig

# A transform between mesh and skeleton closer to identity than this is rounding.
IDENTITY_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class TargetMesh:
    """A mesh or strands of a rig layer."""

    name: str  # name in the rig
    path: str  # prim path in a layer over the rig
    space: PointSpace  # space of its points, in the rig's unit
    has_normals: bool  # whether it has normals that a cache can replace
    # Attributes that are invalid for deformed points.
    blocked_attributes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CacheTarget:
    """A rig whose meshes and strands a cache animates instead of UsdSkel."""

    rig: RigTarget  # the rig's stage
    meshes: tuple[TargetMesh, ...]  # meshes with points in the cache
    strands: tuple[TargetMesh, ...]
    notices: tuple[Fault, ...]  # warnings and notes

    @property
    def prims(self) -> tuple[TargetMesh, ...]:
        """The meshes of the target, then the strands."""
        return self.meshes + self.strands

    @property
    def unit(self) -> float:
        """Length unit of the stage [m]."""
        return self.rig.unit

    @property
    def up(self) -> UpAxis:
        """Up axis of the stage."""
        return self.rig.up

    def author(self, layer: Any, *, with_normals: bool) -> None:
        """Write overs on the SkelRoot, the meshes and the strands."""
        # As in UsdSkel.BakeSkinning: prims outside a SkelRoot are not skinned.
        root = prim_spec(layer, self.rig.paths.root, "Xform", is_over=True)
        if self.rig.has_root_motion:
            author_xform_order(root, *self.rig.placing_ops)
        for mesh in self.prims:
            spec = prim_spec(layer, mesh.path, is_over=True)
            blocked_names = mesh.blocked_attributes
            if mesh.has_normals and not with_normals:
                blocked_names += ("normals",)
            for name in blocked_names:
                value_type = Sdf.ValueTypeNames.Normal3fArray
                attribute_spec(spec, name, value_type, Sdf.ValueBlock())

    def check(self, layer: Any, *, has_points: bool = True) -> None:
        """Check that the layer's points are the strongest opinions over its rig.

        ``has_points`` says whether the layer itself has the points.
        """
        stage = compose_over_rig(self.rig, layer)
        root = stage.GetPrimAtPath(self.rig.paths.root)
        overridden_paths = []
        if root.IsA(UsdSkel.Root):
            overridden_paths.append(str(root.GetPath()))
        for mesh in self.prims:
            prim = stage.GetPrimAtPath(mesh.path)
            if prim.IsInstanceProxy():
                overridden_paths.append(mesh.path)
            if not has_points:
                continue
            attr = prim.GetAttribute("points")
            stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime())
            if mesh.path not in overridden_paths and (
                not stack or stack[0].layer != layer
            ):
                overridden_paths.append(mesh.path)
        if overridden_paths:
            message = "the rig's own opinions are stronger than the cache at "
            message += listed(overridden_paths)
            hint = "a layer cannot reach into instances"
            location = str(self.rig.path)
            raise OutputError(Fault("USD042", message, location, (), hint))


def open_cache_target(
    rig: RigTarget,
    point_counts: Mapping[str, int],
    curve_shapes: Mapping[str, tuple[int, ...]],
) -> CacheTarget:
    """Return the rig's meshes and strands that a cache overrides, matched by name."""
    skeleton_prim = rig.stage.GetPrimAtPath(rig.to_stage_path(rig.paths.skeleton))
    skeleton = UsdSkel.Skeleton(skeleton_prim)
    root = UsdSkel.Root.Find(skeleton_prim).GetPrim()
    prims_by_name = {name: query.GetPrim() for name, query in bound_meshes(skeleton)}
    faults, meshes, strands = [], [], []
    for name, count in point_counts.items():
        if name not in prims_by_name:
            continue
        mesh = UsdGeom.Mesh(prims_by_name[name])
        faults += _mesh_mismatches(mesh, name, count, rig)
        faults += _animated_ancestors(mesh, skeleton, rig)
        meshes.append(_target_mesh(mesh, name, skeleton, rig))
    attachments = {
        attachment.name: (attachment, curves_prim)
        for attachment, curves_prim in bound_strands(
            skeleton, rig.skeleton, str(rig.path)
        )
    }
    for name, curve_shape in curve_shapes.items():
        if name not in attachments:
            continue
        attachment, curves_prim = attachments[name]
        curves = UsdGeom.BasisCurves(curves_prim)
        faults += _curve_mismatch(curves, attachment, curve_shape, rig)
        faults += _animated_ancestors(curves, skeleton, rig)
        strands.append(_target_strands(curves, name, skeleton, rig))
    if faults:
        raise FormatError(faults)
    unknown_names = [name for name in point_counts if name not in prims_by_name]
    unknown_names += [name for name in curve_shapes if name not in attachments]
    text = "meshes or strands of the take are not in the rig layer"
    notices = _count_notice("USD141", unknown_names, text, "they are skipped", rig.path)
    deformed_paths = {prims_by_name[mesh.name].GetPath() for mesh in meshes}
    deformed_paths |= {
        attachments[attachment.name][1].GetPath() for attachment in strands
    }
    notices += _static_mesh_notice(root, deformed_paths, rig.path)
    notices += _normals_notice([*meshes, *strands], rig.path)
    return CacheTarget(rig, tuple(meshes), tuple(strands), tuple(notices))


def _mesh_mismatches(mesh: Any, name: str, count: int, rig: RigTarget) -> list[Fault]:
    rig_count = PointReader(mesh.GetPrim()).point_count()
    if rig_count == count:
        return []
    message = (
        f"mesh {name!r} has {rig_count} points here, but {count} in the take's rig"
    )
    hint = "the cache would not match its faces"
    return [PrimLocation.from_prim(rig.path, mesh).fault("USD041", message, hint)]


def _curve_mismatch(
    curves: Any, attachment: Attachment, take_shape: tuple[int, ...], rig: RigTarget
) -> list[Fault]:
    assert attachment.points is not None
    rig_shape = attachment.points.load().shape[:2]
    if rig_shape == take_shape:
        return []
    message = (
        f"{attachment.name!r} has {rig_shape[0]} strands of {rig_shape[1]} points "
        f"here, but {take_shape[0]} of {take_shape[1]} in the take's rig"
    )
    hint = "the cache would not match its curves"
    return [PrimLocation.from_prim(rig.path, curves).fault("USD041", message, hint)]


def _animated_ancestors(mesh: Any, skeleton: Any, rig: RigTarget) -> list[Fault]:
    location, faults = PrimLocation.from_prim(rig.path, mesh), []
    ancestor = mesh.GetPrim()
    while ancestor.GetPath().HasPrefix(Sdf.Path("/")) and ancestor:
        if skeleton.GetPath().HasPrefix(ancestor.GetPath()):
            break
        xform = UsdGeom.Xformable(ancestor)
        if xform and xform.TransformMightBeTimeVarying():
            message = f"{ancestor.GetPath()} is animated below the skeleton"
            faults.append(location.fault("USD043", message))
        ancestor = ancestor.GetParent()
    return faults


def _target_mesh(mesh: Any, name: str, skeleton: Any, rig: RigTarget) -> TargetMesh:
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    is_skinned = binding.GetJointIndicesPrimvar().HasAuthoredValue()
    has_normals = mesh.GetNormalsAttr().HasAuthoredValue()
    has_vertex_normals = (
        has_normals and mesh.GetNormalsInterpolation() == UsdGeom.Tokens.vertex
    )
    return TargetMesh(
        name,
        rig.to_layer_path(mesh.GetPath()),
        PointSpace(_space_matrix(mesh, skeleton) if is_skinned else None),
        has_vertex_normals,
        _unusable_normals(mesh, has_vertex_normals=has_vertex_normals),
    )


def _target_strands(
    curves: Any, name: str, skeleton: Any, rig: RigTarget
) -> TargetMesh:
    widths = curves.GetWidthsAttr().Get(Usd.TimeCode.EarliestTime()) or (0.0,)
    return TargetMesh(
        name,
        rig.to_layer_path(curves.GetPath()),
        PointSpace(_space_matrix(curves, skeleton), max(widths) / 2),
        False,
        _unusable_normals(curves, has_vertex_normals=False),
    )


def _space_matrix(mesh: Any, skeleton: Any) -> FloatArray | None:
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    skeleton_world = cache.GetLocalToWorldTransform(skeleton.GetPrim())
    mesh_world = cache.GetLocalToWorldTransform(mesh.GetPrim())
    skeleton_to_mesh = np.array(skeleton_world * mesh_world.GetInverse(), np.float64).T
    return (
        None
        if np.abs(skeleton_to_mesh - np.eye(4)).max() <= IDENTITY_TOLERANCE
        else skeleton_to_mesh
    )


def _unusable_normals(mesh: Any, *, has_vertex_normals: bool) -> tuple[str, ...]:
    """Return the names of authored normals that do not fit animated points."""
    names = []
    if mesh.GetNormalsAttr().HasAuthoredValue() and not has_vertex_normals:
        names.append("normals")
    primvar = mesh.GetPrim().GetAttribute("primvars:normals")
    if primvar and primvar.HasAuthoredValue():
        names.append("primvars:normals")
    return tuple(names)


def _count_notice(
    code: str, names: Sequence[str], text: str, hint: str, path: Path
) -> list[Fault]:
    """Return a warning that counts and lists prim names; empty if there are none."""
    if not names:
        return []
    message = f"{len(names)} {text}: {listed(names, MAX_LISTED_PRIMS)}"
    return [Fault(code, message, str(path), (), hint, Severity.WARNING)]


def _static_mesh_notice(root: Any, deformed_paths: set[Any], path: Path) -> list[Fault]:
    """Return a warning if the cache leaves meshes static that UsdSkel animated."""
    static_meshes = [
        str(query.GetPrim().GetPath())
        for binding in skeleton_bindings(UsdSkel.Root(root))
        for query in binding.GetSkinningTargets()
        if query.GetPrim().GetPath() not in deformed_paths
    ]
    hint = "the SkelRoot becomes an Xform, but the cache does not cover their points"
    return _count_notice(
        "USD142", static_meshes, "prims stop following their skeleton", hint, path
    )


def _normals_notice(meshes: Sequence[TargetMesh], path: Path) -> list[Fault]:
    blocked_names = [mesh.name for mesh in meshes if mesh.blocked_attributes]
    if not blocked_names:
        return []
    message = (
        f"normals of {listed(blocked_names, MAX_LISTED_PRIMS)} are not one per vertex"
    )
    hint = "they are blocked, as they would not match deformed points"
    return [Fault("USD143", message, str(path), (), hint, Severity.NOTE)]
