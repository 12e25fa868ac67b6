"""A rig as glTF nodes, skins and meshes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.record import dataclass
from animtool.formats.gltf.glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbBuilder
from animtool.maths.faces import triangulated
from animtool.rig.kinematics import bind_matrices
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, SurfaceSkin, surfaces_of

MAX_NAMED = 6
# A weight below a part of the largest is none that shows [1].
SMALLEST_WEIGHT = 1e-7


@dataclass(slots=True)
class WrittenRig:
    """Indices of a rig's parts in the file."""

    joints: list[int]  # node of each joint
    # Of each shape: its mesh's node, and which target it is; none without a mesh.
    shapes: dict[str, tuple[int, int]] = field(default_factory=dict)
    targets: dict[int, list[str]] = field(default_factory=dict)  # shapes by node
    notices: list[Fault] = field(default_factory=list)


def write_rig(
    builder: GlbBuilder,
    rig: Rig,
    scales: FloatArray,
    weights: dict[str, float],
) -> WrittenRig:
    """Write a rig with Y up, in metres.

    Args:
        builder: What it is added to.
        rig: J joints.
        scales: Of the joints at rest ``(J, 3)``.
        weights: Of the shapes at rest.
    """
    written = WrittenRig(list(range(len(rig.joints))))
    for j, joint in enumerate(rig.joints):
        node: dict[str, Any] = {"name": joint.source_name or joint.name}
        if joint.source_name:
            node["extras"] = {"animtool": {"name": joint.name}}
        node |= _placed(
            np.array(joint.translation), np.array(joint.rotation), scales[j]
        )
        builder.add("nodes", node)
    for j, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            builder.json["nodes"][joint.parent].setdefault("children", []).append(j)
    roots = list(rig.roots)
    left: dict[str, list[str]] = defaultdict(list)
    bind = bind_matrices(rig) if rig.joints else np.zeros((0, 4, 4))
    for surface in surfaces_of(rig):
        at = _surface(builder, rig, surface, bind, weights, written, left)
        if at >= len(rig.joints):
            roots.append(at)
    roots = _under_one(builder, rig, roots)
    builder.json["scene"] = 0
    builder.json["scenes"] = [{"name": rig.name, "nodes": roots}]
    written.notices += _left_out(rig, left, written)
    return written


def _under_one(builder: GlbBuilder, rig: Rig, roots: list[int]) -> list[int]:
    """Return the scene's roots; joints of a skin need a common root.

    Where they have several, a node that is none of the rig is put above those.
    """
    tops = np.array([rig.upwards(j)[-1] for j in range(len(rig.joints))], np.int64)
    skins = [skin["joints"] for skin in builder.json.get("skins", ())]
    if all(len(np.unique(tops[joints])) == 1 for joints in skins):
        return roots
    node = {
        "name": rig.name,
        "children": list(rig.roots),
        "extras": {"animtool": {"above": True}},
    }
    above = builder.add("nodes", node)
    return [above, *(root for root in roots if root >= len(rig.joints))]


def _placed(
    move: FloatArray, rotation: FloatArray, scale: FloatArray
) -> dict[str, Any]:
    """Return the transform properties that differ from the identity."""
    parts: dict[str, Any] = {}
    if np.abs(move).max() > 0:
        parts["translation"] = move.tolist()
    if np.abs(rotation[:3]).max() > 0:
        parts["rotation"] = (rotation / np.linalg.norm(rotation)).tolist()
    if np.abs(scale - 1.0).max() > 0:
        parts["scale"] = scale.tolist()
    return parts


def _surface(
    builder: GlbBuilder,
    rig: Rig,
    surface: Surface,
    bind: FloatArray,
    weights: dict[str, float],
    written: WrittenRig,
    left: dict[str, list[str]],
) -> int:
    """Write a mesh; return its node."""
    carrier, local = _carrier(builder, rig, surface, bind)
    if surface.skin is None or carrier >= 0:
        surface = _in_node(surface, local)
    points, normals = surface.points, surface.normals
    primitive: dict[str, Any] = {"attributes": _attributes(builder, points, normals)}
    if surface.skin is not None and carrier < 0:
        _write_influences(builder, surface.skin, primitive["attributes"])
        if surface.skin.method != "linear":
            left["dual quaternion skinning (written as linear)"].append(surface.name)
    faces = triangulated(surface.counts, surface.indices)
    small = len(points) < 65535
    flat = faces.reshape(-1, 1).astype(np.uint16 if small else np.uint32)
    primitive["indices"] = builder.accessor(flat, target=ELEMENT_ARRAY_BUFFER)
    if len(surface.counts) and surface.counts.max() > 3:
        left["faces of more than three points (written as triangles)"].append(
            surface.name
        )
    mesh: dict[str, Any] = {"name": surface.name, "primitives": [primitive]}
    _targets(builder, surface, primitive, mesh, weights, left)
    if carrier >= 0 and builder.json["nodes"][carrier]["name"] != surface.name:
        mesh.setdefault("extras", {})["animtool"] = {"name": surface.name}
    index = builder.add("meshes", mesh)
    return _node_of(builder, rig, surface, index, carrier, bind, written)


