"""The meshes and strands that a Skeleton deforms, and their bind transforms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.rig.parts import (
    AttachKind,
    Attachment,
    Inbetween,
    LoadedArray,
    Mesh,
    Shape,
    Skin,
    Subdivision,
)
from animtool.rig.placed import placed_rig
from animtool.rig.placement import Placement, placement_matrix
from animtool.rig.surfaces import Strands, Surface, strands_of, surfaces_of
from animtool.usd.caches.reader import PointReader, transform_points
from animtool.usd.layers.faults import PrimLocation, bind_faults
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.meshes import SUBDIVISION
from animtool.usd.rigs.placement import DROP, local_placement
from animtool.usd.rigs.prims import (
    SkeletonRig,
    array_value,
    find_skeletons,
    integer_array,
    number_rows,
    numbers_of,
    open_stage,
    prim_below,
    skeleton_rig,
)
from animtool.usd.rigs.rest_pose import collapsed_bones
from animtool.usd.rigs.skinned import (
    float_rows,
    joint_names,
    prim_name,
    skinned_prims,
    unbound_notice,
    unique_name,
)
from animtool.usd.rigs.target import RigTarget
from animtool.usd.rigs.unskinned import unskinned_notice

_SKIN_METHODS = {"classicLinear": "linear", "dualQuaternion": "dual_quaternion"}


def read_meshes(
    skeleton: Any, rig: SkeletonRig, where: str
) -> tuple[tuple[Mesh, ...], tuple[Shape, ...], list[Fault]]:
    """Return meshes, shapes and notices of what is left out.

    Normals other than one per vertex are skipped (USD116), as are shapes without a
    target. Rigidly bound meshes get their influences at every vertex; unbound ones have
    the transform of their prim. Values are in the unit of the rig.
    """
    meshes: list[Mesh] = []
    shapes: list[Shape] = []
    notices = unbound_notice(skeleton, where)
    for name, query in bound_meshes(skeleton):
        at = PrimLocation.of(where, query.GetPrim())
        bind = _geom_bind(query, skeleton, at)
        meshes.append(_read_mesh(query, name, rig, at, bind, notices))
        count = len(meshes[-1].points.load())
        shape_names_ = {shape.name for shape in shapes}
        shapes += _read_shapes(query, name, count, where, shape_names_)
    return tuple(meshes), tuple(shapes), notices


def bound_meshes(skeleton: Any) -> list[tuple[str, Any]]:
    """Return the meshes a Skeleton deforms, as distinct names and queries."""
    used_names: set[str] = set()
    return [
        (unique_name(prim_name(query.GetPrim()), used_names), query)
        for query in skinned_prims(skeleton, UsdGeom.Mesh)
    ]


def bound_shapes(skeleton: Any) -> tuple[str, ...]:
    """Return the names of the blend shapes of a Skeleton's meshes."""
    names = (
        str(token)
        for _, query in bound_meshes(skeleton)
        if query.HasBlendShapes()
        for token in query.GetBlendShapeOrder() or ()
    )
    return tuple(dict.fromkeys(names))


def _geom_bind(query: Any, skeleton: Any, at: PrimLocation) -> tuple[float, ...] | None:
    """Return the bind transform of a mesh; None if it is the identity."""
    if query.HasJointInfluences():
        authored_bind = query.GetGeomBindTransform()
    else:
        cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        world = cache.GetLocalToWorldTransform(skeleton.GetPrim())
        local_to_world = cache.GetLocalToWorldTransform(query.GetPrim())
        authored_bind = (
            local_to_world
            if world == Gf.Matrix4d(1)
            else local_to_world * world.GetInverse()
        )
    matrix = np.array(authored_bind, np.float64).T
    if not np.isfinite(matrix).all():
        code = "USD235" if query.HasJointInfluences() else "USD017"
        at.fail(code, "its transform at bind time is not finite")
    return tuple(matrix.ravel().tolist()) if (matrix != np.eye(4)).any() else None


