"""What a channel of a glTF animation moves: a property of a node or a mesh."""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import StrEnum

from animtool.core.errors import excerpt
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import Node
from animtool.formats.gltf.json_items import JsonItem
from animtool.formats.gltf.meshes import (
    MeshEntry,
)
from animtool.formats.gltf.nodes import VISIBILITY

POINTER = "KHR_animation_pointer"


class TargetPath(StrEnum):
    """Which property of a node a channel animates."""

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


@dataclass(frozen=True, slots=True)
class ChannelTarget:
    """The weights of a mesh, or a property of a node."""

    node: int
    mesh: int
    path: TargetPath
    weight_index: int
    width: int  # numbers per value


def channel_target(
    channel: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[MeshEntry],
    left_out: dict[str, None],
) -> ChannelTarget | None:
    """Return the target of a channel; None if it is not read."""
    target = channel.required("target")
    path = target.text("path")
    if path is None:
        target.missing("path")
    if path == "pointer":
        return _pointer_target(target, nodes, meshes, left_out)
    node = target.index("node", len(nodes), "node")
    if path not in {"translation", "rotation", "scale", "weights"}:
        message = f"unknown path {excerpt(path)}: the channel is ignored"
        target.notes.warn("GLT106", target.at("path"), message)
        return None
    if node < 0:
        # Without a node, the target belongs to an extension, or is ignored.
        return None
    return _node_target(target, nodes, meshes, node, TargetPath(path))


def _node_target(
    target: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[MeshEntry],
    node: int,
    path: TargetPath,
    weight_index: int = -1,
) -> ChannelTarget | None:
    if path is TargetPath.WEIGHTS:
        mesh = nodes[node].mesh
        count = meshes[mesh].targets if mesh >= 0 else 0
        if weight_index >= count or not count:
            message = f"node {node} has {count} morph targets: the channel is ignored"
            target.notes.warn("GLT106", target.pointer, message)
            return None
        return ChannelTarget(
            node, -1, path, weight_index, count if weight_index < 0 else 1
        )
    if nodes[node].has_matrix and path is not TargetPath.VISIBLE:
        message = f"the matrix of node {node}, which is animated, is decomposed"
        target.notes.warn("GLT106", target.pointer, message)
    return ChannelTarget(node, -1, path, -1, _PATH_WIDTHS[path])


_NODE_POINTER = re.compile(
    r"/nodes/(\d+)/(translation|rotation|scale|weights"
    rf"|extensions/{VISIBILITY}/visible)(?:/(\d+))?$"
)
_MESH_POINTER = re.compile(r"/meshes/(\d+)/weights(?:/(\d+))?$")


def _pointer_target(
    target: JsonItem,
    nodes: Sequence[Node],
    meshes: Sequence[MeshEntry],
    left_out: dict[str, None],
) -> ChannelTarget | None:
    """Return the target of a `KHR_animation_pointer` channel."""
    extension = target.extension(POINTER)
    text = None if extension is None else extension.text("pointer")
    if text is None:
        message = f"a channel of {POINTER} without a pointer is ignored"
        target.notes.warn("GLT106", target.pointer, message)
        return None
    if not text.startswith("/"):
        where = extension.at("pointer") if extension else target.pointer
        message = f"{excerpt(text)} is not a JSON pointer: the channel is ignored"
        target.notes.warn("GLT106", where, message)
        return None
    if match := _NODE_POINTER.fullmatch(text):
        node = int(match[1][:9])
        if node >= len(nodes):
            target.notes.fail("GLT006", target.pointer, f"{text} does not exist")
        path = TargetPath.VISIBLE if "/" in match[2] else TargetPath(match[2])
        if match[3] is None or path is TargetPath.WEIGHTS:
            weight_index = -1 if match[3] is None else int(match[3][:9])
            return _node_target(target, nodes, meshes, node, path, weight_index)
    elif match := _MESH_POINTER.fullmatch(text):
        mesh = int(match[1][:9])
        if mesh >= len(meshes):
            target.notes.fail("GLT006", target.pointer, f"{text} does not exist")
        count = meshes[mesh].targets
        weight_index = -1 if match[2] is None else int(match[2][:9])
        if count and weight_index < count:
            return ChannelTarget(
                -1,
                mesh,
                TargetPath.WEIGHTS,
                weight_index,
                count if weight_index < 0 else 1,
            )
    left_out[excerpt(text)] = None
    return None