def _in_node(surface: Surface, local: FloatArray) -> Surface:
    """Return a mesh in the frame of its node."""
    linear = local[:3, :3]
    normals = surface.normals
    return replace(
        surface,
        points=surface.points @ linear.T + local[:3, 3],
        normals=None if normals is None else normals @ np.linalg.inv(linear),
        shapes=tuple(
            replace(shape, deltas=shape.deltas @ linear.T) for shape in surface.shapes
        ),
    )


def _write_influences(
    builder: GlbBuilder, skin: SurfaceSkin, attributes: dict[str, int]
) -> None:
    indices, values = influences(skin)
    kind = np.uint8 if indices.max(initial=0) < 256 else np.uint16
    for k in range(indices.shape[1] // 4):
        some = slice(4 * k, 4 * k + 4)
        joints = indices[:, some].astype(kind)
        attributes[f"JOINTS_{k}"] = builder.accessor(joints, target=ARRAY_BUFFER)
        some_weights = values[:, some].astype(np.float32)
        attributes[f"WEIGHTS_{k}"] = builder.accessor(some_weights, target=ARRAY_BUFFER)


def _node_of(
    builder: GlbBuilder,
    rig: Rig,
    surface: Surface,
    mesh: int,
    carrier: int,
    bind: FloatArray,
    written: WrittenRig,
) -> int:
    """Attach a mesh to the joint that carries it, or to a new node."""
    if carrier >= 0:
        at = carrier
        builder.json["nodes"][at]["mesh"] = mesh
    else:
        node: dict[str, Any] = {"name": surface.name, "mesh": mesh}
        if surface.skin is not None:
            node["skin"] = _skin(builder, rig, surface, surface.skin, bind)
        at = builder.add("nodes", node)
    names = [shape.name for shape in surface.shapes]
    for k, name in enumerate(names):
        written.shapes[name] = (at, k)
    if names:
        written.targets[at] = names
    return at


def _carrier(
    builder: GlbBuilder, rig: Rig, surface: Surface, bind: FloatArray
) -> tuple[int, FloatArray]:
    """Return the joint that rigidly carries a mesh, -1 for none, and its bind.

    That is the transform from the points to the joint; of a mesh that follows none to
    the world. A node has one mesh: a second one is skinned.
    """
    skin = surface.skin
    if skin is None or not len(skin.indices):
        return -1, surface.geom_bind
    used = np.unique(skin.indices[skin.weights > 0])
    single = (np.abs(skin.weights.sum(axis=1) - 1.0) < 1e-6).all()
    if len(used) != 1 or not single or len(skin.joints) > 1:
        return -1, np.eye(4)
    joint = rig.index(skin.joints[int(used[0])])
    if "mesh" in builder.json["nodes"][joint]:
        return -1, np.eye(4)
    return joint, np.linalg.inv(bind[joint]) @ surface.geom_bind


def _skin(
    builder: GlbBuilder,
    rig: Rig,
    surface: Surface,
    skin: SurfaceSkin,
    bind: FloatArray,
) -> int:
    """Return the skin of a mesh; meshes with equal binds share one."""
    joints = [rig.index(name) for name in skin.joints]
    matrices = np.linalg.inv(bind[joints]) @ surface.geom_bind
    matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
    columns = matrices.swapaxes(1, 2).reshape(-1, 16).astype(np.float32)
    entry: dict[str, Any] = {
        "name": rig.name,
        "inverseBindMatrices": builder.accessor(columns),
        "joints": joints,
    }
    known = builder.json.get("skins", [])
    if entry in known:
        return int(known.index(entry))
    return builder.add("skins", entry)


def _attributes(
    builder: GlbBuilder, points: FloatArray, normals: FloatArray | None
) -> dict[str, int]:
    rounded = points.astype(np.float32)
    position = builder.accessor(rounded, target=ARRAY_BUFFER, bounds=True)
    attributes = {"POSITION": position}
    if normals is not None:
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        if (lengths > 0).all():
            unit = (normals / lengths).astype(np.float32)
            attributes["NORMAL"] = builder.accessor(unit, target=ARRAY_BUFFER)
    return attributes


def _targets(
    builder: GlbBuilder,
    surface: Surface,
    primitive: dict[str, Any],
    mesh: dict[str, Any],
    weights: dict[str, float],
    left: dict[str, list[str]],
) -> None:
    """Write shapes as morph targets."""
    if not surface.shapes:
        return
    targets = []
    for shape in surface.shapes:
        rows = shape.vertices
        if rows is None:
            rows = np.arange(len(surface.points))
        dense = np.zeros((len(surface.points), 3))
        np.add.at(dense, rows, shape.deltas)
        moved = dense.astype(np.float32)
        target = {"POSITION": builder.accessor(moved, target=ARRAY_BUFFER, bounds=True)}
        if "NORMAL" in primitive["attributes"]:
            turned = np.zeros_like(dense)
            if shape.normals is not None:
                np.add.at(turned, rows, shape.normals)
            normals = turned.astype(np.float32)
            target["NORMAL"] = builder.accessor(normals, target=ARRAY_BUFFER)
        targets.append(target)
        if shape.inbetweens:
            left["in-between shapes"].append(shape.name)
    primitive["targets"] = targets
    names = [shape.name for shape in surface.shapes]
    mesh["weights"] = [weights.get(name, 0.0) for name in names]
    mesh["extras"] = {"targetNames": names}


def influences(skin: SurfaceSkin) -> tuple[IntArray, FloatArray]:
    """Return joints and weights, largest first, padded to multiples of four.

    Each joint occurs once for a vertex, weights have the sum 1, and those of no weight
    are joint 0.
    """
    indices, weights = skin.indices.copy(), skin.weights.astype(np.float64).copy()
    order = np.argsort(indices, axis=1, kind="stable")
    indices = np.take_along_axis(indices, order, 1)
    weights = np.take_along_axis(weights, order, 1)
    for k in range(indices.shape[1] - 1, 0, -1):
        same = indices[:, k] == indices[:, k - 1]
        weights[:, k - 1] += np.where(same, weights[:, k], 0.0)
        weights[same, k] = 0.0
    largest = weights.max(axis=1, keepdims=True)
    weights[weights <= SMALLEST_WEIGHT * largest] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    indices = np.take_along_axis(indices, order, 1)
    weights = np.take_along_axis(weights, order, 1)
    used = int((weights > 0).sum(axis=1).max(initial=1))
    width = max(4, -(-used // 4) * 4)
    padded = np.zeros((len(indices), width), np.int64)
    shares = np.zeros((len(indices), width))
    kept = min(width, indices.shape[1])
    padded[:, :kept], shares[:, :kept] = indices[:, :kept], weights[:, :kept]
    sums = shares.sum(axis=1, keepdims=True)
    shares = np.where(sums > 0, shares / np.where(sums > 0, sums, 1.0), 0.0)
    shares[sums[:, 0] <= 0, 0] = 1.0
    rounded = shares.astype(np.float32).astype(np.float64)
    rounded[:, 0] += 1.0 - rounded.sum(axis=1)
    padded[rounded == 0.0] = 0
    return padded, rounded


def _left_out(rig: Rig, left: dict[str, list[str]], written: WrittenRig) -> list[Fault]:
    """Return one notice about rig contents that glTF cannot hold."""
    combined = [shape.name for shape in rig.shapes if shape.combine]
    if combined:
        left["products of shapes (each gets its own weight)"] += combined
    homeless = [one.name for one in rig.shapes if one.name not in written.shapes]
    if homeless:
        left["shapes without a mesh (skipped)"] += homeless
    texts = [f"{what}: {listed(names, MAX_NAMED)}" for what, names in left.items()]
    if not texts:
        return []
    message = f"glTF cannot store {'; '.join(texts)}"
    return [Fault("GLT117", message, severity=Severity.NOTE)]