def _read_mesh(
    query: Any,
    name: str,
    rig: SkeletonRig,
    at: PrimLocation,
    bind: tuple[float, ...] | None,
    notices: list[Fault],
) -> Mesh:
    prim = query.GetPrim()
    mesh = UsdGeom.Mesh(prim)
    points = float_rows(PointReader(prim).attr, 3, at, "USD265")
    if not len(points):
        at.fail("USD017", "the mesh has no points")
    normals = None
    authored_normals = array_value(mesh.GetNormalsAttr())
    if (
        len(authored_normals) == len(points)
        and mesh.GetNormalsInterpolation() == "vertex"
    ):
        normals = float_rows(mesh.GetNormalsAttr(), 3, at)
    elif len(authored_normals):
        message = "normals that are not one per vertex are skipped"
        notices.append(at.fault("USD116", message, severity=Severity.NOTE))
    return Mesh(
        name,
        LoadedArray(points),
        LoadedArray(_padded_faces(mesh, len(points), at)),
        None if normals is None else LoadedArray(normals),
        bind,
        _read_skin(query, len(points), rig, at) if query.HasJointInfluences() else None,
        _read_subdivision(mesh, normals is not None),
    )


def _read_subdivision(mesh: Any, with_normals: bool) -> Subdivision | None:
    """Return the subdivision scheme; None for the default one."""
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
    by_scheme = {name: rule for rule, name in SUBDIVISION.items()}.get(scheme)
    default = Subdivision.NONE if with_normals else Subdivision.CATMULL_CLARK
    return None if by_scheme is default else by_scheme


def _padded_faces(mesh: Any, points: int, at: PrimLocation) -> FloatArray:
    """Return faces ``(N, K)``, padded with -1."""
    counts, indices = PointReader(mesh.GetPrim()).faces(None)
    if not len(counts):
        at.fail("USD017", "the mesh has no faces")
    if (counts < 3).any():
        at.fail("USD017", f"a face has {counts.min()} vertices; it needs at least 3")
    if counts.sum() != len(indices):
        message = f"{len(indices)} faceVertexIndices for faces of {counts.sum()} in all"
        at.fail("USD017", message)
    if len(indices) and not 0 <= indices.min() <= indices.max() < points:
        at.fail("USD018", f"a face refers to a vertex outside 0 to {points - 1}")
    width = int(counts.max(initial=3))
    is_corner = np.arange(width) < counts[:, None]
    faces = np.full(is_corner.shape, -1, np.int64)
    faces[is_corner] = indices
    return faces.astype(np.float64)


def _read_skin(query: Any, points: int, rig: SkeletonRig, at: PrimLocation) -> Skin:
    indices, weights = (
        numbers_of(primvar.ComputeFlattened(), 1)[:, 0]
        for primvar in (
            query.GetJointIndicesPrimvar(),
            query.GetJointWeightsPrimvar(),
        )
    )
    width = query.GetNumInfluencesPerComponent()
    rows = 1 if query.IsRigidlyDeformed() else points
    if len(indices) != rows * width or len(weights) != rows * width:
        message = (
            f"{len(indices)} jointIndices and {len(weights)} jointWeights for "
            f"{rows} x {width} influences"
        )
        at.fail("USD231", message)
    if not np.isfinite(weights).all():
        at.fail("USD233", "jointWeights contain a value that is not finite")
    names = joint_names(query, rig, at)
    if len(indices) and not 0 <= indices.min() <= indices.max() < len(names):
        at.fail("USD230", f"a jointIndex is not in 0 to {len(names) - 1}")
    shape = (points, width)
    method = str(query.GetSkinningMethod())
    return Skin(
        _SKIN_METHODS.get(method, "linear"),
        names,
        LoadedArray(np.broadcast_to(indices.reshape(rows, width), shape).copy()),
        LoadedArray(np.broadcast_to(weights.reshape(rows, width), shape).copy()),
    )


def _read_shapes(
    query: Any, mesh: str, points: int, where: str, known_shapes: set[str]
) -> list[Shape]:
    """Return the blend shapes of a mesh.

    A shape with the name of another mesh's is renamed, and combines that one: UsdSkel
    gives both the same weight.
    """
    if not query.HasBlendShapes():
        return []
    order = [str(token) for token in query.GetBlendShapeOrder() or ()]
    targets = query.GetBlendShapeTargetsRel().GetTargets()
    if len(order) != len(targets):
        message = f"{len(order)} blendShapes for {len(targets)} targets"
        PrimLocation.of(where, query.GetPrim()).fail("USD245", message)
    stage = query.GetPrim().GetStage()
    for target in targets:
        if not stage.GetPrimAtPath(target):
            message = f"a blendShapeTarget, {target}, does not exist"
            PrimLocation.of(where, query.GetPrim()).fail("USD208", message)
    shapes = []
    for token, target in zip(order, targets, strict=True):
        prim, is_shared = stage.GetPrimAtPath(target), token in known_shapes
        name = f"{mesh}_{token}" if is_shared else token
        shape = _read_shape(UsdSkel.BlendShape(prim), name, mesh, points, where)
        shapes.append(replace(shape, combine=(token,)) if is_shared else shape)
    return shapes


