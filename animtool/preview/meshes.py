"""Adds meshes and strands of characters, which the viewer skins or plays as caches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths.faces import triangulate
from animtool.preview.draft import PageDraft
from animtool.preview.open_file import TakeToShow
from animtool.preview.streams import QuantizedValues, json_numbers, quantize_range
from animtool.preview.takes import PageTake
from animtool.rig.surfaces import Surface
from animtool.skin.character import CharacterMesh, character_meshes
from animtool.skin.deform import deform
from animtool.skin.shapes import PreparedShapes, column_weights
from animtool.skin.skinning import PreparedSkin, SkinMethod

# Maximum number of influences per vertex in the viewer.
MAX_INFLUENCES = 4
# A mesh is drawn as a point cache if the four strongest influences of a vertex leave
# out more weight than this.
MAX_LOST_WEIGHT = 0.02
# Frames whose points are in memory at once.
BLOCK_FRAMES = 64
MESH_COLORS = (
    (0.53, 0.56, 0.6),
    (0.6, 0.5, 0.42),
    (0.44, 0.55, 0.5),
    (0.55, 0.48, 0.57),
)
STRAND_WIDTH = 0.001
WEIGHT_TOLERANCE = 1e-4


def add_character(draft: PageDraft, character: TakeToShow, page_take: PageTake) -> None:
    """Add the meshes and strands of a take to a page."""
    shape_names = [shape.name for shape in page_take.rig.shapes]
    meshes = character_meshes(
        character.surfaces, page_take.rig.names, character.bind, shape_names
    )
    visible_weights: list[FloatArray] = []
    shape_labels: list[str] = []
    for surface, mesh in zip(character.surfaces, meshes, strict=True):
        colors = character.colors.get(surface.name)
        entry = _mesh_entry(draft, page_take, surface, colors)
        draft.meshes.append(entry)
        if needs_point_cache(mesh.mesh.skin):
            draft.add_notice(
                f"mesh {surface.name!r} is drawn from its points: the viewer skins "
                "linearly with four joints per vertex"
            )
            entry["cache"] = _point_stream(draft, page_take, mesh)
            continue
        if mesh.mesh.skin is not None:
            entry["skin"] = _skin_entry(draft, mesh.mesh.skin)
        shape_weights = mesh.weights(page_take.weights)
        if mesh.mesh.shapes is not None and shape_weights is not None:
            column_values = column_weights(mesh.mesh.shapes, shape_weights)
            active_columns = np.flatnonzero(column_values.any(axis=0))
            entry["shapes"] = _shape_entries(
                draft, mesh.mesh.shapes, active_columns, len(shape_labels)
            )
            shape_labels += [
                entry["shapes"][i]["name"] for i in range(len(active_columns))
            ]
            visible_weights.append(column_values[:, active_columns])
    if shape_labels:
        all_weights = np.concatenate(visible_weights, axis=1)
        quantized_weights = quantize_range(all_weights, WEIGHT_TOLERANCE)
        page_take.entry["shapes"] = {
            "names": shape_labels,
            "weights": draft.packer.add(quantized_weights),
        }
    for strands in character.strands:
        strand_count, points_per_strand = strands.points.shape[:2]
        joint = page_take.rig.index(strands.joint)
        draft.curves.append(
            {
                "name": strands.name,
                "take": page_take.index,
                "joint": joint,
                "bind": json_numbers(
                    np.linalg.inv(character.bind[joint]).T.reshape(-1), 9
                ),
                "counts": draft.packer.add_static(
                    np.full(strand_count, points_per_strand), "u32"
                ),
                "points": draft.packer.add_static_range(strands.points),
                "width": STRAND_WIDTH,
                "color": None,
            }
        )


def needs_point_cache(skin: PreparedSkin | None) -> bool:
    """Return whether a mesh needs a point cache, since the viewer cannot skin it."""
    if skin is None:
        return False
    if skin.method is SkinMethod.DUAL_QUATERNION:
        return True
    _, weights = largest_influences(skin)
    return bool((1 - weights.sum(axis=1)).max(initial=0.0) > MAX_LOST_WEIGHT)


def largest_influences(skin: PreparedSkin) -> tuple[IntArray, FloatArray]:
    """Return the joints and weights of the four largest influences ``(V, 4)``."""
    influences = skin.influences
    influence_counts = np.diff(influences.row_starts)
    vertex_indices = np.repeat(np.arange(skin.vertex_count), influence_counts)
    ranks = np.arange(len(influences.joints)) - np.repeat(
        influences.row_starts[:-1], influence_counts
    )
    is_kept = ranks < MAX_INFLUENCES
    joints = np.zeros((skin.vertex_count, MAX_INFLUENCES), np.int64)
    weights = np.zeros((skin.vertex_count, MAX_INFLUENCES))
    joints[vertex_indices[is_kept], ranks[is_kept]] = influences.joints[is_kept]
    weights[vertex_indices[is_kept], ranks[is_kept]] = influences.weights[is_kept]
    return joints, weights


def mesh_entry(
    draft: PageDraft,
    name: str,
    points: FloatArray,
    counts: IntArray,
    indices: IntArray,
    color: Sequence[float] | None,
    *,
    take: int | None = None,
    colors: FloatArray | None = None,
) -> dict[str, Any]:
    """Return the manifest entry of a mesh with its points and triangles.

    ``colors``: linear colors of the points ``(V, 3)``; None to use one ``color``.
    """
    default_color = MESH_COLORS[len(draft.meshes) % len(MESH_COLORS)]
    triangles = triangulate(counts, indices)
    return {
        "name": name,
        "take": take,
        "points": draft.packer.add_static_range(points),
        "faces": draft.packer.add_static(triangles, "u32"),
        "skin": None,
        "shapes": [],
        "cache": None,
        "color": list(default_color if color is None else color),
        "colors": None
        if colors is None
        # sRGB colors, for which 8 bits are enough.
        else draft.packer.add_static(
            np.rint(colors.clip(0, 1) ** (1 / 2.2) * 255).astype(np.uint8), "u8"
        ),
    }


def _mesh_entry(
    draft: PageDraft, page_take: PageTake, surface: Surface, colors: FloatArray | None
) -> dict[str, Any]:
    """Return the manifest entry of a character's surface."""
    points = surface.points
    if surface.skin is None:
        # The mesh is not attached to a joint or transform.
        points = points @ surface.geom_bind[:3, :3].T + surface.geom_bind[:3, 3]
    return mesh_entry(
        draft,
        surface.name,
        points,
        surface.counts,
        surface.indices,
        colors[0].tolist() if colors is not None and len(colors) == 1 else None,
        take=page_take.index,
        colors=colors if colors is not None and len(colors) == len(points) else None,
    )


