"""Reads the meshes and strands that a Skeleton deforms, with bind transforms."""

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
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement, placement_matrices
from animtool.rig.surfaces import Strands, Surface, strands_of, surfaces_of
from animtool.usd.caches.reader import PointReader, transform_points
from animtool.usd.layers.faults import PrimLocation, bind_faults
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.meshes import SUBDIVISION_TOKENS
from animtool.usd.rigs.placement import DROP_PLACEMENT, local_placement
from animtool.usd.rigs.prims import (
    SkeletonRig,
    array_value,
    find_skeletons,
    integer_array,
    number_rows,
    open_stage,
    search_root,
    skeleton_rig,
    value_rows,
)
from animtool.usd.rigs.rest_pose import collapsed_bone_faults
from animtool.usd.rigs.skinned import (
    influence_joint_names,
    prim_name,
    read_float_rows,
    skinned_prims,
    unbound_notice,
    unique_name,
)
from animtool.usd.rigs.target import RigTarget
from animtool.usd.rigs.unskinned import animated_mesh_notice

_SKIN_METHODS = {"classicLinear": "linear", "dualQuaternion": "dual_quaternion"}


def read_meshes(
    skeleton: Any, rig: SkeletonRig, file_path: str
) -> tuple[tuple[Mesh, ...], tuple[Shape, ...], list[Fault]]:
    """Return meshes, blend shapes, and notices about skipped data.

    Normals other than one per vertex are skipped (USD116), as are shapes without a
    target. Rigidly bound meshes get their influences at every vertex; unbound ones have
    the transform of their prim. Values are in the unit of the rig.
    """
    meshes: list[Mesh] = []
    shapes: list[Shape] = []
    notices = unbound_notice(skeleton, file_path)
    for name, query in bound_meshes(skeleton):
        location = PrimLocation.from_prim(file_path, query.GetPrim())
        bind = _geom_bind(query, skeleton, location)
        meshes.append(_read_mesh(query, name, rig, location, bind, notices))
        point_count = len(meshes[-1].points.load())
        known_shapes = {shape.name for shape in shapes}
        shapes += _read_shapes(query, name, point_count, file_path, known_shapes)
    return tuple(meshes), tuple(shapes), notices


def bound_meshes(skeleton: Any) -> list[tuple[str, Any]]:
    """Return unique names and queries of the meshes that a Skeleton deforms."""
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


def _geom_bind(
    query: Any, skeleton: Any, location: PrimLocation
) -> tuple[float, ...] | None:
    """Return the bind transform of a mesh; None if it is the identity."""
    if query.HasJointInfluences():
        bind_matrix = query.GetGeomBindTransform()
    else:
        cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        skeleton_to_world = cache.GetLocalToWorldTransform(skeleton.GetPrim())
        local_to_world = cache.GetLocalToWorldTransform(query.GetPrim())
        bind_matrix = local_to_world
        if skeleton_to_world != Gf.Matrix4d(1):
            bind_matrix = local_to_world * skeleton_to_world.GetInverse()
    matrix = np.array(bind_matrix, np.float64).T
    if not np.isfinite(matrix).all():
        code = "USD235" if query.HasJointInfluences() else "USD017"
        location.fail(code, "its transform at bind time is not finite")
    return tuple(matrix.ravel().tolist()) if (matrix != np.eye(4)).any() else None


def _read_mesh(
    query: Any,
    name: str,
    rig: SkeletonRig,
    location: PrimLocation,
    geom_bind: tuple[float, ...] | None,
    notices: list[Fault],
) -> Mesh:
    prim = query.GetPrim()
    mesh = UsdGeom.Mesh(prim)
    points = read_float_rows(PointReader(prim).points_attr, location, "USD265")
    if not len(points):
        location.fail("USD017", "the mesh has no points")
    normals = None
    authored_normals = array_value(mesh.GetNormalsAttr())
    if (
        len(authored_normals) == len(points)
        and mesh.GetNormalsInterpolation() == "vertex"
    ):
        normals = read_float_rows(mesh.GetNormalsAttr(), location)
    elif len(authored_normals):
        message = "normals that are not one per vertex are skipped"
        notices.append(location.fault("USD116", message, severity=Severity.NOTE))
    return Mesh(
        name,
        LoadedArray(points),
        LoadedArray(_padded_faces(mesh, len(points), location)),
        None if normals is None else LoadedArray(normals),
        geom_bind,
        _read_skin(query, len(points), rig, location)
        if query.HasJointInfluences()
        else None,
        _read_subdivision(mesh, normals is not None),
    )