def _read_shape(shape: Any, name: str, mesh: str, points: int, where: str) -> Shape:
    at = PrimLocation.of(where, shape)
    deltas = float_rows(shape.GetOffsetsAttr(), 3, at, "USD243")
    vertices = integer_array(shape.GetPointIndicesAttr())
    rows = len(vertices) or points
    steps = shape.GetInbetweens()
    normal_attributes = [shape.GetNormalOffsetsAttr()]
    normal_attributes += [step.GetNormalOffsetsAttr() for step in steps]
    if not len(deltas) and any(
        attr and len(array_value(attr)) for attr in normal_attributes
    ):
        # The shape changes normals only.
        deltas = np.zeros((rows, 3))
    if len(deltas) != rows:
        at.fail("USD240", f"{len(deltas)} offsets for {rows} points")
    if len(vertices) and not 0 <= vertices.min() <= vertices.max() < points:
        at.fail("USD241", f"a pointIndex is not in 0 to {points - 1}")

    def rows_of(attr: Any) -> LoadedArray | None:
        if not attr or not attr.HasAuthoredValue():
            return None
        values = float_rows(attr, 3, at, "USD243")
        if len(values) != rows:
            at.fail(
                "USD242" if attr.GetName().endswith("normalOffsets") else "USD240",
                f"{attr.GetName()} has {counted(len(values), 'row')}, not {rows}",
            )
        return LoadedArray(values)

    inbetweens = []
    for step in steps:
        weight, normals = step.GetWeight(), rows_of(step.GetNormalOffsetsAttr())
        if normals is not None and not len(array_value(step.GetAttr())):
            offsets: LoadedArray | None = LoadedArray(np.zeros((rows, 3)))
        else:
            offsets = rows_of(step.GetAttr())
        if weight is None or offsets is None or not np.isfinite(weight):
            message = f"{step.GetAttr().GetName()} has no weight or no offsets"
            at.fail("USD240" if offsets is None else "USD244", message)
        inbetweens.append(Inbetween(float(weight), offsets, normals))
    return Shape(
        name,
        mesh,
        LoadedArray(deltas),
        rows_of(shape.GetNormalOffsetsAttr()),
        tuple(sorted(inbetweens, key=lambda step: step.at)),
        vertices=LoadedArray(vertices.astype(np.float64)) if len(vertices) else None,
    )


def read_strands(skeleton: Any, rig: SkeletonRig, where: str) -> tuple[Attachment, ...]:
    """Return linear curves bound to one joint each, as strands.

    Curves of other types or with different lengths, and curves bound to several joints,
    are skipped. Points are in the unit of the rig.
    """
    return tuple(entry for entry, _ in bound_strands(skeleton, rig, where))


def bound_strands(
    skeleton: Any, rig: SkeletonRig, where: str
) -> list[tuple[Attachment, Any]]:
    """Return the strands of `read_strands`, each with its prim."""
    strands: list[tuple[Attachment, Any]] = []
    used_names: set[str] = set()
    for query in skinned_prims(skeleton, UsdGeom.BasisCurves):
        source = query.GetPrim()
        at = PrimLocation.of(where, source)
        joint = _carrier_joint(query, rig, at)
        points = _strand_points(UsdGeom.BasisCurves(source), query, at)
        if joint is not None and points is not None:
            name = unique_name(prim_name(source), used_names)
            kind, array = AttachKind.STRANDS.value, LoadedArray(points)
            strands.append((Attachment(name, kind, (joint,), points=array), source))
    return strands


def _carrier_joint(query: Any, rig: SkeletonRig, at: PrimLocation) -> str | None:
    """Return the single joint a prim is rigidly bound to; None if there are others."""
    if not query.HasJointInfluences() or not query.IsRigidlyDeformed():
        return None
    indices = integer_array(
        query.GetJointIndicesPrimvar().GetAttr(), Usd.TimeCode.Default()
    )
    weights = number_rows(
        query.GetJointWeightsPrimvar().GetAttr(), 1, Usd.TimeCode.Default()
    )
    if len(indices) != 1 or len(weights) != 1:
        return None
    names = joint_names(query, rig, at)
    if not 0 <= indices[0] < len(names):
        message = f"a jointIndex is not in 0 to {len(names) - 1}"
        at.fail("USD230", message)
    return names[int(indices[0])]


