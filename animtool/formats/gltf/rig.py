"""Builds a rig from a glTF character: joints, bind pose, meshes and shapes."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.characters.binding import SkinBinder
from animtool.formats.characters.choice import CharacterNodes
from animtool.formats.characters.names import joint_names, renamed_joints_notice
from animtool.formats.characters.nodes import (
    NO_TRANSFORM,
    SCALE_TOLERANCE,
    is_uniform_scale,
)
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.document import Gltf, humanoid_bones
from animtool.formats.gltf.surfaces import build_meshes
from animtool.rig.skeleton import Joint, Rig

MAX_LISTED_JOINTS = 6


@dataclass(frozen=True, slots=True, eq=False)
class GltfRig:
    """A rig, and the nodes of its joints and shapes."""

    rig: Rig  # J joints
    # Joint of each node of the file; -1 for nodes that are not joints.
    joint_of_node: IntArray
    # By node, the uniform scale baked into the lengths below it ``(N,)`` [1].
    baked_scales: FloatArray
    remaining_scales: FloatArray  # scales at rest that are not baked ``(J, 3)`` [1]
    shape_sources: tuple[tuple[int, int], ...]  # node and morph target of each shape
    # Warnings about data that rigs cannot store.
    notices: list[Fault] = field(default_factory=list)


def build_rig(
    gltf: Gltf,
    character: CharacterNodes,
    name: str,
    meters_per_unit: float = 1.0,
    up: UpAxis = UpAxis.Y,
) -> GltfRig:
    """Return the rig of a character, in the rest pose of the file.

    Every node is a joint, except nodes of skinned meshes without children, whose
    transform has no effect. A uniform static scale is baked into the lengths below it;
    other scales remain in the takes.
    """
    joint_nodes = [
        node
        for node in character.nodes
        if not (_is_skinned_mesh_only(gltf, node) or _is_inserted_root(gltf, node))
    ]
    joint_nodes = joint_nodes or list(character.nodes)
    joint_of_node = np.full(len(gltf.nodes), -1, np.int64)
    joint_of_node[joint_nodes] = np.arange(len(joint_nodes))
    is_baked = find_baked_nodes(gltf)
    baked_scales = _baked_scales(gltf, character, is_baked)
    names, renamed_joints = joint_names(
        [gltf.nodes[n] for n in joint_nodes], joint_nodes
    )
    rig_joints = []
    humanoid_names = {node: bone for bone, node in reversed(humanoid_bones(gltf))}
    for node, joint_name in zip(joint_nodes, names, strict=True):
        gltf_node = gltf.nodes[node]
        parent_scale = (
            1.0 if gltf_node.parent < 0 else float(baked_scales[gltf_node.parent])
        )
        x, y, z = (v * parent_scale * meters_per_unit for v in gltf_node.translation)
        original_name = gltf_node.name or ""
        rig_joints.append(
            Joint(
                joint_name,
                -1 if gltf_node.parent < 0 else int(joint_of_node[gltf_node.parent]),
                translation=(x, y, z),
                rotation=gltf_node.rotation,
                source_name="" if original_name == joint_name else original_name,
                humanoid=humanoid_names.get(node, ""),
            )
        )
    remaining_scales = np.array([gltf.nodes[n].scale for n in joint_nodes], np.float64)
    remaining_scales = np.where(is_baked[joint_nodes][:, None], 1.0, remaining_scales)
    rig_without_meshes = Rig(name, tuple(rig_joints), meters_per_unit, up)
    binder = SkinBinder(gltf, rig_without_meshes, joint_of_node, baked_scales)
    meshes, shapes, shape_sources, notices = build_meshes(gltf, character, binder)
    rig = binder.build_rig(meshes, shapes)
    helper_scales = np.ones((len(rig.joints) - len(remaining_scales), 3))
    return GltfRig(
        rig,
        joint_of_node,
        baked_scales,
        np.concatenate([remaining_scales, helper_scales]),
        shape_sources,
        [
            *renamed_joints_notice("GLT113", renamed_joints, str(gltf.path)),
            *notices,
            *binder.notices,
        ],
    )


def _is_skinned_mesh_only(gltf: Gltf, node: int) -> bool:
    """Return whether a node is not a joint but has a skinned mesh and no children."""
    gltf_node = gltf.nodes[node]
    if gltf_node.skin < 0 or gltf_node.children or gltf_node.mesh < 0:
        return False
    primitives = gltf.meshes[gltf_node.mesh].primitives
    is_skinned = bool(primitives) and all(
        primitive.joint_accessors for primitive in primitives
    )
    return is_skinned and not any(node in skin.joints for skin in gltf.skins)


def _is_inserted_root(gltf: Gltf, node: int) -> bool:
    """Return whether a node is the one that animtool inserts above several roots."""
    gltf_node = gltf.nodes[node]
    if not gltf_node.is_inserted or gltf_node.parent >= 0:
        return False
    if any(node in skin.joints for skin in gltf.skins):
        return False
    if any(t.node == node for a in gltf.animations for t in a.tracks):
        return False
    return (gltf_node.translation, gltf_node.rotation, gltf_node.scale) == NO_TRANSFORM


def find_baked_nodes(gltf: Gltf) -> BoolArray:
    """Return whether each node has a uniform scale without animation ``(N,)``."""
    scales = np.array([node.scale for node in gltf.nodes]).reshape(-1, 3)
    is_uniform = is_uniform_scale(scales)
    for animation in gltf.animations:
        for track in animation.tracks:
            if track.path is TargetPath.SCALE and is_uniform[track.node]:
                scale, slopes = scales[track.node], (track.in_slopes, track.out_slopes)
                deviation = np.abs(track.values - scale).max()
                has_slope = any(
                    s is not None and np.abs(s).max() > SCALE_TOLERANCE for s in slopes
                )
                is_static = deviation <= SCALE_TOLERANCE * scale.max()
                is_uniform[track.node] = is_static and not has_slope
    return is_uniform


def _baked_scales(
    gltf: Gltf, character: CharacterNodes, is_baked: BoolArray
) -> FloatArray:
    """Return the product of uniform scales from the root to each node ``(N,)``."""
    baked_scales = np.ones(len(gltf.nodes))
    for node in character.nodes:
        gltf_node = gltf.nodes[node]
        parent_scale = 1.0 if gltf_node.parent < 0 else baked_scales[gltf_node.parent]
        scale = float(np.mean(gltf_node.scale)) if is_baked[node] else 1.0
        baked_scales[node] = parent_scale * scale
    return baked_scales


def scale_notice(gltf_rig: GltfRig, path: str) -> list[Fault]:
    """Return a warning about joint scales that a rig cannot store."""
    rig = gltf_rig.rig
    has_scale = np.abs(gltf_rig.remaining_scales - 1.0).max(axis=1) > 1e-4
    names = [rig.names[j] for j in np.flatnonzero(has_scale).tolist()]
    if not names:
        return []
    message = "scales at rest that a rig cannot store: "
    message += listed(names, MAX_LISTED_JOINTS)
    hint = "takes of the file keep them"
    return [Fault("GLT111", message, path, (), hint, Severity.WARNING)]