def _read_subdivision(mesh: Any, has_normals: bool) -> Subdivision | None:
    """Return the subdivision scheme; None for the default one."""
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
    subdivision = {name: rule for rule, name in SUBDIVISION_TOKENS.items()}.get(scheme)
    default = Subdivision.NONE if has_normals else Subdivision.CATMULL_CLARK
    return None if subdivision is default else subdivision


def _padded_faces(mesh: Any, point_count: int, location: PrimLocation) -> FloatArray:
    """Return faces ``(N, K)``, padded with -1."""
    counts, indices = PointReader(mesh.GetPrim()).faces(None)
    if not len(counts):
        location.fail("USD017", "the mesh has no faces")
    if (counts < 3).any():
        location.fail(
            "USD017", f"a face has {counts.min()} vertices; it needs at least 3"
        )
    if counts.sum() != len(indices):
        message = f"{len(indices)} faceVertexIndices for faces of {counts.sum()} in all"
        location.fail("USD017", message)
    if len(indices) and not 0 <= indices.min() <= indices.max() < point_count:
        location.fail(
            "USD018", f"a face refers to a vertex outside 0 to {point_count - 1}"
        )
    width = int(counts.max(initial=3))
    is_corner = np.arange(width) < counts[:, None]
    faces = np.full(is_corner.shape, -1, np.int64)
    faces[is_corner] = indices
    return faces.astype(np.float64)


def _read_skin(
    query: Any, point_count: int, rig: SkeletonRig, location: PrimLocation
) -> Skin:
    indices, weights = (
        value_rows(primvar.ComputeFlattened(), 1)[:, 0]
        for primvar in (query.GetJointIndicesPrimvar(), query.GetJointWeightsPrimvar())
    )
    influence_count = query.GetNumInfluencesPerComponent()
    row_count = 1 if query.IsRigidlyDeformed() else point_count
    if (
        len(indices) != row_count * influence_count
        or len(weights) != row_count * influence_count
    ):
        message = (
            f"{len(indices)} jointIndices and {len(weights)} jointWeights for "
            f"{row_count} x {influence_count} influences"
        )
        location.fail("USD231", message)
    if not np.isfinite(weights).all():
        location.fail("USD233", "jointWeights contain a value that is not finite")
    names = influence_joint_names(query, rig, location)
    if len(indices) and not 0 <= indices.min() <= indices.max() < len(names):
        location.fail("USD230", f"a jointIndex is not in 0 to {len(names) - 1}")
    array_shape = (point_count, influence_count)
    arrays = (
        np.broadcast_to(values.reshape(row_count, influence_count), array_shape).copy()
        for values in (indices, weights)
    )
    method = _SKIN_METHODS.get(str(query.GetSkinningMethod()), "linear")
    return Skin(method, names, *map(LoadedArray, arrays))


def _read_shapes(
    query: Any, mesh: str, point_count: int, file_path: str, known_shapes: set[str]
) -> list[Shape]:
    """Return the blend shapes of a mesh.

    A shape with the name of another mesh's shape is renamed and driven by that one,
    since UsdSkel gives both the same weight.
    """
    if not query.HasBlendShapes():
        return []
    tokens = [str(token) for token in query.GetBlendShapeOrder() or ()]
    targets = query.GetBlendShapeTargetsRel().GetTargets()
    if len(tokens) != len(targets):
        message = f"{len(tokens)} blendShapes for {len(targets)} targets"
        PrimLocation.from_prim(file_path, query.GetPrim()).fail("USD245", message)
    stage = query.GetPrim().GetStage()
    for target in targets:
        if not stage.GetPrimAtPath(target):
            message = f"a blendShapeTarget, {target}, does not exist"
            PrimLocation.from_prim(file_path, query.GetPrim()).fail("USD208", message)
    shapes = []
    for token, target in zip(tokens, targets, strict=True):
        prim, is_shared = stage.GetPrimAtPath(target), token in known_shapes
        name = f"{mesh}_{token}" if is_shared else token
        shape = _read_shape(
            UsdSkel.BlendShape(prim), name, mesh, point_count, file_path
        )
        shapes.append(replace(shape, combine=(token,)) if is_shared else shape)
    return shapes


