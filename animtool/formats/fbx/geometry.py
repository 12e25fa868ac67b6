"""Reads the meshes of an FBX: points, faces, skins and blend shapes."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.formats.fbx.elements import Element, read_floats, read_integers
from animtool.formats.fbx.layers import DEFORM_PERCENT
from animtool.formats.fbx.objects import (
    FIRST_NUMBERED_VERSION,
    ROOT_IDS,
    FbxFile,
    FbxObject,
    ObjectId,
    read_scalar,
)
from animtool.formats.fbx.takes import old_shape_id, old_shapes

LINEAR_SKINNING, DUAL_QUATERNION_SKINNING = "linear", "dual_quaternion"
_BLENDER_EXPORTER = "blender (stable fbx io)"
# Maximum size of the padded table of a mesh's faces.
MAX_TABLE_VALUES = 100_000_000


@dataclass(slots=True, eq=False)
class Cluster:
    """The points that one bone of a skin deforms, and their weights."""

    bone: ObjectId  # Id of the bone's node
    bone_from_mesh: FloatArray  # transform at bind time ``(4, 4)``
    world_from_bone: FloatArray  # transform at bind time ``(4, 4)``
    indices: IntArray  # control points ``(N,)``
    weights: FloatArray  # weights of the control points ``(N,)`` [1]
    location: str  # location of its element in the file


@dataclass(slots=True, eq=False)
class ShapeChannel:
    """A blend shape channel with its in-between targets."""

    id: ObjectId  # Id of the channel, whose percentage is animated
    name: str  # name in the file
    percent: float  # weight without animation [%]
    # For each target its full weight [%] and offsets ``(V, 3)``.
    targets: list[tuple[float, FloatArray]]


@dataclass(slots=True, eq=False)
class FbxGeometry:
    """A mesh with its skin weights and blend shapes, which several nodes may show."""

    name: str  # name in the file, often empty
    points: FloatArray  # control points ``(V, 3)``
    faces: IntArray  # control point indices, padded with -1 ``(N, K)``
    method: str = LINEAR_SKINNING  # skinning method
    clusters: list[Cluster] = field(default_factory=list)  # skin weights by bone
    shapes: list[ShapeChannel] = field(default_factory=list)  # blend shapes


def read_geometry(file: FbxFile) -> dict[ObjectId, FbxGeometry]:
    """Return the mesh of each node that has one, by node id."""
    mesh_models = []
    if file.version < FIRST_NUMBERED_VERSION:
        # Models have their own mesh, but instances share the mesh of another object.
        models = file.objects_of_kind("Model")
        mesh_models = [(m, m) for m in models if m.element.find("Vertices")]
    for mesh_object in file.objects_of_kind("Geometry", "Mesh"):
        mesh_models += [(mesh_object, m) for m in file.targets(mesh_object.id, "Model")]
    meshes_by_object: dict[ObjectId, FbxGeometry | None] = {}
    meshes: dict[ObjectId, FbxGeometry] = {}
    for mesh_object, model in mesh_models:
        if mesh_object.id not in meshes_by_object:
            meshes_by_object[mesh_object.id] = _read_mesh(file, mesh_object, model)
        mesh = meshes_by_object[mesh_object.id]
        if mesh is not None:
            meshes.setdefault(model.id, mesh)
    return meshes


def _read_mesh(
    file: FbxFile, mesh_object: FbxObject, model: FbxObject
) -> FbxGeometry | None:
    diagnostics, element, name = file.diagnostics, mesh_object.element, model.name
    coordinates = read_floats(element, "Vertices", diagnostics)
    vertex_indices = read_integers(element, "PolygonVertexIndex", diagnostics)
    if coordinates is None or not len(coordinates):
        return None
    if len(coordinates) % 3:
        message = f"{len(coordinates)} numbers of {name!r} do not make points"
        diagnostics.fail("FBX008", element.location, message)
    points = coordinates.reshape(-1, 3)
    faces = _read_faces(file, mesh_object, vertex_indices, len(points), name)
    geometry = FbxGeometry(mesh_object.name, points, faces)
    _add_skin(file, mesh_object, geometry, name)
    _add_shapes(file, mesh_object, geometry, model)
    return geometry


def _read_faces(
    file: FbxFile,
    mesh_object: FbxObject,
    vertex_indices: IntArray | None,
    point_count: int,
    name: str,
) -> IntArray:
    """Return faces padded with -1; FBX bit-inverts the last index of each face."""
    if vertex_indices is None or not len(vertex_indices):
        return np.zeros((0, 3), np.int64)
    is_last = vertex_indices < 0
    point_indices = np.where(is_last, ~vertex_indices, vertex_indices)
    is_valid = (point_indices >= 0) & (point_indices < point_count)
    if not is_last[-1] or not is_valid.all():
        message = f"a face of {name!r} has a corner outside its {point_count} points"
        file.diagnostics.fail("FBX008", mesh_object.element.location, message)
    last_corner_indices = np.flatnonzero(is_last)
    corner_counts = np.diff(np.concatenate([[-1], last_corner_indices]))
    if int(corner_counts.max()) * len(corner_counts) > MAX_TABLE_VALUES:
        message = f"faces of {name!r} have up to {int(corner_counts.max())} corners"
        file.diagnostics.fail("FBX013", mesh_object.element.location, message)
    face_indices = np.repeat(np.arange(len(corner_counts)), corner_counts)
    first_corner_indices = last_corner_indices + 1 - corner_counts
    corner_numbers = np.arange(len(point_indices)) - first_corner_indices[face_indices]
    table_shape = len(corner_counts), max(3, int(corner_counts.max()))
    faces = np.full(table_shape, -1, np.int64)
    faces[face_indices, corner_numbers] = point_indices
    return faces[corner_counts >= 3]


def _add_skin(
    file: FbxFile, mesh_object: FbxObject, mesh: FbxGeometry, name: str
) -> None:
    diagnostics = file.diagnostics
    deformers = file.sources(mesh_object.id, "Deformer")
    for deformer in deformers:
        if deformer.subtype not in {"Skin", "BlendShape"}:
            noun = deformer.subtype or "deformer"
            message = f"{noun} {deformer.name!r} of {name!r} is not supported"
            hint = "the mesh follows only its skin, shapes and node; bake the deformer "
            hint += "into shapes, or export USD"
            diagnostics.warn("FBX107", deformer.element.location, message, hint)
    skins = [deformer for deformer in deformers if deformer.subtype == "Skin"]
    if len(skins) > 1:
        # A skin without weights has no effect.
        skins = [deformer for deformer in skins if _has_weights(file, deformer)]
    if len(skins) > 1:
        message = f"{name!r} has {len(skins)} skins on top of each other"
        hint = "export it with one skin"
        diagnostics.fail("FBX004", mesh_object.element.location, message, hint)
    for skin in skins:
        for deformer in file.sources(skin.id, "Deformer", "Cluster"):
            cluster = _read_cluster(file, deformer, len(mesh.points), name)
            if cluster is not None:
                mesh.clusters.append(cluster)
        type_element = skin.element.find("SkinningType")
        method = "Linear" if type_element is None else type_element.text(0)
        if method == "DualQuaternion":
            mesh.method = DUAL_QUATERNION_SKINNING
        elif method not in {"Linear", "Rigid", ""}:
            message = f"the skinning method of {name!r} is {method[:40]!r}; it is "
            message += "read as linear"
            if method == "Blend":
                message = f"{name!r} blends linear and dual quaternion skinning, but "
                message += "is read as linear"
            hint = "twisted joints may lose volume; use only linear or dual quaternion"
            diagnostics.warn("FBX108", skin.element.location, message, hint)


def _has_weights(file: FbxFile, skin: FbxObject) -> bool:
    clusters = file.sources(skin.id, "Deformer", "Cluster")
    all_indices = [
        read_integers(c.element, "Indexes", file.diagnostics) for c in clusters
    ]
    return any(indices is not None and len(indices) for indices in all_indices)


def _read_cluster(
    file: FbxFile, cluster_object: FbxObject, point_count: int, name: str
) -> Cluster | None:
    diagnostics, element = file.diagnostics, cluster_object.element
    bones = [
        b for b in file.sources(cluster_object.id, "Model") if b.id not in ROOT_IDS
    ]
    indices = read_integers(element, "Indexes", diagnostics)
    weights = read_floats(element, "Weights", diagnostics)
    if indices is None or weights is None or not len(indices):
        return None
    if not bones:
        message = f"a cluster of {name!r} has no bone: its weights are ignored"
        diagnostics.warn("FBX106", element.location, message)
        return None
    mode = element.find("Mode")
    if mode is not None and mode.text(0) == "Additive":
        message = f"skin of {name!r}: additive cluster {cluster_object.name!r} is not "
        message += "supported"
        diagnostics.fail("FBX004", element.location, message)
    if len(indices) != len(weights):
        message = (
            f"{len(indices)} indices of {cluster_object.name!r} have {len(weights)} "
        )
        message += "weights"
        diagnostics.fail("FBX008", element.location, message)
    if (indices < 0).any() or (indices >= point_count).any():
        message = (
            f"cluster {cluster_object.name!r} refers to a point that {name!r} does not "
        )
        message += "have"
        diagnostics.fail("FBX008", element.location, message)
    if (weights < -1e-6).any():
        message = f"cluster {cluster_object.name!r} has negative weights"
        diagnostics.fail("FBX008", element.location, message)
    bone_from_mesh = _read_matrix(file, element, "Transform")
    world_from_bone = _read_matrix(file, element, "TransformLink")
    weights = np.maximum(weights, 0.0)
    return Cluster(
        bones[0].id, bone_from_mesh, world_from_bone, indices, weights, element.location
    )


def _read_matrix(file: FbxFile, element: Element, name: str) -> FloatArray:
    """Return a matrix for column vectors; files store it for row vectors."""
    numbers = read_floats(element, name, file.diagnostics, 16)
    if numbers is None:
        return np.eye(4)
    matrix = numbers.reshape(4, 4).T.copy()
    linear = matrix[:3, :3]
    max_magnitude = float(np.abs(linear).max())
    is_singular = (
        not max_magnitude or abs(np.linalg.det(linear / max_magnitude)) < 1e-12
    )
    if is_singular or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-4:
        message = f"{name} has no inverse"
        file.diagnostics.fail("FBX008", element.location, message)
    return matrix


def build_skin_table(mesh: FbxGeometry) -> tuple[IntArray, FloatArray]:
    """Return cluster indices and weights of each point ``(V, I)``.

    Weights are normalised. The index after the last cluster is the mesh's own node,
    which moves points without weights.
    """
    point_count, cluster_count = len(mesh.points), len(mesh.clusters)
    points = np.concatenate([cluster.indices for cluster in mesh.clusters])
    weights = np.concatenate([cluster.weights for cluster in mesh.clusters])
    cluster_sizes = [len(cluster.indices) for cluster in mesh.clusters]
    cluster_indices = np.repeat(np.arange(cluster_count), cluster_sizes)
    order = np.argsort(points, kind="stable")
    order = order[weights[order] > 0]
    points, weights = points[order], weights[order]
    cluster_indices = cluster_indices[order]
    influence_counts = np.bincount(points, minlength=point_count)
    influence_count = max(1, int(influence_counts.max(initial=0)))
    first_influences = np.concatenate([[0], np.cumsum(influence_counts)[:-1]])
    columns = np.arange(len(points)) - first_influences[points]
    cluster_table = np.zeros((point_count, influence_count), np.int64)
    weight_table = np.zeros((point_count, influence_count))
    cluster_table[points, columns], weight_table[points, columns] = (
        cluster_indices,
        weights,
    )
    weight_sums = weight_table.sum(axis=1, keepdims=True)
    is_unweighted = weight_sums[:, 0] <= 0
    cluster_table[is_unweighted, 0], weight_table[is_unweighted, 0] = cluster_count, 1.0
    return cluster_table, weight_table / np.where(weight_sums <= 0, 1.0, weight_sums)


def has_unweighted_points(mesh: FbxGeometry) -> bool:
    """Return whether any point of a skinned mesh has no weights."""
    weight_sums = np.zeros(len(mesh.points))
    for cluster in mesh.clusters:
        np.add.at(weight_sums, cluster.indices, cluster.weights)
    return bool((weight_sums <= 0).any())


def _add_shapes(
    file: FbxFile, mesh_object: FbxObject, mesh: FbxGeometry, model: FbxObject
) -> None:
    is_old = file.version < FIRST_NUMBERED_VERSION
    for shape in old_shapes(file, model) if is_old else ():
        name = shape.text(0)
        offsets = _shape_offsets(file, shape, name, len(mesh.points))
        percent, targets = (
            read_scalar(model, name, 0.0, file.diagnostics),
            [(100.0, offsets)],
        )
        channel_id = old_shape_id(model.id, name)
        mesh.shapes.append(ShapeChannel(channel_id, name, percent, targets))
    for blend_shape in file.sources(mesh_object.id, "Deformer", "BlendShape"):
        for channel_object in file.sources(
            blend_shape.id, "Deformer", "BlendShapeChannel"
        ):
            shape_channel = _read_shape_channel(file, channel_object, len(mesh.points))
            if shape_channel is not None:
                mesh.shapes.append(shape_channel)


def _read_shape_channel(
    file: FbxFile, channel_object: FbxObject, point_count: int
) -> ShapeChannel | None:
    diagnostics, element = file.diagnostics, channel_object.element
    shapes = file.sources(channel_object.id, "Geometry", "Shape")
    if not shapes:
        return None
    full_weights = read_floats(element, "FullWeights", diagnostics)
    point_percents = None
    if full_weights is not None and _has_weights_per_point(file):
        point_percents, full_weights = full_weights, None
        if len(shapes) > 1:
            full_weights = np.full(len(shapes), 100.0)
    if full_weights is None or len(full_weights) < len(shapes):
        if len(shapes) > 1:
            message = (
                f"{counted(len(shapes), 'shape')} of {channel_object.name!r} have no "
            )
            message += "weights"
            diagnostics.fail("FBX008", element.location, message)
        full_weights = np.array([100.0])
    percent = read_scalar(channel_object, DEFORM_PERCENT, 0.0, diagnostics)
    if DEFORM_PERCENT not in channel_object.properties:
        percents = read_floats(element, DEFORM_PERCENT, diagnostics)
        if percents is not None and len(percents):
            percent = float(percents[0])
    targets = []
    for shape, full_weight in zip(shapes, full_weights.tolist(), strict=False):
        offsets = _shape_offsets(
            file, shape.element, shape.name, point_count, point_percents
        )
        targets.append((full_weight, offsets))
    targets.sort(key=lambda target: target[0])
    return ShapeChannel(channel_object.id, channel_object.name, percent, targets)


def _has_weights_per_point(file: FbxFile) -> bool:
    """Return whether full weights are per point, as Blender writes them."""
    header = file.root.find("FBXHeaderExtension")
    creators = [c for e in (file.root, header) if e for c in e.find_all("Creator")]
    return any(c.text(0).lower().startswith(_BLENDER_EXPORTER) for c in creators)


def _shape_offsets(
    file: FbxFile,
    element: Element,
    name: str,
    point_count: int,
    percents: FloatArray | None = None,
) -> FloatArray:
    """Return the point offsets of a shape ``(V, 3)``.

    ``percents`` is the applied percentage of each offset [%].
    """
    diagnostics = file.diagnostics
    point_offsets = np.zeros((point_count, 3))
    indices = read_integers(element, "Indexes", diagnostics)
    coordinates = read_floats(element, "Vertices", diagnostics)
    if indices is None or coordinates is None or not len(indices):
        return point_offsets
    if len(coordinates) != 3 * len(indices):
        message = f"{len(indices)} indices of shape {name!r} have {len(coordinates)} "
        message += "numbers"
        diagnostics.fail("FBX008", element.location, message)
    if (indices < 0).any() or (indices >= point_count).any():
        message = f"shape {name!r} counts a point that its mesh has not"
        diagnostics.fail("FBX008", element.location, message)
    offsets = coordinates.reshape(-1, 3)
    if percents is not None and len(percents) == len(offsets):
        offsets = offsets * (percents[:, None] / 100.0)
    point_offsets[indices] = offsets
    return point_offsets
