"""Reads the node tree of a glTF and its rest transforms."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import cycle_text
from animtool.formats.characters.nodes import NO_TRANSFORM, Node
from animtool.formats.gltf.json_items import JsonItem, animtool_extras
from animtool.maths import so3
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Quaternion

# Tolerance of a quaternion's length, as in the reference validator, and of a matrix
# decomposed to translation, rotation and scale [1].
UNIT_TOLERANCE, SHEAR_TOLERANCE = 7.69e-3, 1e-4
VISIBILITY_EXTENSION = "KHR_node_visibility"
MAX_NODES = 200_000
_TRANSFORM_KEYS = {"matrix", "translation", "rotation", "scale"}
_TRS_PROPERTIES = (("translation", 3), ("rotation", 4), ("scale", 3))


def read_nodes(
    json_root: JsonItem, mesh_count: int, skin_count: int
) -> tuple[Node, ...]:
    """Return the nodes in file order, with parents and rest transforms."""
    items = json_root.children("nodes")
    if len(items) > MAX_NODES:
        message = f"the file has {len(items)} nodes; the limit is {MAX_NODES}"
        hint = "export fewer nodes in one file"
        json_root.diagnostics.fail("GLT013", "/nodes", message, hint)
    child_lists = [item.indices("children", len(items), "node") for item in items]
    parents = _parent_indices(items, child_lists)
    return tuple(
        _read_node(item, parent, children, mesh_count, skin_count)
        for item, parent, children in zip(items, parents, child_lists, strict=True)
    )


def _parent_indices(items: list[JsonItem], child_lists: list[list[int]]) -> list[int]:
    parents = [-1] * len(items)
    for i, children in enumerate(child_lists):
        for child_number, child in enumerate(children):
            if child == i:
                message = f"node {i} is its own child"
                hint = "remove it from its children"
                items[i].diagnostics.fail("GLT009", items[i].pointer, message, hint)
            if parents[child] >= 0:
                message = f"node {child} has two parents, {parents[child]} and {i}"
                pointer = f"{items[i].pointer}/children/{child_number}"
                hint = "remove it from the children of one of them"
                items[i].diagnostics.fail("GLT009", pointer, message, hint)
            parents[child] = i
    is_acyclic = [False] * len(items)
    for i in range(len(items)):
        visited_nodes: dict[int, None] = {}
        ancestor = i
        while ancestor >= 0 and not is_acyclic[ancestor]:
            if ancestor in visited_nodes:
                item, visited = items[ancestor], list(visited_nodes)
                cycle = [ancestor, *reversed(visited[visited.index(ancestor) :])]
                message = f"node {ancestor} is its own ancestor: "
                message += cycle_text(list(map(str, cycle)))
                hint = "remove one of these nodes from the children of its parent"
                item.diagnostics.fail("GLT009", item.pointer, message, hint)
            visited_nodes[ancestor] = None
            ancestor = parents[ancestor]
        for node in visited_nodes:
            is_acyclic[node] = True
    return parents


def _read_node(
    item: JsonItem, parent: int, children: list[int], mesh_count: int, skin_count: int
) -> Node:
    mesh = item.index("mesh", mesh_count, "mesh")
    skin = item.index("skin", skin_count, "skin")
    weights = item.floats("weights", None)
    if mesh < 0:
        for key, is_stated in (("skin", skin >= 0), ("weights", weights is not None)):
            if is_stated:
                message = f"{key} of a node without a mesh is ignored"
                item.diagnostics.warn("GLT106", item.pointer_to(key), message)
        skin, weights = -1, None
    translation, rotation, scale, has_matrix = _read_transform(item)
    visibility = item.extension(VISIBILITY_EXTENSION)
    is_visible = not visibility or visibility.values.get("visible") is not False
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
        is_visible,
        has_matrix,
        mesh < 0 and animtool_extras(item).get("above") is True,
    )


def _read_transform(item: JsonItem) -> tuple[Vector, Quaternion, Vector, bool]:
    if not _TRANSFORM_KEYS & item.values.keys():
        return *NO_TRANSFORM, False
    matrix = item.floats("matrix", 16)
    components = [item.floats(*component) for component in _TRS_PROPERTIES]
    if matrix is not None:
        for (key, _), component in zip(_TRS_PROPERTIES, components, strict=True):
            if component is not None:
                message = f"{key} next to a matrix is ignored"
                item.diagnostics.warn("GLT106", item.pointer_to(key), message)
        return (*_decompose_matrix(np.array(matrix), item), True)
    translation, rotation, scale = (
        default if component is None else component
        for component, default in zip(components, NO_TRANSFORM, strict=True)
    )
    length = math.hypot(*rotation)
    if length == 0.0:
        message = "the rotation is a quaternion of length 0"
        item.diagnostics.fail("GLT010", item.pointer_to("rotation"), message)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        message = f"the rotation is not a unit quaternion (length {length:.6g}); it is "
        message += "normalised"
        hint = "export the file again if the rotation looks wrong"
        item.diagnostics.warn("GLT103", item.pointer_to("rotation"), message, hint)
    x, y, z = translation
    a, b, c, w = (value / length for value in rotation)
    u, v, s = scale
    return (x, y, z), (a, b, c, w), (u, v, s), False


def _decompose_matrix(
    columns: FloatArray, item: JsonItem
) -> tuple[Vector, Quaternion, Vector]:
    """Return translation, rotation and scale of a matrix; shear is dropped."""
    matrix = columns.reshape(4, 4).T
    diagnostics, pointer = item.diagnostics, item.pointer_to("matrix")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > SHEAR_TOLERANCE:
        diagnostics.fail("GLT010", pointer, "the last row of the matrix is not 0 0 0 1")
    linear = matrix[:3, :3]
    max_magnitude = float(np.abs(linear).max())
    if not max_magnitude or abs(np.linalg.det(linear / max_magnitude)) < 1e-12:
        diagnostics.fail("GLT010", pointer, "the matrix is singular")
    unit_rotation, scale = so3.split_scale(linear[None] / max_magnitude)
    rotation, lengths = unit_rotation[0], scale[0] * max_magnitude
    rigid_linear = so3.to_matrix(rotation) * lengths
    shear = float(np.abs(rigid_linear - linear).max()) / max_magnitude
    if shear > SHEAR_TOLERANCE:
        message = f"the shear of the matrix, {shear:.3g} of its size, is ignored"
        diagnostics.warn("GLT103", pointer, message)
    x, y, z = matrix[:3, 3].tolist()
    a, b, c, w = rotation.tolist()
    u, v, s = lengths.tolist()
    return (x, y, z), (a, b, c, w), (u, v, s)


def read_scenes(
    json_root: JsonItem, nodes: tuple[Node, ...]
) -> tuple[list[list[int]], int]:
    """Return the root nodes of each scene, and the default scene or -1."""
    scenes = []
    for item in json_root.children("scenes"):
        scene_nodes = item.indices("nodes", len(nodes), "node")
        for position, node in enumerate(scene_nodes):
            pointer = f"{item.pointer_to('nodes')}/{position}"
            if nodes[node].parent >= 0:
                message = f"node {node} has a parent; it appears once in the tree"
                item.diagnostics.warn("GLT106", pointer, message)
            if node in scene_nodes[:position]:
                message = f"node {node} is listed twice; it is in the tree once"
                item.diagnostics.warn("GLT106", pointer, message)
        scenes.append(scene_nodes)
    default_scene = json_root.index("scene", len(scenes), "scene")
    return scenes, (0 if default_scene < 0 and scenes else default_scene)
