"""The meshes and strands of a rig layer that a point cache overrides."""

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
from animtool.usd.rigs.skinned import MAX_LISTED_PRIMS
from animtool.usd.rigs.target import RigTarget, compose_over_rig

# A transform between mesh and skeleton closer to identity than this is rounding.
IDENTITY_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class TargetMesh:
    """A mesh or strands of a rig layer."""

    name: str  # name in the rig
    path: str  # prim path in a layer over the rig
    space: PointSpace  # space of its points, in the rig's unit
    normals: bool  # whether it has normals that a cache can replace
    blocked_attributes: tuple[
        str, ...
    ]  # attributes that are invalid for deformed points


@dataclass(frozen=True, slots=True)
class CacheTarget:
    """A rig whose meshes and strands a cache animates instead of UsdSkel."""

    rig: RigTarget  # the rig's stage
    meshes: tuple[TargetMesh, ...]  # meshes with points in the cache
    strands: tuple[TargetMesh, ...]
    notices: tuple[Fault, ...]  # warnings and notes

    @property
    def prims(self) -> tuple[TargetMesh, ...]:
        """The meshes, then the strands."""
        return self.meshes + self.strands

    @property
    def unit(self) -> float:
        """Length unit of the stage [m]."""
        return self.rig.unit

    @property
    def up(self) -> UpAxis:
        """Up axis of the stage."""
        return self.rig.up

    def author(self, layer: Any, *, normals: bool) -> None:
        """Write overs on the SkelRoot, the meshes and the strands."""
        # As in UsdSkel.BakeSkinning: prims outside a SkelRoot are not skinned.
        root = prim_spec(layer, self.rig.paths.root, "Xform", over=True)
        if self.rig.moves:
            author_xform_order(root, *self.rig.operations)
        for mesh in self.prims:
            spec = prim_spec(layer, mesh.path, over=True)
            blocked = mesh.blocked_attributes
            if mesh.normals and not normals:
                blocked += ("normals",)
            for name in blocked:
                kind = Sdf.ValueTypeNames.Normal3fArray
                attribute_spec(spec, name, kind, Sdf.ValueBlock())

    def check(self, layer: Any, *, points: bool = True) -> None:
        """Compose the layer with its rig, and verify that its points are the strongest.

        ``points`` says whether the layer itself has the points.
        """
        stage = compose_over_rig(self.rig, layer)
        root = stage.GetPrimAtPath(self.rig.paths.root)
        hidden_meshes = []
        if root.IsA(UsdSkel.Root):
            hidden_meshes.append(str(root.GetPath()))
        for mesh in self.prims:
            prim = stage.GetPrimAtPath(mesh.path)
            if prim.IsInstanceProxy():
                hidden_meshes.append(mesh.path)
            if not points:
                continue
            attr = prim.GetAttribute("points")
            stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime())
            if mesh.path not in hidden_meshes and (
                not stack or stack[0].layer != layer
            ):
                hidden_meshes.append(mesh.path)
        if hidden_meshes:
            message = "the rig's own opinions are stronger than the cache at "
            message += listed(hidden_meshes)
            hint = "a layer cannot reach into instances"
            where = str(self.rig.path)
            raise OutputError(Fault("USD042", message, where, (), hint))


def open_cache_target(
    rig: RigTarget, counts: Mapping[str, int], curves: Mapping[str, tuple[int, ...]]
) -> CacheTarget:
    """Match the meshes and strands of a rig by the names of a cache."""
    at = rig.stage.GetPrimAtPath(rig.on_stage(rig.paths.skeleton))
    skeleton = UsdSkel.Skeleton(at)
    root = UsdSkel.Root.Find(at).GetPrim()
    bound = {name: query.GetPrim() for name, query in bound_meshes(skeleton)}
    faults, meshes, strands = [], [], []
    for name, count in counts.items():
        if name not in bound:
            continue
        mesh = UsdGeom.Mesh(bound[name])
        faults += _mesh_mismatches(mesh, name, count, rig) + _animated_ancestors(
            mesh, skeleton, rig
        )
        meshes.append(_target_mesh(mesh, name, skeleton, rig))
    attachments = {
        entry.name: (entry, source)
        for entry, source in bound_strands(skeleton, rig.skeleton, str(rig.path))
    }
    for name, shape in curves.items():
        if name not in attachments:
            continue
        entry, source = attachments[name]
        basis_curves = UsdGeom.BasisCurves(source)
        faults += _curve_mismatch(
            basis_curves, entry, shape, rig
        ) + _animated_ancestors(basis_curves, skeleton, rig)
        strands.append(_target_strands(basis_curves, name, skeleton, rig))
    if faults:
        raise FormatError(faults)
    unknown = [name for name in counts if name not in bound]
    unknown += [name for name in curves if name not in attachments]
    subject = "meshes or strands of the take are not in the rig layer"
    notices = _count_notice("USD141", unknown, subject, "they are skipped", rig.path)
    deformed_paths = {bound[mesh.name].GetPath() for mesh in meshes}
    deformed_paths |= {attachments[entry.name][1].GetPath() for entry in strands}
    notices += _static_mesh_notice(root, deformed_paths, rig.path)
    notices += _normals_notice([*meshes, *strands], rig.path)
    return CacheTarget(rig, tuple(meshes), tuple(strands), tuple(notices))


