"""Writes a rig as glTF nodes, skins and meshes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.record import dataclass
from animtool.formats.gltf.glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbBuilder
from animtool.maths.faces import triangulate
from animtool.rig.kinematics import bind_matrices
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, SurfaceSkin, surfaces_of

MAX_LISTED_CONTENTS = 6
# Weights below this fraction of the largest have no visible effect [1].
MIN_WEIGHT = 1e-7


@dataclass(slots=True)
class RigIndices:
    """Indices of a rig's joints and shapes in the file."""

    joints: list[int]  # node of each joint
    # Mesh node and target index of each shape; shapes without a mesh are missing.
    shapes: dict[str, tuple[int, int]] = field(default_factory=dict)
    targets: dict[int, list[str]] = field(default_factory=dict)  # shapes by node
    notices: list[Fault] = field(default_factory=list)


def write_rig(
    builder: GlbBuilder, rig: Rig, scales: FloatArray, weights: dict[str, float]
) -> RigIndices:
    """Write a rig with Y up, in metres; return the indices of its contents.

    Args:
        builder: Builder of the file.
        rig: J joints.
        scales: Joint scales at rest ``(J, 3)``.
        weights: Shape weights at rest, by name.
    """
    rig_indices = RigIndices(list(range(len(rig.joints))))
    for j, joint in enumerate(rig.joints):
        node: dict[str, Any] = {"name": joint.source_name or joint.name}
        if joint.source_name:
            node["extras"] = {"animtool": {"name": joint.name}}
        translation, rotation = np.array(joint.translation), np.array(joint.rotation)
        node |= _transform_properties(translation, rotation, scales[j])
        builder.add("nodes", node)
    for j, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            builder.json["nodes"][joint.parent].setdefault("children", []).append(j)
    roots = list(rig.roots)
    bind = bind_matrices(rig) if rig.joints else np.zeros((0, 4, 4))
    writer = _SurfaceWriter(builder, rig, bind, weights, rig_indices)
    for surface in surfaces_of(rig):
        mesh_node = writer.write(surface)
        if mesh_node >= len(rig.joints):
            roots.append(mesh_node)
    roots = _ensure_common_root(builder, rig, roots)
    builder.json["scene"] = 0
    builder.json["scenes"] = [{"name": rig.name, "nodes": roots}]
    rig_indices.notices += _lost_contents_notice(rig, writer.lost_contents, rig_indices)
    return rig_indices


def _ensure_common_root(builder: GlbBuilder, rig: Rig, roots: list[int]) -> list[int]:
    """Return the root nodes of the scene, with a common root for the joints of a skin.

    If there are several, a node outside the rig is inserted above them.
    """
    root_joints = np.array([rig.upwards(j)[-1] for j in range(len(rig.joints))], int)
    skin_joints = [skin["joints"] for skin in builder.json.get("skins", ())]
    if all(len(np.unique(root_joints[joints])) == 1 for joints in skin_joints):
        return roots
    root_json = {
        "name": rig.name,
        "children": list(rig.roots),
        "extras": {"animtool": {"above": True}},
    }
    root_node = builder.add("nodes", root_json)
    return [root_node, *(root for root in roots if root >= len(rig.joints))]


def _transform_properties(
    translation: FloatArray, rotation: FloatArray, scale: FloatArray
) -> dict[str, Any]:
    """Return the properties of a node's transform that differ from the identity."""
    node_properties: dict[str, Any] = {}
    if np.abs(translation).max() > 0:
        node_properties["translation"] = translation.tolist()
    if np.abs(rotation[:3]).max() > 0:
        node_properties["rotation"] = (rotation / np.linalg.norm(rotation)).tolist()
    if np.abs(scale - 1.0).max() > 0:
        node_properties["scale"] = scale.tolist()
    return node_properties


