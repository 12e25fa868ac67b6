"""Authoring the meshes and blend shapes of a rig, bound to its Skeleton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pxr import Gf, Sdf, UsdGeom, Vt

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, Severity
from animtool.maths.faces import closed
from animtool.rig.parts import Subdivision
from animtool.rig.surfaces import Strands, Surface, SurfaceShape, SurfaceSkin
from animtool.skin.influences import InfluenceReport, Influences, read_influences
from animtool.usd.finite import Labels, check_value, narrowed
from animtool.usd.layers import (
    apply_schemas,
    attribute,
    author_order,
    prim,
    relationship,
)
from animtool.usd.names import RigPaths, distinct_names
from animtool.usd.point_based import author_faces, author_linear, author_width

# Below the SkelRoot, what holds the curves.
SCOPE = "Strands"
# How wide curves are drawn [m]: the format of rigs says nothing of it.
WIDTH = 4e-4


def strand_paths(strands: Sequence[Strands], paths: RigPaths) -> tuple[str, ...]:
    """Return paths of the strands' prims."""
    names_given = [entry.name for entry in strands]
    names = distinct_names(names_given, names_given, names_given).names
    return tuple(f"{paths.root}/{SCOPE}/{name}" for name in names)


def author_strands(
    layer: Any,
    strands: Sequence[Strands],
    paths: RigPaths,
    tokens: Mapping[str, str],
    meters_per_unit: float,  # unit of the layer [m]
    *,
    bound: bool = True,
) -> None:
    """Write strands as linear curves below the SkelRoot, each bound to its joint."""
    if not strands:
        return
    prim(layer, f"{paths.root}/{SCOPE}", "Scope")
    for entry, path in zip(strands, strand_paths(strands, paths), strict=True):
        spec = prim(layer, path, "BasisCurves")
        if Sdf.Path(path).name != entry.name:
            spec.SetInfo("customData", {"animtool": {"name": entry.name}})
        _curves(spec, entry.points / meters_per_unit, WIDTH / meters_per_unit)
        if bound:
            _bound(spec, tokens[entry.joint])


def _curves(spec: Any, points: FloatArray, width: float) -> None:
    count, length = points.shape[:2]
    labels = Labels(f"{spec.path}.points", "point")
    flat = np.ascontiguousarray(narrowed(points.reshape(-1, 3), "f", labels))
    places, widths = Vt.Vec3fArray.FromNumpy(flat), Vt.FloatArray([width])
    extent = UsdGeom.Curves.ComputeExtent(places, widths)
    attribute(spec, "extent", _TYPES.Float3Array, extent)
    author_linear(spec)
    counts = Vt.IntArray(count, length)
    attribute(spec, "curveVertexCounts", _TYPES.IntArray, counts)
    attribute(spec, "points", _TYPES.Point3fArray, places)
    author_width(spec, width)


def _bound(spec: Any, token: str) -> None:
    """Bind a prim to one joint as a whole."""
    apply_schemas(spec, ["SkelBindingAPI"])
    own = Vt.TokenArray([token])
    attribute(spec, "skel:joints", _TYPES.TokenArray, own, uniform=True)
    for name, kind, value in (
        ("jointIndices", _TYPES.IntArray, Vt.IntArray([0])),
        ("jointWeights", _TYPES.FloatArray, Vt.FloatArray([1.0])),
    ):
        attr = attribute(
            spec, f"primvars:skel:{name}", kind, value, interpolation="constant"
        )
        attr.SetInfo("elementSize", 1)


# Fewer moving vertices than this share are written with their indices: an index is a
# third of an offset.
SPARSE = 0.75

SUBDIVISION = {
    Subdivision.NONE: "none",
    Subdivision.CATMULL_CLARK: "catmullClark",
    Subdivision.LOOP: "loop",
    Subdivision.BILINEAR: "bilinear",
}
_TYPES = Sdf.ValueTypeNames
_METHODS = {"linear": "classicLinear", "dual_quaternion": "dualQuaternion"}


