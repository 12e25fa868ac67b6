"""Warnings about strands whose points seem to go from tip to root."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.quantities import length_text
from animtool.documents.arrays import Archives
from animtool.documents.document import Document
from animtool.rig.parts import AttachKind, Attachment, Mesh
from animtool.rig.schema import RigModel
from animtool.rig.skeleton import Rig

# Number of sampled strands, and of distances that are computed together.
MAX_STRANDS, CHUNK_SIZE = 16, 1_000_000
# Distance of the last point of a reversed strand from the surface, relative to that of
# the first, and distance of the first relative to the strand's length [1].
MAX_LAST_RATIO, MIN_FIRST_RATIO = 0.25, 0.1
# Fraction of the strands that are reversed [1].
MIN_REVERSED_FRACTION = 0.8


def warn_of_strands(document: Document, model: RigModel, rig: Rig) -> None:
    """Warn of strands whose tips are at the surface, and not their roots (RIG119)."""
    attachment_by_name = {entry.name: entry for entry in rig.attach}
    for i, entry in enumerate(model.attach):
        attachment = attachment_by_name.get(entry.name)
        if attachment is None or attachment.kind != AttachKind.STRANDS:
            continue
        try:
            with Archives() as archives:
                message = _reversal_text(rig, attachment, archives)
        except ValueError:
            continue
        if message is not None:
            hint = "strands go from root to tip: reverse the points of each, in numpy "
            hint += "points[:, ::-1]"
            document.warn("RIG119", ("attach", i, "points"), message, hint)


def _reversal_text(rig: Rig, attachment: Attachment, archives: Archives) -> str | None:
    """Return a message if strands are reversed, else None."""
    if attachment.points is None or not attachment.joints:
        return None
    strand_points = attachment.points.load(archives)
    strand_points = strand_points[:: -(-len(strand_points) // MAX_STRANDS)]
    first_distances = np.full(len(strand_points), np.inf)
    last_distances = first_distances.copy()
    nearest_meshes = np.zeros(len(strand_points), np.int64)
    nearest_vertices = nearest_meshes.copy()
    for i, mesh in enumerate(rig.meshes):
        vertices = _bind_points(mesh, archives)
        vertex_distances, _ = _nearest_vertices(strand_points[:, 0], vertices)
        first_distances = np.minimum(first_distances, vertex_distances)
        vertex_distances, nearest = _nearest_vertices(strand_points[:, -1], vertices)
        is_nearer = vertex_distances < last_distances
        last_distances = np.minimum(last_distances, vertex_distances)
        nearest_meshes[is_nearer] = i
        nearest_vertices[is_nearer] = nearest[is_nearer]
    lengths = np.linalg.norm(np.diff(strand_points, axis=1), axis=2).sum(axis=1)
    is_reversed = last_distances < MAX_LAST_RATIO * first_distances
    is_reversed &= first_distances > MIN_FIRST_RATIO * lengths
    is_reversed &= np.isfinite(first_distances)
    if float(is_reversed.mean()) < MIN_REVERSED_FRACTION:
        return None
    # The tips of long hair may touch the shoulders.
    carrier_names = _subtree_names(rig, attachment)
    for i in set(nearest_meshes.tolist()):
        strand_indices = np.flatnonzero(nearest_meshes == i)
        vertices_of_mesh = nearest_vertices[strand_indices]
        is_reversed[strand_indices] &= _follows_joints(
            rig.meshes[i], vertices_of_mesh, carrier_names, archives
        )
    if float(is_reversed.mean()) < MIN_REVERSED_FRACTION:
        return None
    first, last = (
        length_text(float(np.median(vertex_distances)) * rig.meters_per_unit)
        for vertex_distances in (first_distances, last_distances)
    )
    return (
        f"first points are typically {first} from the surface, but last points {last}: "
        "the roots seem to be last"
    )


def _subtree_names(rig: Rig, attachment: Attachment) -> frozenset[str]:
    """Return the names of the joint that carries strands and of all joints below it."""
    names = {attachment.joints[0]}
    for joint in rig.joints:
        if joint.parent >= 0 and rig.joints[joint.parent].name in names:
            names.add(joint.name)
    return frozenset(names)


def _bind_points(mesh: Mesh, archives: Archives) -> FloatArray:
    """Return the world positions of a mesh at bind time ``(V, 3)``."""
    points = mesh.points.load(archives)
    if mesh.geom_bind is None:
        return points
    matrix = np.array(mesh.geom_bind).reshape(4, 4)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _nearest_vertices(
    points: FloatArray, vertices: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the distance and index of the vertex nearest to each point ``(N, 3)``."""
    squared_distances = np.full(len(points), np.inf)
    nearest_indices = np.zeros(len(points), np.int64)
    chunk_size = max(1, CHUNK_SIZE // max(1, len(points)))
    for chunk_start in range(0, len(vertices), chunk_size):
        chunk_vertices = vertices[chunk_start : chunk_start + chunk_size]
        # Without the squares of the points, which change no order.
        chunk_squares = np.einsum("vc,vc->v", chunk_vertices, chunk_vertices)
        chunk_squares = chunk_squares - 2.0 * (points @ chunk_vertices.T)
        indices = chunk_squares.argmin(axis=1)
        offsets = points - chunk_vertices[indices]
        smallest_squares = np.einsum("nc,nc->n", offsets, offsets)
        nearest_indices = np.where(
            smallest_squares < squared_distances, chunk_start + indices, nearest_indices
        )
        squared_distances = np.minimum(squared_distances, smallest_squares)
    return np.sqrt(squared_distances), nearest_indices


def _follows_joints(
    mesh: Mesh, vertices: IntArray, carrier_names: frozenset[str], archives: Archives
) -> BoolArray:
    """Return a mask of the vertices that mostly follow one of the joints ``(N,)``.

    Vertices without a skin may follow any joint.
    """
    if mesh.skin is None:
        return np.ones(len(vertices), bool)
    weights = mesh.skin.weights.load(archives)[vertices]
    columns = mesh.skin.indices.load(archives)[vertices].astype(np.int64)
    largest_influences = columns[np.arange(len(vertices)), weights.argmax(axis=1)]
    is_carrier = np.array([name in carrier_names for name in mesh.skin.joints], bool)
    return np.asarray(is_carrier[largest_influences])