@dataclass(slots=True)
class _SurfaceWriter:
    """Writes the meshes of a rig with their skins and morph targets."""

    builder: GlbBuilder
    rig: Rig
    bind: FloatArray  # matrices of the joints ``(J, 4, 4)``
    weights: dict[str, float]  # shape weights at rest
    rig_indices: RigIndices
    # Names of meshes and shapes by the content that glTF cannot store.
    lost_contents: dict[str, list[str]] = field(
        default_factory=lambda: defaultdict(list)
    )

    def write(self, surface: Surface) -> int:
        """Write a mesh with its skin and shapes; return the index of its node."""
        node_index, local = self._rigid_joint(surface)
        skin = surface.skin if node_index < 0 else None
        if skin is None:
            surface = _to_node_frame(surface, local)
        attributes = self._write_attributes(surface.points, surface.normals)
        primitive: dict[str, Any] = {"attributes": attributes}
        if skin is not None:
            self._write_influences(skin, attributes)
            if skin.method != "linear":
                lost_content = "dual quaternion skinning (written as linear)"
                self.lost_contents[lost_content].append(surface.name)
        faces = triangulate(surface.counts, surface.indices)
        is_16_bit = len(surface.points) < 65535
        indices = faces.reshape(-1, 1).astype(np.uint16 if is_16_bit else np.uint32)
        primitive["indices"] = self._add_accessor(indices, target=ELEMENT_ARRAY_BUFFER)
        if len(surface.counts) and surface.counts.max() > 3:
            lost_content = "faces of more than three points (written as triangles)"
            self.lost_contents[lost_content].append(surface.name)
        mesh_json: dict[str, Any] = {"name": surface.name, "primitives": [primitive]}
        if surface.shapes:
            self._write_targets(surface, primitive, mesh_json)
        nodes = self.builder.json["nodes"]
        if node_index >= 0 and nodes[node_index]["name"] != surface.name:
            mesh_json.setdefault("extras", {})["animtool"] = {"name": surface.name}
        mesh_index = self.builder.add("meshes", mesh_json)
        if node_index >= 0:
            nodes[node_index]["mesh"] = mesh_index
        else:
            node_json: dict[str, Any] = {"name": surface.name, "mesh": mesh_index}
            if skin is not None:
                node_json["skin"] = self._write_skin(surface, skin)
            node_index = self.builder.add("nodes", node_json)
        names = [shape.name for shape in surface.shapes]
        shape_indices = {name: (node_index, k) for k, name in enumerate(names)}
        self.rig_indices.shapes |= shape_indices
        if names:
            self.rig_indices.targets[node_index] = names
        return node_index

    def _add_accessor(
        self, values: Any, *, target: int = ARRAY_BUFFER, has_bounds: bool = False
    ) -> int:
        """Store vertex data as an accessor; return its index."""
        return self.builder.add_accessor(values, target=target, has_bounds=has_bounds)

    def _rigid_joint(self, surface: Surface) -> tuple[int, FloatArray]:
        """Return the joint that moves a mesh rigidly (-1 for none) and the mesh's bind.

        The bind is the transform from the points to the joint, or to the world without
        a joint. A node has one mesh: a second mesh at the same joint is skinned.
        """
        skin = surface.skin
        if skin is None or not len(skin.indices):
            return -1, surface.geom_bind
        used_joints = np.unique(skin.indices[skin.weights > 0])
        is_fully_weighted = (np.abs(skin.weights.sum(axis=1) - 1.0) < 1e-6).all()
        if len(used_joints) != 1 or not is_fully_weighted or len(skin.joints) > 1:
            return -1, np.eye(4)
        joint = self.rig.index(skin.joints[int(used_joints[0])])
        if "mesh" in self.builder.json["nodes"][joint]:
            return -1, np.eye(4)
        return joint, np.linalg.inv(self.bind[joint]) @ surface.geom_bind

    def _write_attributes(
        self, points: FloatArray, normals: FloatArray | None
    ) -> dict[str, int]:
        positions = points.astype(np.float32)
        attributes = {"POSITION": self._add_accessor(positions, has_bounds=True)}
        if normals is not None:
            lengths = np.linalg.norm(normals, axis=1, keepdims=True)
            if (lengths > 0).all():
                unit_normals = (normals / lengths).astype(np.float32)
                attributes["NORMAL"] = self._add_accessor(unit_normals)
        return attributes

    def _write_influences(self, skin: SurfaceSkin, attributes: dict[str, int]) -> None:
        indices, weights = pad_influences(skin)
        index_dtype = np.uint8 if indices.max(initial=0) < 256 else np.uint16
        for k in range(indices.shape[1] // 4):
            columns = slice(4 * k, 4 * k + 4)
            joints = indices[:, columns].astype(index_dtype)
            attributes[f"JOINTS_{k}"] = self._add_accessor(joints)
            set_weights = weights[:, columns].astype(np.float32)
            attributes[f"WEIGHTS_{k}"] = self._add_accessor(set_weights)

    def _write_skin(self, surface: Surface, skin: SurfaceSkin) -> int:
        """Write the skin of a mesh and return its index; equal skins are shared."""
        joints = [self.rig.index(name) for name in skin.joints]
        matrices = np.linalg.inv(self.bind[joints]) @ surface.geom_bind
        matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
        columns = matrices.swapaxes(1, 2).reshape(-1, 16).astype(np.float32)
        skin_json: dict[str, Any] = {
            "name": self.rig.name,
            "inverseBindMatrices": self.builder.add_accessor(columns),
            "joints": joints,
        }
        skins = self.builder.json.get("skins", [])
        if skin_json in skins:
            return int(skins.index(skin_json))
        return self.builder.add("skins", skin_json)

    def _write_targets(
        self, surface: Surface, primitive: dict[str, Any], mesh_json: dict[str, Any]
    ) -> None:
        """Write the shapes of a mesh as morph targets, and their weights at rest."""
        targets = []
        for shape in surface.shapes:
            vertices = shape.vertices
            if vertices is None:
                vertices = np.arange(len(surface.points))
            offsets = np.zeros((len(surface.points), 3))
            np.add.at(offsets, vertices, shape.deltas)
            stored_offsets = offsets.astype(np.float32)
            target = {"POSITION": self._add_accessor(stored_offsets, has_bounds=True)}
            if "NORMAL" in primitive["attributes"]:
                normal_offsets = np.zeros_like(offsets)
                if shape.normals is not None:
                    np.add.at(normal_offsets, vertices, shape.normals)
                target["NORMAL"] = self._add_accessor(normal_offsets.astype(np.float32))
            targets.append(target)
            if shape.inbetweens:
                self.lost_contents["in-between shapes"].append(shape.name)
        primitive["targets"] = targets
        names = [shape.name for shape in surface.shapes]
        mesh_json["weights"] = [self.weights.get(name, 0.0) for name in names]
        mesh_json["extras"] = {"targetNames": names}


def _to_node_frame(surface: Surface, local: FloatArray) -> Surface:
    """Return a mesh transformed to the frame of the node it is attached to."""
    linear = local[:3, :3]
    normals = surface.normals
    return replace(
        surface,
        points=surface.points @ linear.T + local[:3, 3],
        normals=None if normals is None else normals @ np.linalg.inv(linear),
        shapes=tuple(replace(s, deltas=s.deltas @ linear.T) for s in surface.shapes),
    )


def pad_influences(skin: SurfaceSkin) -> tuple[IntArray, FloatArray]:
    """Return joints and weights, largest first, padded to multiples of four.

    Each joint occurs once per vertex, weights sum to 1, and entries without weight have
    joint 0.
    """
    indices, weights = skin.indices.copy(), skin.weights.astype(np.float64).copy()
    order = np.argsort(indices, axis=1, kind="stable")
    indices = np.take_along_axis(indices, order, 1)
    weights = np.take_along_axis(weights, order, 1)
    for k in range(indices.shape[1] - 1, 0, -1):
        is_duplicate = indices[:, k] == indices[:, k - 1]
        weights[:, k - 1] += np.where(is_duplicate, weights[:, k], 0.0)
        weights[is_duplicate, k] = 0.0
    max_weights = weights.max(axis=1, keepdims=True)
    weights[weights <= MIN_WEIGHT * max_weights] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    indices = np.take_along_axis(indices, order, 1)
    weights = np.take_along_axis(weights, order, 1)
    max_count = int((weights > 0).sum(axis=1).max(initial=1))
    padded_width = max(4, -(-max_count // 4) * 4)
    padded_indices = np.zeros((len(indices), padded_width), np.int64)
    padded_weights = np.zeros((len(indices), padded_width))
    kept_width = min(padded_width, indices.shape[1])
    padded_indices[:, :kept_width] = indices[:, :kept_width]
    padded_weights[:, :kept_width] = weights[:, :kept_width]
    weight_sums = padded_weights.sum(axis=1, keepdims=True)
    has_weight = weight_sums > 0
    padded_weights /= np.where(has_weight, weight_sums, 1.0)
    padded_weights[~has_weight[:, 0]] = [1.0] + [0.0] * (padded_width - 1)
    rounded_weights = padded_weights.astype(np.float32).astype(np.float64)
    rounded_weights[:, 0] += 1.0 - rounded_weights.sum(axis=1)
    padded_indices[rounded_weights == 0.0] = 0
    return padded_indices, rounded_weights


def _lost_contents_notice(
    rig: Rig, lost_contents: dict[str, list[str]], rig_indices: RigIndices
) -> list[Fault]:
    """Return a note about rig contents that glTF cannot store."""
    corrective_names = [shape.name for shape in rig.shapes if len(shape.combine) > 1]
    unwritten_names = [s.name for s in rig.shapes if s.name not in rig_indices.shapes]
    lost_contents["products of shapes (each gets its own weight)"] += corrective_names
    lost_contents["shapes without a mesh (skipped)"] += unwritten_names
    texts = [
        f"{label}: {listed(names, MAX_LISTED_CONTENTS)}"
        for label, names in lost_contents.items()
        if names
    ]
    if not texts:
        return []
    message = f"glTF cannot store {'; '.join(texts)}"
    return [Fault("GLT117", message, severity=Severity.NOTE)]