def mesh_names(
    surfaces: Sequence[Surface], paths: RigPaths
) -> tuple[list[str], dict[str, str]]:
    """Return paths of the surfaces' prims, and the names that USD forbids, by path.

    They stand below the SkelRoot, beside the Skeleton, the animation and strands.
    """
    taken = [Sdf.Path(path).name for path in (paths.skeleton, paths.animation)]
    taken.append(SCOPE)
    every = [*taken, *(surface.name for surface in surfaces)]
    names = distinct_names(every, every, every)
    paths_of_meshes = [f"{paths.root}/{name}" for name in names.names[len(taken) :]]
    renamed = {
        path: surface.name
        for path, surface in zip(paths_of_meshes, surfaces, strict=True)
        if Sdf.Path(path).name != surface.name
    }
    return paths_of_meshes, renamed


def author_meshes(
    layer: Any,
    surfaces: Sequence[Surface],
    paths: RigPaths,
    tokens: Mapping[str, str],
    meters_per_unit: float,
    *,
    bound: bool = True,
) -> tuple[list[str], list[Fault]]:
    """Write meshes below the SkelRoot; return the paths of their prims, and notices.

    Weights of a skin are normalised, which a note says (SKIN101).

    meters_per_unit: unit of the layer [m].
    """
    notices: list[Fault] = []
    mesh_paths, renamed = mesh_names(surfaces, paths)
    for path, surface in zip(mesh_paths, surfaces, strict=True):
        spec = _mesh(layer, path, surface, meters_per_unit)
        if path in renamed:
            spec.SetInfo("customData", {"animtool": {"name": renamed[path]}})
        if surface.skin is None and (surface.geom_bind != np.eye(4)).any():
            _placed(spec, surface.geom_bind, meters_per_unit)
        if bound and (surface.skin is not None or surface.shapes):
            apply_schemas(spec, ["SkelBindingAPI"])
            if surface.skin is not None:
                notices += _skin(spec, surface, surface.skin, tokens, meters_per_unit)
            if surface.shapes:
                _shapes(layer, spec, surface, meters_per_unit)
    return mesh_paths, notices


def _mesh(layer: Any, path: str, surface: Surface, meters_per_unit: float) -> Any:
    spec = prim(layer, path, "Mesh")
    points = surface.points / meters_per_unit
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    attribute(spec, "extent", _TYPES.Float3Array, _vec3f(extent, f"{path}.extent"))
    counts, indices = (
        Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))
        for values in (surface.counts, surface.indices)
    )
    attribute(spec, "faceVertexCounts", _TYPES.IntArray, counts)
    attribute(spec, "faceVertexIndices", _TYPES.IntArray, indices)
    attribute(spec, "points", _TYPES.Point3fArray, _vec3f(points, f"{path}.points"))
    if surface.normals is not None:
        normals = _vec3f(surface.normals, f"{path}.normals")
        attribute(
            spec, "normals", _TYPES.Normal3fArray, normals, interpolation="vertex"
        )
    whole = closed(surface.counts, surface.indices)
    author_faces(spec, SUBDIVISION[surface.subdivision], closed=whole)
    return spec


def _placed(spec: Any, transform: FloatArray, meters_per_unit: float) -> None:
    """Place a mesh that follows no joint."""
    matrix = _matrix(transform, meters_per_unit)
    attribute(spec, "xformOp:transform", _TYPES.Matrix4d, matrix)
    author_order(spec, "xformOp:transform")


def _matrix(transform: FloatArray, meters_per_unit: float) -> Any:
    """Return a transform of column vectors [m] as a row-vector matrix."""
    rows = transform.T.copy()
    rows[3, :3] /= meters_per_unit
    return Gf.Matrix4d(*rows.ravel().tolist())


def _vec3f(values: FloatArray, where: str) -> Any:
    labels = Labels(where, "point")
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(narrowed(values, "f", labels)))


