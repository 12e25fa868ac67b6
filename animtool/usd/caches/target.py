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
from animtool.usd.layers.sdf import attribute, author_order, prim
from animtool.usd.rigs.mesh_read import bound_meshes, bound_strands
from animtool.usd.rigs.skinned import MAX_NAMED
from animtool.usd.rigs.target import RigTarget, compose_check

# A transform between mesh and skeleton nearer to none than this is rounding.
SAME = 1e-9


@dataclass(frozen=True, slots=True)
class TargetMesh:
    """A mesh or strands of a rig layer."""

    name: str  # as the rig names it
    path: str  # its prim, as a layer over the rig names it
    space: PointSpace  # where its points are, in the rig's unit
    normals: bool  # whether it has normals that a cache can replace
    blocked: tuple[str, ...]  # attributes whose values do not hold for deformed points


@dataclass(frozen=True, slots=True)
class CacheTarget:
    """A rig whose meshes and strands a cache animates instead of UsdSkel."""

    rig: RigTarget  # the rig's stage
    meshes: tuple[TargetMesh, ...]  # those that the cache has points of
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
        # As UsdSkel.BakeSkinning does it: outside a SkelRoot nothing is skinned.
        root = prim(layer, self.rig.paths.root, "Xform", over=True)
        if self.rig.moves:
            author_order(root, *self.rig.operations)
        for mesh in self.prims:
            spec = prim(layer, mesh.path, over=True)
            blocked = mesh.blocked
            if mesh.normals and not normals:
                blocked += ("normals",)
            for name in blocked:
                kind = Sdf.ValueTypeNames.Normal3fArray
                attribute(spec, name, kind, Sdf.ValueBlock())

    def check(self, layer: Any, *, points: bool = True) -> None:
        """Compose the layer with its rig, and verify that its points win.

        points: whether it holds the points itself.
        """
        stage = compose_check(self.rig, layer)
        root = stage.GetPrimAtPath(self.rig.paths.root)
        wrong = []
        if root.IsA(UsdSkel.Root):
            wrong.append(str(root.GetPath()))
        for mesh in self.prims:
            prim = stage.GetPrimAtPath(mesh.path)
            if prim.IsInstanceProxy():
                wrong.append(mesh.path)
            if not points:
                continue
            attr = prim.GetAttribute("points")
            stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime())
            if mesh.path not in wrong and (not stack or stack[0].layer != layer):
                wrong.append(mesh.path)
        if wrong:
            message = (
                f"the rig's own opinions are stronger than the cache at {listed(wrong)}"
            )
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
    skinned = {name: query.GetPrim() for name, query in bound_meshes(skeleton)}
    faults, meshes, strands = [], [], []
    for name, count in counts.items():
        if name not in skinned:
            continue
        mesh = UsdGeom.Mesh(skinned[name])
        faults += _misfits(mesh, name, count, rig) + _moving(mesh, skeleton, rig)
        meshes.append(_mesh(mesh, name, skeleton, rig))
    matched = {
        entry.name: (entry, source)
        for entry, source in bound_strands(skeleton, rig.skeleton, str(rig.path))
    }
    for name, shape in curves.items():
        if name not in matched:
            continue
        entry, source = matched[name]
        basis_curves = UsdGeom.BasisCurves(source)
        faults += _uneven(basis_curves, entry, shape, rig) + _moving(
            basis_curves, skeleton, rig
        )
        strands.append(_strands(basis_curves, name, skeleton, rig))
    if faults:
        raise FormatError(faults)
    missing = [name for name in counts if name not in skinned]
    missing += [name for name in curves if name not in matched]
    what = "meshes or strands of the take are not in the rig layer"
    notices = _notice("USD141", missing, what, "they are skipped", rig.path)
    deformed = {skinned[mesh.name].GetPath() for mesh in meshes}
    deformed |= {matched[entry.name][1].GetPath() for entry in strands}
    notices += _left_notice(root, deformed, rig.path)
    notices += _normals_notice([*meshes, *strands], rig.path)
    return CacheTarget(rig, tuple(meshes), tuple(strands), tuple(notices))


def _misfits(mesh: Any, name: str, count: int, rig: RigTarget) -> list[Fault]:
    points = PointReader(mesh.GetPrim()).count()
    if points == count:
        return []
    message = f"mesh {name!r} has {points} points here, but {count} in the take's rig"
    hint = "the cache would not match its faces"
    return [PrimLocation.of(rig.path, mesh).fault("USD041", message, hint)]


