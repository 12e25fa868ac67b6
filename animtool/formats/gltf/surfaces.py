"""Builds rig meshes and shapes from glTF meshes and morph targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.names import numbered_names
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.formats.characters.binding import SkinBinder
from animtool.formats.characters.choice import CharacterNodes
from animtool.formats.characters.names import replace_unprintable, shape_names
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.meshes import Primitive, build_triangles, read_skin_weights
from animtool.rig.parts import LoadedArray, Mesh, Shape, Skin, Subdivision

# Number of joints from which equal bind matrices are reported.
MIN_EQUAL_BINDS = 3
# Points with a largest weight below 1 by more than this follow several joints [1].
BLEND_TOLERANCE = 1e-3

ShapeKey = tuple[int, int]  # node and morph target


@dataclass(frozen=True, slots=True, eq=False)
class SharedVertices:
    """Vertices that several primitives of a mesh may share."""

    primitive: Primitive
    first_vertex: int  # index of the first shared vertex in the mesh
    count: int


def build_meshes(
    gltf: Gltf, character: CharacterNodes, binder: SkinBinder
) -> tuple[tuple[Mesh, ...], tuple[Shape, ...], tuple[ShapeKey, ...], list[Fault]]:
    """Return meshes, shapes, node and morph target of each shape, and notices."""
    nodes = [node for node in character.nodes if gltf.nodes[node].mesh >= 0]
    names = mesh_names(gltf, nodes)
    shape_keys = [
        (n, t)
        for n in nodes
        for t in range(gltf.meshes[gltf.nodes[n].mesh].target_count)
    ]
    next_names = iter(_shape_names(gltf, shape_keys, names))
    meshes: list[Mesh] = []
    shapes: list[Shape] = []
    empty_mesh_names: list[str] = []
    for node in nodes:
        mesh = _build_mesh(gltf, node, names[node], binder)
        if mesh is None:
            empty_mesh_names.append(names[node])
            target_count = gltf.meshes[gltf.nodes[node].mesh].target_count
            shapes += [Shape(next(next_names)) for _ in range(target_count)]
            continue
        meshes.append(mesh)
        for deltas, normals in _morph_offsets(gltf, node):
            shapes.append(Shape(next(next_names), mesh.name, deltas, normals))
    notices = []
    if empty_mesh_names:
        count = counted(len(empty_mesh_names), "mesh", "meshes")
        message = f"skipped {count} without faces: {listed(empty_mesh_names)}"
        notices.append(Fault("GLT108", message, str(gltf.path), severity=Severity.NOTE))
    return tuple(meshes), tuple(shapes), tuple(shape_keys), notices


def mesh_names(gltf: Gltf, nodes: Sequence[int]) -> dict[int, str]:
    """Return a unique, printable mesh name for each node with a mesh."""
    names = []
    for node in nodes:
        gltf_node = gltf.nodes[node]
        mesh = gltf.meshes[gltf_node.mesh]
        name = mesh.original_name or gltf_node.name or mesh.name or f"mesh_{node}"
        names.append(replace_unprintable(name) or "mesh")
    return dict(zip(nodes, numbered_names(names), strict=True))


def _shape_names(
    gltf: Gltf, shape_keys: Sequence[ShapeKey], mesh_names: dict[int, str]
) -> list[str]:
    """Return unique shape names, prefixed with the mesh if ambiguous."""
    names_by_shape = []
    for node, target in shape_keys:
        target_names, mesh_name = (
            gltf.meshes[gltf.nodes[node].mesh].target_names,
            mesh_names[node],
        )
        target_name = target_names[target] if target_names else ""
        names_by_shape.append((target_name, f"{mesh_name}_{target}", mesh_name))
    return shape_names(names_by_shape)


def shared_vertices(gltf: Gltf, node: int) -> list[SharedVertices]:
    """Return the distinct vertex sets of a mesh's primitives."""
    vertex_sets: dict[object, SharedVertices] = {}
    first_vertex = 0
    for primitive in gltf.meshes[gltf.nodes[node].mesh].primitives:
        if primitive.position_accessor >= 0 and primitive.vertex_key not in vertex_sets:
            count = gltf.accessors.get(primitive.position_accessor).count
            vertex_sets[primitive.vertex_key] = SharedVertices(
                primitive, first_vertex, count
            )
            first_vertex += count
    return list(vertex_sets.values())


