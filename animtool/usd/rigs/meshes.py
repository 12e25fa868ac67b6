"""Writes mesh prims: skinned rig meshes with blend shapes, bones, and frames.

All mesh writers use `author_mesh`, for attributes such as `doubleSided`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Vt

from animtool.core.array_types import Float32Array, FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.maths.faces import is_closed, triangulate, vertex_normals
from animtool.motion.frames import MeshFrame
from animtool.rig.kinematics import rest_world
from animtool.rig.parts import Subdivision
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, SurfaceShape, SurfaceSkin
from animtool.skin.influences import InfluenceReport, Influences, read_influences
from animtool.usd.caches.writer import (
    FrameEncoder,
    FramePrimWriter,
    author_values,
    bounds,
)
from animtool.usd.layers.finite import ValueLabels, check_value, narrow_floats
from animtool.usd.layers.names import RigPaths, distinct_names
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute_spec,
    author_relationship,
    author_xform_order,
    prim_spec,
)
from animtool.usd.rigs.skeleton import STRANDS_SCOPE, author_influences

# Blend shapes that move a smaller fraction of the vertices are written with indices; an
# index takes a third of the space of an offset.
MAX_INDEXED_FRACTION = 0.75

# Linear colors of meshes in order, and of bones.
MESH_COLORS = (
    (0.42, 0.45, 0.49),
    (0.49, 0.36, 0.27),
    (0.31, 0.42, 0.36),
    (0.43, 0.35, 0.46),
)
BONE_COLOR = (0.75, 0.72, 0.65)
SUBDIVISION_TOKENS = {
    Subdivision.NONE: "none",
    Subdivision.CATMULL_CLARK: "catmullClark",
    Subdivision.LOOP: "loop",
    Subdivision.BILINEAR: "bilinear",
}
_TYPES = Sdf.ValueTypeNames
_SKIN_METHODS = {"linear": "classicLinear", "dual_quaternion": "dualQuaternion"}


def author_mesh(
    spec: Any, values: Mapping[str, Any], *, subdivision: str = "none", is_closed: bool
) -> None:
    """Author the constant attributes of a mesh.

    ``values`` are its attributes in order; ``is_closed`` says whether only its outside
    is visible.
    """
    author_values(spec, {**values, "subdivisionScheme": subdivision})
    if not is_closed:
        author_values(spec, {"doubleSided": True})


class MeshEncoder(FrameEncoder[MeshFrame]):
    """An animated mesh with normals and changing topology."""

    type_name = "Mesh"
    sampled_names = ("points", "velocities", "extent", "normals")

    def topology(self, frame: MeshFrame) -> Mapping[str, IntArray]:
        """Return the topology attributes."""
        return {
            "faceVertexCounts": frame.counts.astype(np.int32),
            "faceVertexIndices": frame.indices.astype(np.int32),
        }

    def can_tear(self, frame: MeshFrame) -> bool:
        """Return whether the topology may change."""
        return frame.tears

    def author_constants(
        self,
        writer: FramePrimWriter,  # noqa: ARG002
        spec: Any,
        frame: MeshFrame,
    ) -> None:
        """Author subdivision scheme and sidedness."""
        author_mesh(spec, {}, is_closed=frame.closed)

    def values(
        self,
        writer: FramePrimWriter,
        frame: MeshFrame,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return bounds and normals; only meshes that tear use the frame's faces."""
        faces = writer.triangles
        if frame.tears:
            faces = triangulate(frame.counts, frame.indices)
        normals = vertex_normals(frame.points, faces)
        return {"extent": bounds(points, 0.0), "normals": normals.astype(np.float32)}


def mesh_names(
    surfaces: Sequence[Surface], paths: RigPaths
) -> tuple[list[str], dict[str, str]]:
    """Return prim paths of meshes, and the original names of renamed meshes by path.

    Meshes are siblings of Skeleton, animation and strands below the SkelRoot.
    """
    reserved_names = [Sdf.Path(path).name for path in (paths.skeleton, paths.animation)]
    reserved_names.append(STRANDS_SCOPE)
    all_names = [*reserved_names, *(surface.name for surface in surfaces)]
    names = distinct_names(all_names, all_names, all_names)
    mesh_paths = [f"{paths.root}/{name}" for name in names.names[len(reserved_names) :]]
    original_names = {
        path: surface.name
        for path, surface in zip(mesh_paths, surfaces, strict=True)
        if Sdf.Path(path).name != surface.name
    }
    return mesh_paths, original_names