def _strand_points(curves: Any, query: Any, at: PrimLocation) -> FloatArray | None:
    """Return bind points ``(S, K, 3)``; None if the curves are not strands."""
    counts = integer_array(curves.GetCurveVertexCountsAttr())
    if curves.GetTypeAttr().Get() != UsdGeom.Tokens.linear or not len(counts):
        return None
    values = float_rows(PointReader(curves.GetPrim()).attr, 3, at, "USD265")
    if counts.min() < 2 or (counts != counts[0]).any() or counts.sum() != len(values):
        return None
    matrix = np.array(query.GetGeomBindTransform(), np.float64)
    if not np.isfinite(matrix).all():
        at.fail("USD235", "geomBindTransform is not finite")
    return transform_points(values, matrix).reshape(len(counts), -1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class StageMeshes:
    """Meshes and strands of a Skeleton."""

    surfaces: tuple[Surface, ...]  # the meshes [m]
    strands: tuple[Strands, ...]  # curves bound to single joints [m]
    # World transforms of the Skeleton's J joints at bind time, scale and shear
    # included, for column vectors ``(J, 4, 4)`` [m].
    bind: FloatArray
    up: UpAxis  # up axis of meshes and strands
    notices: list[Fault]  # warnings about skipped contents


def source_meshes(
    path: Path, prim_path: str | None, placement: str | None = None
) -> StageMeshes:
    """Return the meshes of the character that a USD file is read as.

    ``placement`` is as in `animtool.usd.takes.read.read_usd`.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        skeletons = find_skeletons(stage, prim_below(stage, prim_path))
        if not skeletons:
            return StageMeshes((), (), np.zeros((0, 4, 4)), UpAxis.Y, [])
        rig = skeleton_rig(skeletons[0], path)
        where = local_placement(skeletons[0].GetPrim(), rig.rig)
        at_rest = where.sized if placement == DROP else where.rest
        meshes = _stage_meshes(skeletons[0], rig, path, at_rest)
        unskinned = unskinned_notice(skeletons[0], str(path), placement)
        return replace(meshes, notices=meshes.notices + unskinned)


def target_meshes(target: RigTarget) -> StageMeshes:
    """Return the meshes of a rig layer."""
    with usd_errors(target.path), without_usd_warnings():
        prim = target.stage.GetPrimAtPath(target.on_stage(target.paths.skeleton))
        meshes = _stage_meshes(UsdSkel.Skeleton(prim), target.skeleton, target.path)
        new_notices = [
            notice for notice in meshes.notices if notice not in target.notices
        ]
        return replace(meshes, notices=new_notices)


def _stage_meshes(
    skeleton: Any,
    skeleton_rig: SkeletonRig,
    path: Path,
    placement: Placement | None = None,
) -> StageMeshes:
    meshes, shapes, notices = read_meshes(skeleton, skeleton_rig, str(path))
    strands = read_strands(skeleton, skeleton_rig, str(path))
    rig = replace(skeleton_rig.rig, meshes=meshes, shapes=shapes, attach=strands)
    if not meshes and not strands:
        return StageMeshes((), (), np.zeros((0, 4, 4)), rig.up, notices)
    location = PrimLocation.of(path, skeleton)
    location.refuse(bind_faults(skeleton, skeleton_rig.tokens, skins=True))
    warnings = collapsed_bones(skeleton, skeleton_rig.tokens)
    notices += [replace(fault, path=str(path)) for fault in warnings]
    attr = skeleton.GetBindTransformsAttr()
    bind = number_rows(attr, 16).reshape(-1, 4, 4).swapaxes(-1, -2).copy()
    bind[:, :3, 3] *= rig.meters_per_unit
    if placement is not None and not placement.is_identity:
        rig = placed_rig(rig, placement)
        bind = placement_matrix(placement) @ bind
        # Joints cannot store this scale: it is in their lengths.
        bind[:, :3, :3] /= placement.size
    return StageMeshes(surfaces_of(rig), strands_of(rig), bind, rig.up, notices)