def _build_mesh(gltf: Gltf, node: int, name: str, binder: SkinBinder) -> Mesh | None:
    """Return the mesh of a node; None if it has no faces."""
    vertex_sets = shared_vertices(gltf, node)
    first_vertices = {v.primitive.vertex_key: v.first_vertex for v in vertex_sets}
    faces = []
    for primitive in gltf.meshes[gltf.nodes[node].mesh].primitives:
        if primitive.position_accessor >= 0:
            count = gltf.accessors.get(primitive.position_accessor).count
            triangles = build_triangles(primitive, count, gltf.accessors)
            faces.append(triangles + first_vertices[primitive.vertex_key])
    if not sum(map(len, faces)):
        return None
    points = [gltf.accessors.floats(v.primitive.position_accessor) for v in vertex_sets]
    skin, geom_bind = _build_skin(gltf, node, vertex_sets, binder)
    bind = tuple(geom_bind.ravel().tolist())
    normals = _vertex_normals(gltf, vertex_sets)
    return Mesh(
        name,
        LoadedArray(np.concatenate(points)),
        LoadedArray(np.concatenate(faces).astype(np.float64)),
        normals,
        None if (geom_bind == np.eye(4)).all() else bind,
        skin,
        Subdivision.NONE if normals is None else None,
    )


def _vertex_normals(
    gltf: Gltf, vertex_sets: list[SharedVertices]
) -> LoadedArray | None:
    if any(vertices.primitive.normal_accessor < 0 for vertices in vertex_sets):
        return None
    accessors = gltf.accessors
    rows = [
        accessors.floats(vertices.primitive.normal_accessor) for vertices in vertex_sets
    ]
    return LoadedArray(np.concatenate(rows))


def _build_skin(
    gltf: Gltf, node: int, vertex_sets: list[SharedVertices], binder: SkinBinder
) -> tuple[Skin, FloatArray]:
    """Return the skin of a mesh, bound to its joints or else to its node."""
    skin_index = gltf.nodes[node].skin
    if skin_index < 0 or not all(
        vertices.primitive.joint_accessors for vertices in vertex_sets
    ):
        return binder.bind_node(node, sum(vertices.count for vertices in vertex_sets))
    geom_bind, joints = binder.bind_skin(skin_index)
    influences = [
        read_skin_weights(v.primitive, len(joints), gltf.accessors) for v in vertex_sets
    ]
    influence_count = max(indices.shape[1] for indices, _ in influences)
    indices = np.concatenate(
        [_pad_columns(values, influence_count) for values, _ in influences]
    )
    weights = np.concatenate(
        [_pad_columns(values, influence_count) for _, values in influences]
    )
    blended_count = int((weights.max(axis=1) < 1.0 - BLEND_TOLERANCE).sum())
    _warn_of_equal_binds(gltf, skin_index, blended_count)
    return binder.build_skin("linear", joints, indices, weights), geom_bind


def _warn_of_equal_binds(gltf: Gltf, skin_index: int, blended_count: int) -> None:
    """Warn if a skin binds all joints alike although points blend them (GLT119).

    ``blended_count`` points follow several joints. With one joint for each point, the
    points may be stored in the frames of their joints.
    """
    skin = gltf.skins[skin_index]
    binds = skin.inverse_bind
    if len(binds) < MIN_EQUAL_BINDS or not blended_count:
        return
    if np.ptp(binds, axis=0).max() > 0:
        return
    offsets = [
        np.linalg.norm(gltf.nodes[node].translation)
        for node in skin.joints
        if gltf.nodes[node].parent in skin.joints
    ]
    if not any(offsets):
        return
    message = f"the inverse bind matrices of all {len(binds)} joints are equal, but "
    message += f"joints are up to {length_text(float(max(offsets)))} from their "
    message += f"parents, and {counted(blended_count, 'point')} "
    message += "follows" if blended_count == 1 else "follow"
    message += " several of them, so the mesh tears"
    hint = "export it again with the inverse bind matrices of the bind pose"
    gltf.diagnostics.warn(
        "GLT119", f"{skin.location}/inverseBindMatrices", message, hint
    )


def _pad_columns(values: FloatArray | IntArray, width: int) -> FloatArray:
    padded_values = np.zeros((len(values), width))
    padded_values[:, : values.shape[1]] = values
    return padded_values


def _morph_offsets(
    gltf: Gltf, node: int
) -> Iterator[tuple[LoadedArray, LoadedArray | None]]:
    """Yield point and normal offsets of each morph target."""
    vertex_sets = shared_vertices(gltf, node)
    has_normals = all(
        vertices.primitive.normal_accessor >= 0 for vertices in vertex_sets
    )
    for target in range(gltf.meshes[gltf.nodes[node].mesh].target_count):
        targets = [vertices.primitive.targets[target] for vertices in vertex_sets]
        deltas, normals = (
            np.concatenate(
                [
                    np.zeros((v.count, 3)) if i < 0 else gltf.accessors.floats(i)
                    for i, v in zip(indices, vertex_sets, strict=True)
                ]
            )
            for indices in (
                [target.position_accessor for target in targets],
                [target.normal_accessor for target in targets],
            )
        )
        has_normal_offsets = has_normals and normals.any()
        yield LoadedArray(deltas), LoadedArray(normals) if has_normal_offsets else None