def _skin(
    spec: Any,
    surface: Surface,
    skin: SurfaceSkin,
    tokens: Mapping[str, str],
    meters_per_unit: float,
) -> list[Fault]:
    influences, report = read_influences(skin.indices, skin.weights, len(skin.joints))
    indices, weights = _padded(influences)
    if skin.joints != tuple(tokens):
        own = Vt.TokenArray([tokens[name] for name in skin.joints])
        attribute(spec, "skel:joints", _TYPES.TokenArray, own, uniform=True)
    if (surface.geom_bind != np.eye(4)).any():
        bind = _matrix(surface.geom_bind, meters_per_unit)
        attribute(spec, "primvars:skel:geomBindTransform", _TYPES.Matrix4d, bind)
    flat = np.ascontiguousarray(indices.ravel(), np.int32)
    shares = np.ascontiguousarray(weights.ravel(), np.float32)
    for name, kind, values in (
        ("jointIndices", _TYPES.IntArray, Vt.IntArray.FromNumpy(flat)),
        ("jointWeights", _TYPES.FloatArray, Vt.FloatArray.FromNumpy(shares)),
    ):
        attr = attribute(
            spec, f"primvars:skel:{name}", kind, values, interpolation="vertex"
        )
        attr.SetInfo("elementSize", indices.shape[1])
    method = _METHODS[skin.method]
    if method != "classicLinear":
        name = "primvars:skel:skinningMethod"
        attribute(spec, name, _TYPES.Token, method, uniform=True)
    return _notices(surface.name, report)


def _padded(influences: Influences) -> tuple[IntArray, FloatArray]:
    """Return joints and weights ``(V, I)``, I no more than one vertex has."""
    counts = np.diff(influences.first)
    within = np.arange(max(1, int(counts.max(initial=1)))) < counts[:, None]
    joints, weights = np.zeros(within.shape, np.int64), np.zeros(within.shape)
    joints[within], weights[within] = influences.joints, influences.weights
    return joints, weights


def _notices(mesh: str, report: InfluenceReport) -> list[Fault]:
    if not report.normalized:
        return []
    message = (
        f"mesh {mesh!r}: the weights of {report.normalized} vertices were brought to "
        f"the sum 1; that of vertex {report.sum_vertex} was off by "
        f"{report.sum_error:.3g}"
    )
    return [Fault("SKIN101", message, severity=Severity.NOTE)]


def _shapes(layer: Any, spec: Any, surface: Surface, meters_per_unit: float) -> None:
    shape_names = [shape.name for shape in surface.shapes]
    names = distinct_names(shape_names, shape_names, shape_names).names
    targets = [f"{spec.path}/{name}" for name in names]
    attribute(
        spec,
        "skel:blendShapes",
        _TYPES.TokenArray,
        Vt.TokenArray(shape_names),
        uniform=True,
    )
    relationship(spec, "skel:blendShapeTargets", *targets)
    for target, shape in zip(targets, surface.shapes, strict=True):
        _shape(prim(layer, target, "BlendShape"), shape, meters_per_unit)


def _shape(spec: Any, shape: SurfaceShape, meters_per_unit: float) -> None:
    parts = [shape.deltas, *(step.deltas for step in shape.inbetweens)]
    turns = [shape.normals, *(step.normals for step in shape.inbetweens)]
    given = [part for part in [*parts, *turns] if part is not None]
    moves = np.any([part.any(axis=1) for part in given], axis=0)
    vertices, rows = shape.vertices, slice(None)
    if vertices is None and moves.mean() < SPARSE:
        vertices = np.flatnonzero(moves)
        rows = moves
    attribute(
        spec,
        "offsets",
        _TYPES.Vector3fArray,
        _vec3f(shape.deltas[rows] / meters_per_unit, f"{spec.path}.offsets"),
        uniform=True,
    )
    if shape.normals is not None:
        normals = _vec3f(shape.normals[rows], f"{spec.path}.normalOffsets")
        attribute(spec, "normalOffsets", _TYPES.Vector3fArray, normals, uniform=True)
    if vertices is not None:
        points = Vt.IntArray.FromNumpy(np.ascontiguousarray(vertices, np.int32))
        attribute(spec, "pointIndices", _TYPES.IntArray, points, uniform=True)
    for i, step in enumerate(shape.inbetweens):
        name = f"inbetweens:step_{i + 1}"
        deltas = _vec3f(step.deltas[rows] / meters_per_unit, f"{spec.path}.{name}")
        attr = attribute(spec, name, _TYPES.Vector3fArray, deltas, uniform=True)
        check_value(step.at, "f", Labels(f"{spec.path}.{name}", "the weight"))
        attr.SetInfo("weight", step.at)
        if step.normals is not None:
            attribute(
                spec,
                f"{name}:normalOffsets",
                _TYPES.Vector3fArray,
                _vec3f(step.normals[rows], f"{spec.path}.{name}:normalOffsets"),
                uniform=True,
            )