def author_meshes(
    layer: Any,
    surfaces: Sequence[Surface],
    paths: RigPaths,
    tokens: Mapping[str, str] | None,
    meters_per_unit: float,
) -> tuple[list[str], list[Fault]]:
    """Write meshes below the SkelRoot; return their paths and notices.

    Skin weights are normalised, which a note reports (SKIN101).

    ``tokens`` has the path of each joint; None writes meshes without skin and shapes.
    ``meters_per_unit`` is the unit of the layer [m].
    """
    notices: list[Fault] = []
    mesh_paths, original_names = mesh_names(surfaces, paths)
    for i, (path, surface) in enumerate(zip(mesh_paths, surfaces, strict=True)):
        spec = _author_mesh_prim(layer, path, surface, meters_per_unit)
        _author_color(spec, MESH_COLORS[i % len(MESH_COLORS)])
        if path in original_names:
            spec.SetInfo("customData", {"animtool": {"name": original_names[path]}})
        if surface.skin is None and (surface.geom_bind != np.eye(4)).any():
            matrix = _stage_matrix(surface.geom_bind, meters_per_unit)
            attribute_spec(spec, "xformOp:transform", _TYPES.Matrix4d, matrix)
            author_xform_order(spec, "xformOp:transform")
        if tokens is not None and (surface.skin is not None or surface.shapes):
            apply_schemas(spec, ["SkelBindingAPI"])
            if surface.skin is not None:
                notices += _author_skin(
                    spec, surface, surface.skin, tokens, meters_per_unit
                )
            if surface.shapes:
                _author_shapes(layer, spec, surface, meters_per_unit)
    return mesh_paths, notices


def _author_mesh_prim(
    layer: Any, path: str, surface: Surface, meters_per_unit: float
) -> Any:
    spec = prim_spec(layer, path, "Mesh")
    points = surface.points / meters_per_unit
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    values = {
        "extent": _to_float32(extent, f"{path}.extent"),
        "faceVertexCounts": np.ascontiguousarray(surface.counts, np.int32),
        "faceVertexIndices": np.ascontiguousarray(surface.indices, np.int32),
        "points": _to_float32(points, f"{path}.points"),
    }
    if surface.normals is not None:
        values["normals"] = _to_float32(surface.normals, f"{path}.normals")
    author_mesh(
        spec,
        values,
        subdivision=SUBDIVISION_TOKENS[surface.subdivision],
        is_closed=is_closed(surface.counts, surface.indices),
    )
    return spec


def _author_color(spec: Any, color: tuple[float, float, float]) -> None:
    """Author displayColor, linear, for viewers without a material."""
    attribute_spec(
        spec,
        "primvars:displayColor",
        _TYPES.Color3fArray,
        Vt.Vec3fArray([Gf.Vec3f(*color)]),
        interpolation="constant",
    )


def _stage_matrix(transform: FloatArray, meters_per_unit: float) -> Any:
    """Return a column-vector transform [m] as a row-vector matrix in stage units."""
    rows = transform.T.copy()
    rows[3, :3] /= meters_per_unit
    return Gf.Matrix4d(*rows.ravel().tolist())


def _to_float32(values: FloatArray, label: str) -> Float32Array:
    labels = ValueLabels(label, "point")
    return np.ascontiguousarray(narrow_floats(values, "f", labels))


def _author_skin(
    spec: Any,
    surface: Surface,
    skin: SurfaceSkin,
    tokens: Mapping[str, str],
    meters_per_unit: float,
) -> list[Fault]:
    influences, report = read_influences(skin.indices, skin.weights, len(skin.joints))
    indices, weights = _pad_influences(influences)
    if skin.joints != tuple(tokens):
        joints = Vt.TokenArray([tokens[name] for name in skin.joints])
        attribute_spec(spec, "skel:joints", _TYPES.TokenArray, joints, is_uniform=True)
    if (surface.geom_bind != np.eye(4)).any():
        bind = _stage_matrix(surface.geom_bind, meters_per_unit)
        attribute_spec(spec, "primvars:skel:geomBindTransform", _TYPES.Matrix4d, bind)
    author_influences(spec, indices, weights)
    method = _SKIN_METHODS[skin.method]
    if method != "classicLinear":
        name = "primvars:skel:skinningMethod"
        attribute_spec(spec, name, _TYPES.Token, method, is_uniform=True)
    return _influence_notices(surface.name, report)


