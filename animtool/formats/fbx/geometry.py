"""Meshes of an FBX: control points, faces, skins and blend shapes."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.formats.fbx.elements import Element, floats, integers
from animtool.formats.fbx.layers import DEFORM_PERCENT
from animtool.formats.fbx.objects import (
    FIRST_NUMBERED_VERSION,
    ROOT_IDS,
    FbxFile,
    Object,
    ObjectId,
    scalar,
)
from animtool.formats.fbx.takes import shape_id, shapes_before_7000

LINEAR, DUAL_QUATERNION = "linear", "dual_quaternion"
_BLENDER_EXPORTER = "blender (stable fbx io)"
# Maximum cells of a table of faces or weights.
MAX_TABLE_CELLS = 100_000_000


@dataclass(slots=True, eq=False)
class Cluster:
    """Skin weights of one bone on a mesh.

    Attributes:
        bone: Id of the bone's node.
        from_mesh: bone_from_mesh at bind time ``(4, 4)``.
        world: world_from_bone at bind time ``(4, 4)``.
        indices: Control points ``(N,)``.
        weights: Weights of these ``(N,)`` [1].
        where: Location of its element in the file.
    """

    bone: ObjectId
    from_mesh: FloatArray
    world: FloatArray
    indices: IntArray
    weights: FloatArray
    where: str


@dataclass(slots=True, eq=False)
class ShapeChannel:
    """A blend shape channel with its in-between targets.

    Attributes:
        id: Id of the channel, whose percentage is animated.
        name: Name in the file.
        percent: Weight without animation [%].
        targets: For each target its full weight [%] and offsets ``(V, 3)``.
    """

    id: ObjectId
    name: str
    percent: float
    targets: list[tuple[float, FloatArray]]


@dataclass(slots=True, eq=False)
class FbxGeometry:
    """A mesh, shown by one or several nodes.

    Attributes:
        name: Name in the file, often empty.
        points: Control points ``(V, 3)``.
        faces: Control point indices, padded with -1 ``(N, K)``.
        method: Skinning method.
        clusters: Skin weights by bone.
        shapes: Blend shapes.
    """

    name: str
    points: FloatArray
    faces: IntArray
    method: str = LINEAR
    clusters: list[Cluster] = field(default_factory=list)
    shapes: list[ShapeChannel] = field(default_factory=list)


def read_geometry(file: FbxFile) -> dict[ObjectId, FbxGeometry]:
    """Return the mesh of each node that shows one, by node id."""
    if file.version < FIRST_NUMBERED_VERSION:
        old_meshes = [
            model_object
            for model_object in file.of_kind("Model")
            if model_object.element.find("Vertices")
        ]
        shown_meshes = [(model_object, model_object) for model_object in old_meshes]
        # Instances share the mesh of another object.
        old_meshes = file.of_kind("Geometry", "Mesh")
    else:
        shown_meshes, old_meshes = [], file.of_kind("Geometry", "Mesh")
    for model_object in old_meshes:
        shown_meshes += [
            (model_object, model) for model in file.targets(model_object.id, "Model")
        ]
    meshes_by_id: dict[ObjectId, FbxGeometry | None] = {}
    meshes: dict[ObjectId, FbxGeometry] = {}
    for holder, model in shown_meshes:
        if holder.id not in meshes_by_id:
            meshes_by_id[holder.id] = _read_mesh(file, holder, model)
        mesh = meshes_by_id[holder.id]
        if mesh is not None:
            meshes.setdefault(model.id, mesh)
    return meshes


def _read_mesh(file: FbxFile, mesh_object: Object, model: Object) -> FbxGeometry | None:
    notes, element, name = file.notes, mesh_object.element, model.name
    coordinates = floats(element, "Vertices", notes)
    corners = integers(element, "PolygonVertexIndex", notes)
    if coordinates is None or not len(coordinates):
        return None
    if len(coordinates) % 3:
        message = f"{len(coordinates)} numbers of {name!r} do not make points"
        notes.fail("FBX008", element.where, message)
    points = coordinates.reshape(-1, 3)
    faces = _read_faces(file, mesh_object, corners, len(points), name)
    geometry = FbxGeometry(mesh_object.name, points, faces)
    _add_skin(file, mesh_object, geometry, name)
    _add_shapes(file, mesh_object, geometry, model)
    return geometry


def _read_faces(
    file: FbxFile, mesh_object: Object, corners: IntArray | None, count: int, name: str
) -> IntArray:
    """Return faces; FBX bit-inverts the last corner index of each."""
    if corners is None or not len(corners):
        return np.zeros((0, 3), np.int64)
    is_last = corners < 0
    point_indices = np.where(is_last, ~corners, corners)
    if not is_last[-1] or (point_indices >= count).any() or (point_indices < 0).any():
        message = f"a face of {name!r} has a corner outside its {count} points"
        file.notes.fail("FBX008", mesh_object.element.where, message)
    last_corners = np.flatnonzero(is_last)
    sizes = np.diff(np.concatenate([[-1], last_corners]))
    if int(sizes.max()) * len(sizes) > MAX_TABLE_CELLS:
        message = f"faces of {name!r} have up to {int(sizes.max())} corners"
        file.notes.fail("FBX013", mesh_object.element.where, message)
    rows = np.repeat(np.arange(len(sizes)), sizes)
    columns = np.arange(len(point_indices)) - np.repeat(last_corners + 1 - sizes, sizes)
    faces = np.full((len(sizes), max(3, int(sizes.max()))), -1, np.int64)
    faces[rows, columns] = point_indices
    return faces[sizes >= 3]


def _add_skin(file: FbxFile, mesh_object: Object, mesh: FbxGeometry, name: str) -> None:
    notes = file.notes
    deformers = file.sources(mesh_object.id, "Deformer")
    for deformer in deformers:
        if deformer.subtype not in {"Skin", "BlendShape"}:
            noun = deformer.subtype or "deformer"
            message = f"{noun} {deformer.name!r} of {name!r} is not supported"
            hint = "the mesh follows only its skin, shapes and node"
            notes.warn("FBX107", deformer.element.where, message, hint)
    skins = [deformer for deformer in deformers if deformer.subtype == "Skin"]
    if len(skins) > 1:
        # A skin without weights has no effect.
        skins = [deformer for deformer in skins if _has_weights(file, deformer)]
    if len(skins) > 1:
        message = f"{name!r} has {len(skins)} skins on top of each other"
        notes.fail(
            "FBX004", mesh_object.element.where, message, "export it with one skin"
        )
    for skin in skins:
        for deformer in file.sources(skin.id, "Deformer", "Cluster"):
            cluster = _read_cluster(file, deformer, len(mesh.points), name)
            if cluster is not None:
                mesh.clusters.append(cluster)
        kind = skin.element.find("SkinningType")
        method = "Linear" if kind is None else kind.text(0)
        if method == "DualQuaternion":
            mesh.method = DUAL_QUATERNION
        elif method not in {"Linear", "Rigid", ""}:
            message = f"skin of {name!r}: {method.lower()} of linear and dual "
            message += "quaternion, read as linear"
            notes.warn("FBX108", skin.element.where, message)


def _has_weights(file: FbxFile, skin: Object) -> bool:
    clusters = file.sources(skin.id, "Deformer", "Cluster")
    indices = [integers(cluster.element, "Indexes", file.notes) for cluster in clusters]
    return any(cluster is not None and len(cluster) for cluster in indices)


def _read_cluster(
    file: FbxFile, source: Object, points: int, name: str
) -> Cluster | None:
    notes, element = file.notes, source.element
    bones = [
        bone_object
        for bone_object in file.sources(source.id, "Model")
        if bone_object.id not in ROOT_IDS
    ]
    indices = integers(element, "Indexes", notes)
    weights = floats(element, "Weights", notes)
    if indices is None or weights is None or not len(indices):
        return None
    if not bones:
        message = f"a cluster of {name!r} has no bone: its weights are ignored"
        notes.warn("FBX106", element.where, message)
        return None
    mode = element.find("Mode")
    if mode is not None and mode.text(0) == "Additive":
        message = f"skin of {name!r}: additive cluster {source.name!r} is not supported"
        notes.fail("FBX004", element.where, message)
    if len(indices) != len(weights):
        message = (
            f"{len(indices)} indices of {source.name!r} have {len(weights)} weights"
        )
        notes.fail("FBX008", element.where, message)
    if (indices < 0).any() or (indices >= points).any():
        message = (
            f"cluster {source.name!r} refers to a point that {name!r} does not have"
        )
        notes.fail("FBX008", element.where, message)
    if (weights < -1e-6).any():
        message = f"cluster {source.name!r} has negative weights"
        notes.fail("FBX008", element.where, message)
    matrices = [
        _read_matrix(file, element, key) for key in ("Transform", "TransformLink")
    ]
    return Cluster(
        bones[0].id,
        matrices[0],
        matrices[1],
        indices,
        np.maximum(weights, 0.0),
        element.where,
    )


def _read_matrix(file: FbxFile, element: Element, name: str) -> FloatArray:
    """Return a column-vector matrix; files store row-vector ones."""
    numbers = floats(element, name, file.notes, 16)
    if numbers is None:
        return np.eye(4)
    matrix = numbers.reshape(4, 4).T.copy()
    size = float(np.abs(matrix[:3, :3]).max())
    singular = not size or abs(np.linalg.det(matrix[:3, :3] / size)) < 1e-12
    if singular or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-4:
        message = f"{name} has no inverse"
        file.notes.fail("FBX008", element.where, message)
    return matrix


def skin_table(mesh: FbxGeometry) -> tuple[IntArray, FloatArray]:
    """Return cluster indices and weights of each point ``(V, I)``.

    Weights are normalised. The cluster after the last is the mesh's own node, which
    moves points without weights.
    """
    count, clusters = len(mesh.points), len(mesh.clusters)
    points = np.concatenate([cluster.indices for cluster in mesh.clusters])
    weights = np.concatenate([cluster.weights for cluster in mesh.clusters])
    sizes = [len(cluster.indices) for cluster in mesh.clusters]
    of = np.repeat(np.arange(clusters), sizes)
    has_weight = weights > 0
    points, weights, of = points[has_weight], weights[has_weight], of[has_weight]
    order = np.argsort(points, kind="stable")
    points, weights, of = points[order], weights[order], of[order]
    influence_counts = np.bincount(points, minlength=count)
    width = max(1, int(influence_counts.max(initial=0)))
    starts = np.concatenate([[0], np.cumsum(influence_counts)[:-1]])
    columns = np.arange(len(points)) - starts[points]
    indices = np.zeros((count, width), np.int64)
    table = np.zeros((count, width))
    indices[points, columns], table[points, columns] = of, weights
    weight_sums = table.sum(axis=1, keepdims=True)
    is_unweighted = weight_sums[:, 0] <= 0
    indices[is_unweighted, 0], table[is_unweighted, 0] = clusters, 1.0
    return indices, table / np.where(weight_sums <= 0, 1.0, weight_sums)


def has_free_points(mesh: FbxGeometry) -> bool:
    """Return whether some point of a skinned mesh has no weights."""
    weight_sums = np.zeros(len(mesh.points))
    for cluster in mesh.clusters:
        np.add.at(weight_sums, cluster.indices, cluster.weights)
    return bool((weight_sums <= 0).any())


def _add_shapes(
    file: FbxFile, mesh_object: Object, mesh: FbxGeometry, model: Object
) -> None:
    notes = file.notes
    for shape in (
        shapes_before_7000(file, model) if file.version < FIRST_NUMBERED_VERSION else ()
    ):
        offsets = _shape_offsets(file, shape, shape.text(0), len(mesh.points))
        percent = scalar(model, shape.text(0), 0.0, notes)
        channel_id = shape_id(model.id, shape.text(0))
        mesh.shapes.append(
            ShapeChannel(channel_id, shape.text(0), percent, [(100.0, offsets)])
        )
    for group in file.sources(mesh_object.id, "Deformer", "BlendShape"):
        for channel in file.sources(group.id, "Deformer", "BlendShapeChannel"):
            channel_ = _read_shape_channel(file, channel, len(mesh.points))
            if channel_ is not None:
                mesh.shapes.append(channel_)


def _read_shape_channel(
    file: FbxFile, source: Object, points: int
) -> ShapeChannel | None:
    notes, element = file.notes, source.element
    shapes = file.sources(source.id, "Geometry", "Shape")
    if not shapes:
        return None
    full_weights = floats(element, "FullWeights", notes)
    point_percents = None
    if full_weights is not None and _counts_points(file):
        point_percents, full_weights = full_weights, None
        if len(shapes) > 1:
            full_weights = np.full(len(shapes), 100.0)
    if full_weights is None or len(full_weights) < len(shapes):
        if len(shapes) > 1:
            message = (
                f"{counted(len(shapes), 'shape')} of {source.name!r} have no weights"
            )
            notes.fail("FBX008", element.where, message)
        full_weights = np.array([100.0])
    percent = scalar(source, DEFORM_PERCENT, 0.0, notes)
    if DEFORM_PERCENT not in source.properties:
        percents = floats(element, DEFORM_PERCENT, notes)
        percent = (
            float(percents[0]) if percents is not None and len(percents) else percent
        )
    targets = []
    for shape, at in zip(shapes, full_weights.tolist(), strict=False):
        offsets = _shape_offsets(
            file, shape.element, shape.name, points, point_percents
        )
        targets.append((at, offsets))
    targets.sort(key=lambda target_: target_[0])
    return ShapeChannel(source.id, source.name, percent, targets)


def _counts_points(file: FbxFile) -> bool:
    """Return whether full weights are per point (Blender writes vertex groups)."""
    header = file.root.find("FBXHeaderExtension")
    creators = [
        creator for top in (file.root, header) if top for creator in top.all("Creator")
    ]
    return any(
        creator.text(0).lower().startswith(_BLENDER_EXPORTER) for creator in creators
    )


def _shape_offsets(
    file: FbxFile,
    element: Element,
    name: str,
    points: int,
    percents: FloatArray | None = None,
) -> FloatArray:
    """Return the point offsets of a shape ``(V, 3)``.

    ``percents`` is the percentage of each stated offset that applies [%].
    """
    notes = file.notes
    table = np.zeros((points, 3))
    indices = integers(element, "Indexes", notes)
    coordinates = floats(element, "Vertices", notes)
    if indices is None or coordinates is None or not len(indices):
        return table
    if len(coordinates) != 3 * len(indices):
        message = (
            f"{len(indices)} indices of shape {name!r} have {len(coordinates)} numbers"
        )
        notes.fail("FBX008", element.where, message)
    if (indices < 0).any() or (indices >= points).any():
        message = f"shape {name!r} counts a point that its mesh has not"
        notes.fail("FBX008", element.where, message)
    offsets = coordinates.reshape(-1, 3)
    if percents is not None and len(percents) == len(offsets):
        offsets = offsets * (percents[:, None] / 100.0)
    table[indices] = offsets
    return table
