"""glTF nodes: the tree and rest transforms."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.characters.nodes import Node
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.json_items import JsonItem, by_animtool
from animtool.maths import so3

# Of a quaternion's length, so much as the reference validator lets pass, of numbers
# with few digits; and of a matrix that its parts give back [1].
UNIT, SHEAR = 7.69e-3, 1e-4
VISIBILITY = "KHR_node_visibility"
MAX_NODES = 200_000


def read_nodes(
    root: JsonItem, notes: FileNotices, meshes: int, skins: int
) -> tuple[Node, ...]:
    """Return the nodes in file order.

    Raises:
        FormatError: There is a loop, or a node with two parents (GLT009).
    """
    items = root.children("nodes")
    if len(items) > MAX_NODES:
        notes.fail("GLT013", "/nodes", f"{len(items)} nodes; the limit is {MAX_NODES}")
    below = [item.indices("children", len(items), "node") for item in items]
    parents = _parents(items, below, notes)
    return tuple(
        _node(item, parents[i], below[i], meshes, skins, notes)
        for i, item in enumerate(items)
    )


def _parents(
    items: list[JsonItem], below: list[list[int]], notes: FileNotices
) -> list[int]:
    parents = [-1] * len(items)
    for i, children in enumerate(below):
        for k, child in enumerate(children):
            if child == i:
                message = "the node is its own child"
                notes.fail("GLT009", items[i].pointer, message)
            if parents[child] >= 0:
                message = f"node {child} has two parents, {parents[child]} and {i}"
                notes.fail("GLT009", f"{items[i].pointer}/children/{k}", message)
            parents[child] = i
    done = [False] * len(items)
    for i in range(len(items)):
        path: dict[int, None] = {}
        at = i
        while at >= 0 and not done[at]:
            if at in path:
                notes.fail("GLT009", items[at].pointer, "the node is its own ancestor")
            path[at] = None
            at = parents[at]
        for node in path:
            done[node] = True
    return parents


def _node(
    item: JsonItem,
    parent: int,
    children: list[int],
    meshes: int,
    skins: int,
    notes: FileNotices,
) -> Node:
    mesh = item.index("mesh", meshes, "mesh")
    skin = item.index("skin", skins, "skin")
    weights = item.floats("weights", None)
    if mesh < 0:
        for key, is_stated in (("skin", skin >= 0), ("weights", weights is not None)):
            if is_stated:
                message = f"{key} of a node without a mesh is ignored"
                notes.warn("GLT106", item.at(key), message)
        skin, weights = -1, None
    translation, rotation, scale, has_matrix = _transform(item, notes)
    shown = item.extension(VISIBILITY)
    visible = shown is None or shown.values.get("visible", True) is not False
    return Node(
        item.text("name"),
        parent,
        tuple(children),
        translation,
        rotation,
        scale,
        mesh,
        skin,
        None if weights is None else tuple(weights),
        visible,
        has_matrix,
        mesh < 0 and by_animtool(item).get("above") is True,
    )


def _transform(
    item: JsonItem, notes: FileNotices
) -> tuple[
    tuple[float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float],
    bool,
]:
    if not _PLACING & item.values.keys():
        return _NO_TRANSFORM
    matrix = item.floats("matrix", 16)
    parts = [item.floats(*part) for part in _PARTS]
    if matrix is not None:
        for key, part in zip(("translation", "rotation", "scale"), parts, strict=True):
            if part is not None:
                message = f"{key} next to a matrix is ignored"
                notes.warn("GLT106", item.at(key), message)
        return (*_split(np.array(matrix), item, notes), True)
    translation, rotation, scale = (
        default if part is None else part
        for part, default in zip(
            parts, ([0.0] * 3, [0.0, 0, 0, 1.0], [1.0] * 3), strict=True
        )
    )
    length = math.hypot(*rotation)
    if length == 0.0:
        notes.fail("GLT010", item.at("rotation"), "a rotation has length 0")
    if abs(length - 1.0) > UNIT:
        message = f"the rotation has length {length:.6g}: it is normalised"
        notes.warn("GLT103", item.at("rotation"), message)
    x, y, z = translation
    a, b, c, w = (value / length for value in rotation)
    u, v, s = scale
    return (x, y, z), (a, b, c, w), (u, v, s), False


_PLACING = {"matrix", "translation", "rotation", "scale"}
_NO_TRANSFORM = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0), False
_PARTS = (("translation", 3), ("rotation", 4), ("scale", 3))


def _split(
    columns: FloatArray, item: JsonItem, notes: FileNotices
) -> tuple[
    tuple[float, float, float],
    tuple[float, float, float, float],
    tuple[float, float, float],
]:
    """Return translation, rotation and scale of a matrix; shear is dropped."""
    matrix = columns.reshape(4, 4).T
    where = item.at("matrix")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > SHEAR:
        notes.fail("GLT010", where, "the last row of the matrix is not 0 0 0 1")
    linear = matrix[:3, :3]
    size = float(np.abs(linear).max())
    if not size or abs(np.linalg.det(linear / size)) < 1e-12:
        notes.fail("GLT010", where, "the matrix is singular")
    unit_rotation, scale = so3.split_scale(linear[None] / size)
    rotation, lengths = unit_rotation[0], scale[0] * size
    again = so3.to_matrix(rotation) * lengths
    off = float(np.abs(again - linear).max()) / size
    if off > SHEAR:
        message = f"the shear of the matrix, {off:.3g} of its size, is ignored"
        notes.warn("GLT103", where, message)
    x, y, z = matrix[:3, 3].tolist()
    a, b, c, w = rotation.tolist()
    u, v, s = lengths.tolist()
    return (x, y, z), (a, b, c, w), (u, v, s)


def read_scenes(
    root: JsonItem, notes: FileNotices, nodes: tuple[Node, ...]
) -> tuple[list[list[int]], int]:
    """Return the root nodes of each scene, and the default scene or -1."""
    scenes = []
    for item in root.children("scenes"):
        listed = item.indices("nodes", len(nodes), "node")
        for k, node in enumerate(listed):
            if nodes[node].parent >= 0:
                message = f"node {node} has a parent; it appears once in the tree"
                notes.warn("GLT106", f"{item.at('nodes')}/{k}", message)
            if node in listed[:k]:
                message = f"node {node} is listed twice; it is in the tree once"
                notes.warn("GLT106", f"{item.at('nodes')}/{k}", message)
        scenes.append(listed)
    shown = root.index("scene", len(scenes), "scene")
    return scenes, (0 if shown < 0 and scenes else shown)