def _pad_influences(influences: Influences) -> tuple[IntArray, FloatArray]:
    """Return joints and weights ``(V, I)``, with I the largest influence count."""
    counts = np.diff(influences.row_starts)
    is_influence = np.arange(max(1, int(counts.max(initial=1)))) < counts[:, None]
    joints = np.zeros(is_influence.shape, np.int64)
    weights = np.zeros(is_influence.shape)
    joints[is_influence], weights[is_influence] = influences.joints, influences.weights
    return joints, weights


def _influence_notices(mesh: str, report: InfluenceReport) -> list[Fault]:
    if not report.normalized_count:
        return []
    message = (
        f"mesh {mesh!r}: the weights of {report.normalized_count} vertices were "
        f"normalised to the sum 1; that of vertex {report.sum_vertex} was off by "
        f"{report.sum_error:.3g}"
    )
    return [Fault("SKIN101", message, severity=Severity.NOTE)]


def _author_shapes(
    layer: Any, spec: Any, surface: Surface, meters_per_unit: float
) -> None:
    shape_names = [shape.name for shape in surface.shapes]
    names = distinct_names(shape_names, shape_names, shape_names).names
    targets = [f"{spec.path}/{name}" for name in names]
    attribute_spec(
        spec,
        "skel:blendShapes",
        _TYPES.TokenArray,
        Vt.TokenArray(shape_names),
        is_uniform=True,
    )
    author_relationship(spec, "skel:blendShapeTargets", *targets)
    for target, shape in zip(targets, surface.shapes, strict=True):
        _author_shape(prim_spec(layer, target, "BlendShape"), shape, meters_per_unit)


def _author_shape(spec: Any, shape: SurfaceShape, meters_per_unit: float) -> None:
    inbetweens = shape.inbetweens
    offset_arrays = [shape.deltas, *(inbetween.deltas for inbetween in inbetweens)]
    normal_arrays = [shape.normals, *(inbetween.normals for inbetween in inbetweens)]
    is_displaced = np.any(
        [
            offsets.any(axis=1)
            for offsets in (*offset_arrays, *normal_arrays)
            if offsets is not None
        ],
        axis=0,
    )
    vertex_indices, selected_rows = shape.vertices, slice(None)
    if vertex_indices is None and is_displaced.mean() < MAX_INDEXED_FRACTION:
        vertex_indices = np.flatnonzero(is_displaced)
        selected_rows = is_displaced

    def author_rows(name: str, rows: FloatArray) -> Any:
        """Author the selected rows of an array, and return the attribute."""
        values = _to_float32(rows[selected_rows], f"{spec.path}.{name}")
        array = Vt.Vec3fArray.FromNumpy(values)
        return attribute_spec(spec, name, _TYPES.Vector3fArray, array, is_uniform=True)

    author_rows("offsets", shape.deltas / meters_per_unit)
    if shape.normals is not None:
        author_rows("normalOffsets", shape.normals)
    if vertex_indices is not None:
        points = Vt.IntArray.FromNumpy(np.ascontiguousarray(vertex_indices, np.int32))
        attribute_spec(spec, "pointIndices", _TYPES.IntArray, points, is_uniform=True)
    for i, inbetween in enumerate(inbetweens):
        name = f"inbetweens:step_{i + 1}"
        attr = author_rows(name, inbetween.deltas / meters_per_unit)
        check_value(inbetween.at, "f", ValueLabels(f"{spec.path}.{name}", "the weight"))
        attr.SetInfo("weight", inbetween.at)
        if inbetween.normals is not None:
            author_rows(f"{name}:normalOffsets", inbetween.normals)


# A bone is drawn as an octahedron; position of its widest part, relative to the length.
WIDEST_POSITION = 0.2
BONE_HALF_WIDTH = 0.08
# Gap at both ends, relative to the length, so that tools do not merge points of bones.
END_GAP = 0.005