def _mesh_mismatches(mesh: Any, name: str, count: int, rig: RigTarget) -> list[Fault]:
    points = PointReader(mesh.GetPrim()).count()
    if points == count:
        return []
    message = f"mesh {name!r} has {points} points here, but {count} in the take's rig"
    hint = "the cache would not match its faces"
    return [PrimLocation.of(rig.path, mesh).fault("USD041", message, hint)]


def _curve_mismatch(
    curves: Any, entry: Attachment, shape: tuple[int, ...], rig: RigTarget
) -> list[Fault]:
    assert entry.points is not None
    rig_shape = entry.points.load().shape[:2]
    if rig_shape == shape:
        return []
    message = (
        f"{entry.name!r} has {rig_shape[0]} strands of {rig_shape[1]} points here, but "
    )
    message += f"{shape[0]} of {shape[1]} in the take's rig"
    hint = "the cache would not match its curves"
    return [PrimLocation.of(rig.path, curves).fault("USD041", message, hint)]


def _animated_ancestors(mesh: Any, skeleton: Any, rig: RigTarget) -> list[Fault]:
    at, faults = PrimLocation.of(rig.path, mesh), []
    ancestor = mesh.GetPrim()
    while ancestor.GetPath().HasPrefix(Sdf.Path("/")) and ancestor:
        if skeleton.GetPath().HasPrefix(ancestor.GetPath()):
            break
        xform = UsdGeom.Xformable(ancestor)
        if xform and xform.TransformMightBeTimeVarying():
            message = f"{ancestor.GetPath()} is animated below the skeleton"
            faults.append(at.fault("USD043", message))
        ancestor = ancestor.GetParent()
    return faults


def _target_mesh(mesh: Any, name: str, skeleton: Any, rig: RigTarget) -> TargetMesh:
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    is_skinned = binding.GetJointIndicesPrimvar().HasAuthoredValue()
    normals = mesh.GetNormalsAttr().HasAuthoredValue()
    normals_follow = normals and mesh.GetNormalsInterpolation() == UsdGeom.Tokens.vertex
    return TargetMesh(
        name,
        rig.on_layer(mesh.GetPath()),
        PointSpace(_space_matrix(mesh, skeleton) if is_skinned else None),
        normals_follow,
        _unusable_normals(mesh, normals_follow=normals_follow),
    )


def _target_strands(
    curves: Any, name: str, skeleton: Any, rig: RigTarget
) -> TargetMesh:
    widths = curves.GetWidthsAttr().Get(Usd.TimeCode.EarliestTime()) or (0.0,)
    return TargetMesh(
        name,
        rig.on_layer(curves.GetPath()),
        PointSpace(_space_matrix(curves, skeleton), max(widths) / 2),
        False,
        _unusable_normals(curves, normals_follow=False),
    )


def _space_matrix(mesh: Any, skeleton: Any) -> FloatArray | None:
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    world = cache.GetLocalToWorldTransform(skeleton.GetPrim())
    mesh_world = cache.GetLocalToWorldTransform(mesh.GetPrim())
    placement = np.array(world * mesh_world.GetInverse(), np.float64).T
    return (
        None if np.abs(placement - np.eye(4)).max() <= IDENTITY_TOLERANCE else placement
    )


def _unusable_normals(mesh: Any, *, normals_follow: bool) -> tuple[str, ...]:
    """Return authored normals that would not fit the animated points."""
    names = []
    if mesh.GetNormalsAttr().HasAuthoredValue() and not normals_follow:
        names.append("normals")
    primvar = mesh.GetPrim().GetAttribute("primvars:normals")
    if primvar and primvar.HasAuthoredValue():
        names.append("primvars:normals")
    return tuple(names)


def _count_notice(
    code: str, names: Sequence[str], text: str, hint: str, path: Path
) -> list[Fault]:
    """Return a warning with counts and names; empty without names."""
    if not names:
        return []
    message = f"{len(names)} {text}: {listed(names, MAX_LISTED_PRIMS)}"
    return [Fault(code, message, str(path), (), hint, Severity.WARNING)]


def _static_mesh_notice(root: Any, deformed: set[Any], path: Path) -> list[Fault]:
    """Report meshes that UsdSkel animated and the cache leaves static."""
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(root), Usd.TraverseInstanceProxies())
    bindings = cache.ComputeSkelBindings(
        UsdSkel.Root(root), Usd.TraverseInstanceProxies()
    )
    static_meshes = [
        str(query.GetPrim().GetPath())
        for binding in bindings
        for query in binding.GetSkinningTargets()
        if query.GetPrim().GetPath() not in deformed
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
