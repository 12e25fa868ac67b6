"""Reads the target of a glTF animation channel: a property of a node or a mesh."""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import StrEnum

from animtool.core.errors import counted, excerpt
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import Node
from animtool.formats.gltf.json_items import JsonItem
from animtool.formats.gltf.meshes import GltfMesh
from animtool.formats.gltf.nodes import VISIBILITY_EXTENSION

POINTER_EXTENSION = "KHR_animation_pointer"


class TargetPath(StrEnum):
    """Property of a node or mesh that a channel animates."""

    TRANSLATION = "translation"
    ROTATION = "rotation"
    SCALE = "scale"
    WEIGHTS = "weights"
    VISIBLE = "visible"


_PATH_WIDTHS = {
    TargetPath.TRANSLATION: 3,
    TargetPath.ROTATION: 4,
    TargetPath.SCALE: 3,
    TargetPath.VISIBLE: 1,
}
_NODE_POINTER_PATTERN = re.compile(
    r"/nodes/(\d+)/(translation|rotation|scale|weights"
    rf"|extensions/{VISIBILITY_EXTENSION}/visible)(?:/(\d+))?$"
)
_MESH_POINTER_PATTERN = re.compile(r"/meshes/(\d+)/weights(?:/(\d+))?$")


@dataclass(frozen=True, slots=True)
class ChannelTarget:
    """Target of a channel: a property of a node, or the weights of a mesh."""

    node: int
    mesh: int
    path: TargetPath
    weight_index: int
    width: int  # numbers per value


def read_channel_target(
    channel: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[GltfMesh],
    ignored_targets: dict[str, None],
) -> ChannelTarget | None:
    """Return the target of a channel; None if the channel is ignored."""
    target = channel.required_child("target")
    path = target.text("path")
    if path is None:
        target.fail_missing("path")
    if path == "pointer":
        return _read_pointer_target(target, nodes, meshes, ignored_targets)
    node = target.index("node", len(nodes), "node")
    if path not in {"translation", "rotation", "scale", "weights"}:
        message = f"unknown path {excerpt(path)}; the channel is ignored"
        target.diagnostics.warn("GLT106", target.pointer_to("path"), message)
        return None
    if node < 0:
        # Without a node, the target belongs to an extension, or is ignored.
        return None
    return _build_node_target(target, nodes, meshes, node, TargetPath(path))


def _build_node_target(
    target: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[GltfMesh],
    node: int,
    path: TargetPath,
    weight_index: int = -1,
) -> ChannelTarget | None:
    if path is TargetPath.WEIGHTS:
        mesh = nodes[node].mesh
        target_count = meshes[mesh].target_count if mesh >= 0 else 0
        if weight_index >= target_count or not target_count:
            targets = counted(target_count, "morph target")
            message = f"the channel is ignored, because node {node} has {targets}"
            target.diagnostics.warn("GLT106", target.pointer, message)
            return None
        return _weights_target(node, -1, target_count, weight_index)
    if nodes[node].has_matrix and path is not TargetPath.VISIBLE:
        message = f"the matrix of node {node}, which is animated, is decomposed"
        target.diagnostics.warn("GLT106", target.pointer, message)
    return ChannelTarget(node, -1, path, -1, _PATH_WIDTHS[path])


def _weights_target(
    node: int, mesh: int, target_count: int, weight_index: int
) -> ChannelTarget:
    width = target_count if weight_index < 0 else 1
    return ChannelTarget(node, mesh, TargetPath.WEIGHTS, weight_index, width)


def _read_pointer_target(
    target: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[GltfMesh],
    ignored_targets: dict[str, None],
) -> ChannelTarget | None:
    """Return the target of a `KHR_animation_pointer` channel."""
    extension = target.extension(POINTER_EXTENSION)
    text = None if extension is None else extension.text("pointer")
    if text is None:
        message = f"a channel of {POINTER_EXTENSION} without a pointer is ignored"
        target.diagnostics.warn("GLT106", target.pointer, message)
        return None
    if not text.startswith("/"):
        pointer = extension.pointer_to("pointer") if extension else target.pointer
        message = f"{excerpt(text)} is not a JSON pointer; the channel is ignored"
        target.diagnostics.warn("GLT106", pointer, message)
        return None
    if match := _NODE_POINTER_PATTERN.fullmatch(text):
        node = int(match[1][:9])
        if node >= len(nodes):
            target.diagnostics.fail("GLT006", target.pointer, f"{text} does not exist")
        path = TargetPath.VISIBLE if "/" in match[2] else TargetPath(match[2])
        if match[3] is None or path is TargetPath.WEIGHTS:
            weight_index = -1 if match[3] is None else int(match[3][:9])
            return _build_node_target(target, nodes, meshes, node, path, weight_index)
    elif match := _MESH_POINTER_PATTERN.fullmatch(text):
        mesh = int(match[1][:9])
        if mesh >= len(meshes):
            target.diagnostics.fail("GLT006", target.pointer, f"{text} does not exist")
        target_count = meshes[mesh].target_count
        weight_index = -1 if match[2] is None else int(match[2][:9])
        if target_count and weight_index < target_count:
            return _weights_target(-1, mesh, target_count, weight_index)
    ignored_targets[excerpt(text)] = None
    return None