def _read_shape(
    shape: Any, name: str, mesh: str, point_count: int, file_path: str
) -> Shape:
    location = PrimLocation.from_prim(file_path, shape)
    deltas = read_float_rows(shape.GetOffsetsAttr(), location, "USD243")
    vertices = integer_array(shape.GetPointIndicesAttr())
    row_count = len(vertices) or point_count
    inbetween_prims = shape.GetInbetweens()
    normal_attributes = [shape.GetNormalOffsetsAttr()]
    normal_attributes += [
        inbetween.GetNormalOffsetsAttr() for inbetween in inbetween_prims
    ]
    if not len(deltas) and any(
        attr and len(array_value(attr)) for attr in normal_attributes
    ):
        # The shape changes normals only.
        deltas = np.zeros((row_count, 3))
    if len(deltas) != row_count:
        location.fail("USD240", f"{len(deltas)} offsets for {row_count} points")
    if len(vertices) and not 0 <= vertices.min() <= vertices.max() < point_count:
        location.fail("USD241", f"a pointIndex is not in 0 to {point_count - 1}")

    def offset_rows(attr: Any) -> LoadedArray | None:
        if not attr or not attr.HasAuthoredValue():
            return None
        values = read_float_rows(attr, location, "USD243")
        if len(values) != row_count:
            location.fail(
                "USD242" if attr.GetName().endswith("normalOffsets") else "USD240",
                f"{attr.GetName()} has {counted(len(values), 'row')}, not {row_count}",
            )
        return LoadedArray(values)

    inbetweens = []
    for inbetween in inbetween_prims:
        weight = inbetween.GetWeight()
        normals = offset_rows(inbetween.GetNormalOffsetsAttr())
        if normals is not None and not len(array_value(inbetween.GetAttr())):
            offsets: LoadedArray | None = LoadedArray(np.zeros((row_count, 3)))
        else:
            offsets = offset_rows(inbetween.GetAttr())
        if weight is None or offsets is None or not np.isfinite(weight):
            message = f"{inbetween.GetAttr().GetName()} has no weight or no offsets"
            location.fail("USD240" if offsets is None else "USD244", message)
        inbetweens.append(Inbetween(float(weight), offsets, normals))
    return Shape(
        name,
        mesh,
        LoadedArray(deltas),
        offset_rows(shape.GetNormalOffsetsAttr()),
        tuple(sorted(inbetweens, key=lambda inbetween: inbetween.at)),
        vertices=LoadedArray(vertices.astype(np.float64)) if len(vertices) else None,
    )


def read_strands(
    skeleton: Any, rig: SkeletonRig, file_path: str
) -> tuple[Attachment, ...]:
    """Return linear curves bound to one joint each, as strands.

    Curves of other types or with different lengths, and curves bound to several joints,
    are skipped. Points are in the unit of the rig.
    """
    return tuple(entry for entry, _ in bound_strands(skeleton, rig, file_path))


def bound_strands(
    skeleton: Any, rig: SkeletonRig, file_path: str
) -> list[tuple[Attachment, Any]]:
    """Return the strands of `read_strands`, each with its prim."""
    strands: list[tuple[Attachment, Any]] = []
    used_names: set[str] = set()
    for query in skinned_prims(skeleton, UsdGeom.BasisCurves):
        prim = query.GetPrim()
        location = PrimLocation.from_prim(file_path, prim)
        joint = _rigid_joint(query, rig, location)
        points = _strand_points(UsdGeom.BasisCurves(prim), query, location)
        if joint is not None and points is not None:
            name = unique_name(prim_name(prim), used_names)
            kind, array = AttachKind.STRANDS.value, LoadedArray(points)
            strands.append((Attachment(name, kind, (joint,), points=array), prim))
    return strands