def _skin_entry(draft: PageDraft, skin: PreparedSkin) -> dict[str, Any]:
    """Return the manifest entry of a skin binding."""
    joints, weights = largest_influences(skin)
    weight_sums = weights.sum(axis=1, keepdims=True)
    weights = np.divide(
        weights, weight_sums, out=np.zeros_like(weights), where=weight_sums > 0
    )
    # Weights are rounded to a sum of 1: the strongest takes the remainder.
    integer_weights = np.rint(weights * 65535)
    integer_weights[:, 0] += np.where(
        weight_sums[:, 0] > 0, 65535 - integer_weights.sum(axis=1), 0
    )
    stored_weights = integer_weights.reshape(1, -1).astype("<u2")
    bind = skin.joint_from_world @ skin.world_from_points
    return {
        "palette": skin.joints.tolist(),
        "joints": draft.packer.add_static(joints, "u16"),
        "weights": draft.packer.add(QuantizedValues(stored_weights, "u16", 1 / 65535)),
        "bind": draft.packer.add_static(bind.swapaxes(1, 2), "f32"),
    }


def _shape_entries(
    draft: PageDraft,
    shapes: PreparedShapes,
    active_columns: IntArray,
    first_column: int,
) -> list[dict[str, Any]]:
    """Return the manifest entries of shapes, with sparse point offsets."""
    sparse_offsets = shapes.points
    column_names = [
        name if weight == 1.0 else f"{name} at {weight:g}"
        for name, knots in zip(shapes.names, shapes.knots, strict=True)
        for weight in knots[knots != 0].tolist()
    ]
    vertex_by_offset = np.repeat(
        np.arange(shapes.vertex_count), np.diff(sparse_offsets.row_starts)
    )
    dense_row_by_column = {
        column: row
        for row, column in enumerate(np.flatnonzero(sparse_offsets.is_dense), 1)
    }
    entries = []
    for shape_number, column in enumerate(active_columns.tolist()):
        if column in dense_row_by_column:
            dense_row = sparse_offsets.dense_table[dense_row_by_column[column]]
            point_offsets = dense_row.reshape(-1, 3)
            vertices = np.flatnonzero((point_offsets != 0).any(axis=1))
            point_offsets = point_offsets[vertices]
        else:
            is_in_column = sparse_offsets.columns == column
            vertices = vertex_by_offset[is_in_column]
            point_offsets = sparse_offsets.offsets[is_in_column]
        entries.append(
            {
                "name": column_names[column],
                "column": first_column + shape_number,
                "vertices": draft.packer.add_static(vertices, "u32"),
                "offsets": draft.packer.add_static_range(point_offsets),
            }
        )
    return entries


def _point_stream(draft: PageDraft, page_take: PageTake, mesh: CharacterMesh) -> int:
    """Return the index of the stream with a mesh's points in every frame."""
    blocks = []
    weights = mesh.weights(page_take.weights)
    for begin in range(0, page_take.frames, BLOCK_FRAMES):
        frames = slice(begin, min(begin + BLOCK_FRAMES, page_take.frames))
        block_weights = None if weights is None else weights[frames]
        deformed_mesh = deform(mesh.mesh, block_weights, page_take.world(frames))
        blocks.append(deformed_mesh.points.astype(np.float32))
    return draft.add_positions(np.concatenate(blocks))