_OCTAHEDRON_FACES = np.array(
    [[[0, b, a], [5, a, b]] for a, b in ((1, 2), (2, 3), (3, 4), (4, 1))]
)


def bone_segments(rig: Rig) -> tuple[FloatArray, IntArray]:
    """Return the world ends ``(B, 2, 3)`` [m] and the joint of each bone at rest.

    A bone connects a joint to each of its children and each of its tips; bones of zero
    length are left out.
    """
    world = rest_world(rig)
    segment_ends, joint_indices = [], []
    for i, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            segment_ends.append(
                (world.positions[0, joint.parent], world.positions[0, i])
            )
            joint_indices.append(joint.parent)
        for tip in joint.tips:
            joint_position = world.positions[0, i]
            segment_ends.append(
                (joint_position, joint_position + world.linear[0, i] @ np.asarray(tip))
            )
            joint_indices.append(i)
    segments = np.array(segment_ends, np.float64).reshape(-1, 2, 3)
    segment_joints = np.array(joint_indices, np.int64)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    is_nonzero = lengths > 1e-6 * lengths.max(initial=0.0)
    return segments[is_nonzero], segment_joints[is_nonzero]


def author_bones(layer: Any, rig: Rig, paths: RigPaths, meters_per_unit: float) -> bool:
    """Write a mesh of octahedra, each bound rigidly to its joint.

    Returns whether there was a bone to write.
    """
    segments, joints = bone_segments(rig)
    if not len(segments):
        return False
    corner_points, normals = _octahedra(segments / meters_per_unit)
    points = _to_float32(corner_points.reshape(-1, 3), f"{paths.root}/Bones.points")
    faces = (
        _OCTAHEDRON_FACES.reshape(1, -1) + 6 * np.arange(len(segments))[:, None]
    ).reshape(-1)
    spec = prim_spec(layer, f"{paths.root}/Bones", "Mesh")
    apply_schemas(spec, ["SkelBindingAPI"])
    values = {
        "faceVertexCounts": np.full(len(faces) // 3, 3, np.int32),
        "faceVertexIndices": faces.astype(np.int32),
        "points": points,
        "normals": normals.reshape(-1, 3).astype(np.float32),
        "extent": np.stack([points.min(axis=0), points.max(axis=0)]),
    }
    author_mesh(spec, values, is_closed=True)
    _author_color(spec, BONE_COLOR)
    # Marks the mesh, so that readers do not take it for a mesh of the rig.
    spec.SetInfo("customData", {"animtool": {"bones": True}})
    joint_indices = np.repeat(joints, 6)[:, None]
    author_influences(spec, joint_indices, np.ones(joint_indices.shape))
    identity = Gf.Matrix4d(1.0)
    attribute_spec(spec, "primvars:skel:geomBindTransform", _TYPES.Matrix4d, identity)
    author_relationship(spec, "skel:skeleton", paths.skeleton)
    return True


def _octahedra(segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return six points per bone (head, four around the widest part, tail) and normals.

    Both are ``(B, 6, 3)``.
    """
    directions = segments[:, 1] - segments[:, 0]
    head = segments[:, 0] + END_GAP * directions
    tail = segments[:, 1] - END_GAP * directions
    lengths = np.linalg.norm(directions, axis=-1, keepdims=True)
    unit_directions = directions / lengths
    # The cross product with the coordinate axis least along the bone is never
    # degenerate.
    least_axis = np.eye(3)[np.argmin(np.abs(unit_directions), axis=-1)]
    side_axis = np.cross(unit_directions, least_axis)
    side_axis /= np.linalg.norm(side_axis, axis=-1, keepdims=True)
    front_axis = np.cross(unit_directions, side_axis)
    widest_center = head + WIDEST_POSITION * directions
    width = BONE_HALF_WIDTH * lengths
    corner_axes = [side_axis, front_axis, -side_axis, -front_axis]
    widest_ring = [widest_center + width * axis for axis in corner_axes]
    return (
        np.stack([head, *widest_ring, tail], axis=1),
        np.stack([-unit_directions, *corner_axes, unit_directions], axis=1),
    )