def _rigid_joint(query: Any, rig: SkeletonRig, location: PrimLocation) -> str | None:
    """Return the joint that a prim is rigidly bound to; None if there are several."""
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
    names = influence_joint_names(query, rig, location)
    if not 0 <= indices[0] < len(names):
        message = f"a jointIndex is not in 0 to {len(names) - 1}"
        location.fail("USD230", message)
    return names[int(indices[0])]


def _strand_points(
    curves: Any, query: Any, location: PrimLocation
) -> FloatArray | None:
    """Return bind points ``(S, K, 3)``; None if the curves are not strands."""
    counts = integer_array(curves.GetCurveVertexCountsAttr())
    if curves.GetTypeAttr().Get() != UsdGeom.Tokens.linear or not len(counts):
        return None
    values = read_float_rows(
        PointReader(curves.GetPrim()).points_attr, location, "USD265"
    )
    if counts.min() < 2 or (counts != counts[0]).any() or counts.sum() != len(values):
        return None
    matrix = np.array(query.GetGeomBindTransform(), np.float64)
    if not np.isfinite(matrix).all():
        location.fail("USD235", "geomBindTransform is not finite")
    return transform_points(values, matrix).reshape(len(counts), -1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class StageMeshes:
    """Meshes and strands of a Skeleton."""

    surfaces: tuple[Surface, ...]  # the meshes [m]
    strands: tuple[Strands, ...]  # curves bound to single joints [m]
    # World bind transforms of the Skeleton's joints, with scale and shear, for column
    # vectors ``(J, 4, 4)`` [m].
    bind: FloatArray
    up: UpAxis  # up axis of meshes and strands
    notices: list[Fault]  # warnings about skipped contents


def read_source_meshes(
    path: Path, prim_path: str | None, placement: str | None = None
) -> StageMeshes:
    """Return the meshes and strands of the character in a USD file.

    ``placement`` is as in `animtool.usd.takes.read.read_usd`.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        skeletons = find_skeletons(stage, search_root(stage, prim_path))
        if not skeletons:
            return StageMeshes((), (), np.zeros((0, 4, 4)), UpAxis.Y, [])
        rig = skeleton_rig(skeletons[0], path)
        rig_placement = local_placement(skeletons[0].GetPrim(), rig.rig)
        rest_placement = rig_placement.rest_placement
        if placement == DROP_PLACEMENT:
            rest_placement = rig_placement.upright_placement
        meshes = _stage_meshes(skeletons[0], rig, path, rest_placement)
        unskinned_notices = animated_mesh_notice(skeletons[0], str(path), placement)
        return replace(meshes, notices=meshes.notices + unskinned_notices)


def read_target_meshes(target: RigTarget) -> StageMeshes:
    """Return the meshes and strands of a rig layer."""
    with usd_errors(target.path), without_usd_warnings():
        prim = target.stage.GetPrimAtPath(target.to_stage_path(target.paths.skeleton))
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
    location = PrimLocation.from_prim(path, skeleton)
    location.raise_errors(bind_faults(skeleton, skeleton_rig.tokens, is_skinned=True))
    warnings = collapsed_bone_faults(skeleton, skeleton_rig.tokens)
    notices += [replace(fault, path=str(path)) for fault in warnings]
    attr = skeleton.GetBindTransformsAttr()
    bind = number_rows(attr, 16).reshape(-1, 4, 4).swapaxes(-1, -2).copy()
    bind[:, :3, 3] *= rig.meters_per_unit
    if placement is not None and not placement.is_identity:
        rig = transform_rig(rig, placement)
        bind = placement_matrices(placement)[0] @ bind
        # The scale is already in the bone lengths; joints cannot store it.
        bind[:, :3, :3] /= placement.size
    return StageMeshes(surfaces_of(rig), strands_of(rig), bind, rig.up, notices)