def _uneven(
    curves: Any, entry: Attachment, shape: tuple[int, ...], rig: RigTarget
) -> list[Fault]:
    assert entry.points is not None
    here = entry.points.load().shape[:2]
    if here == shape:
        return []
    message = f"{entry.name!r} has {here[0]} strands of {here[1]} points here, but "
    message += f"{shape[0]} of {shape[1]} in the take's rig"
    hint = "the cache would not match its curves"
    return [PrimLocation.of(rig.path, curves).fault("USD041", message, hint)]


def _moving(mesh: Any, skeleton: Any, rig: RigTarget) -> list[Fault]:
    at, faults = PrimLocation.of(rig.path, mesh), []
    between = mesh.GetPrim()
    while between.GetPath().HasPrefix(Sdf.Path("/")) and between:
        if skeleton.GetPath().HasPrefix(between.GetPath()):
            break
        xform = UsdGeom.Xformable(between)
        if xform and xform.TransformMightBeTimeVarying():
            message = f"{between.GetPath()} is animated below the skeleton"
            faults.append(at.fault("USD043", message))
        between = between.GetParent()
    return faults


def _mesh(mesh: Any, name: str, skeleton: Any, rig: RigTarget) -> TargetMesh:
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    skinned = binding.GetJointIndicesPrimvar().HasAuthoredValue()
    normals = mesh.GetNormalsAttr().HasAuthoredValue()
    followed = normals and mesh.GetNormalsInterpolation() == UsdGeom.Tokens.vertex
    return TargetMesh(
        name,
        rig.on_layer(mesh.GetPath()),
        PointSpace(_placement(mesh, skeleton) if skinned else None),
        followed,
        _blocked(mesh, followed=followed),
    )


def _strands(curves: Any, name: str, skeleton: Any, rig: RigTarget) -> TargetMesh:
    widths = curves.GetWidthsAttr().Get(Usd.TimeCode.EarliestTime()) or (0.0,)
    return TargetMesh(
        name,
        rig.on_layer(curves.GetPath()),
        PointSpace(_placement(curves, skeleton), max(widths) / 2),
        False,
        _blocked(curves, followed=False),
    )


def _placement(mesh: Any, skeleton: Any) -> FloatArray | None:
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    world = cache.GetLocalToWorldTransform(skeleton.GetPrim())
    mesh_world = cache.GetLocalToWorldTransform(mesh.GetPrim())
    placement = np.array(world * mesh_world.GetInverse(), np.float64).T
    return None if np.abs(placement - np.eye(4)).max() <= SAME else placement


def _blocked(mesh: Any, *, followed: bool) -> tuple[str, ...]:
    """Return authored normals that would not fit the animated points."""
    blocked = []
    if mesh.GetNormalsAttr().HasAuthoredValue() and not followed:
        blocked.append("normals")
    primvar = mesh.GetPrim().GetAttribute("primvars:normals")
    if primvar and primvar.HasAuthoredValue():
        blocked.append("primvars:normals")
    return tuple(blocked)


def _notice(
    code: str, names: Sequence[str], what: str, hint: str, path: Path
) -> list[Fault]:
    """Return a warning with counts and names; None if there are no names."""
    if not names:
        return []
    message = f"{len(names)} {what}: {listed(names, MAX_NAMED)}"
    return [Fault(code, message, str(path), (), hint, Severity.WARNING)]


def _left_notice(root: Any, deformed: set[Any], path: Path) -> list[Fault]:
    """Report meshes that UsdSkel animated and the cache leaves static."""
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(root), Usd.TraverseInstanceProxies())
    bindings = cache.ComputeSkelBindings(
        UsdSkel.Root(root), Usd.TraverseInstanceProxies()
    )
    left = [
        str(query.GetPrim().GetPath())
        for binding in bindings
        for query in binding.GetSkinningTargets()
        if query.GetPrim().GetPath() not in deformed
    ]
    hint = "the SkelRoot becomes an Xform, but the cache does not cover their points"
    return _notice("USD142", left, "prims stop following their skeleton", hint, path)


def _normals_notice(meshes: Sequence[TargetMesh], path: Path) -> list[Fault]:
    blocked = [mesh.name for mesh in meshes if mesh.blocked]
    if not blocked:
        return []
    message = f"normals of {listed(blocked, MAX_NAMED)} are not one per vertex"
    hint = "they are blocked, as they would not match deformed points"
    return [Fault("USD143", message, str(path), (), hint, Severity.NOTE)]
