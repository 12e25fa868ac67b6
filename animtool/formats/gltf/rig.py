"""A glTF character as a rig: joints, bind pose, meshes and shapes."""

from __future__ import annotations

import re
from dataclasses import field

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.quantities import CONTROL
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.formats.characters.binding import SkinBinder
from animtool.formats.characters.choice import CharacterNodes
from animtool.formats.characters.names import joint_names, renamed_joints_notice
from animtool.formats.characters.nodes import SCALE_TOLERANCE
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.surfaces import mesh_names, mesh_parts, names_of_shapes
from animtool.formats.gltf.vrm import humanoid_bones
from animtool.rig.parts import Mesh, Shape
from animtool.rig.skeleton import Joint, Rig

MAX_LISTED_JOINTS = 6
_CONTROL = re.compile(f"[{CONTROL}]")


@dataclass(frozen=True, slots=True, eq=False)
class GltfRig:
    """A rig with the nodes that its joints and shapes come from.

    Attributes:
        rig: J joints.
        nodes: Node of each joint; -1 for a joint that only carries a mesh.
        joints: Joint of each node of the file; -1 for nodes that are not joints.
        folded_scales: By node, the uniform scale folded into the lengths below it
            ``(N,)`` [1].
        scales: Remaining scales at rest ``(J, 3)`` [1].
        shapes: Node and morph target of each shape.
        notices: Warnings about data that rigs cannot store.
    """

    rig: Rig
    nodes: IntArray
    joints: IntArray
    folded_scales: FloatArray
    scales: FloatArray
    shapes: tuple[tuple[int, int], ...]
    notices: list[Fault] = field(default_factory=list)


def build_rig(
    gltf: Gltf,
    character: CharacterNodes,
    name: str,
    meters_per_unit: float = 1.0,
    up: UpAxis = UpAxis.Y,
    *,
    surfaces: bool = True,
) -> GltfRig:
    """Return the rig of a character.

    Every node is a joint, except nodes of skinned meshes without children, whose
    transform has no effect. A uniform static scale is folded into the lengths below it;
    other scales remain in the takes.

    ``surfaces`` selects whether to read meshes and shapes.
    """
    joint_nodes = [
        node
        for node in character.nodes
        if not (_only_carries_skin(gltf, node) or _is_inserted_root(gltf, node))
    ]
    joint_nodes = joint_nodes or list(character.nodes)
    joints = np.full(len(gltf.nodes), -1, np.int64)
    joints[joint_nodes] = np.arange(len(joint_nodes))
    folded_scales = _folded_scales(gltf, character)
    names, renamed = joint_names(
        [gltf.nodes[node] for node in joint_nodes], joint_nodes
    )
    joint_list = []
    bones = {node: bone for bone, node in reversed(humanoid_bones(gltf))}
    for node, joint_name in zip(joint_nodes, names, strict=True):
        entry = gltf.nodes[node]
        parent_scale = 1.0 if entry.parent < 0 else float(folded_scales[entry.parent])
        x, y, z = (
            value * parent_scale * meters_per_unit for value in entry.translation
        )
        original = entry.name or ""
        joint_list.append(
            Joint(
                joint_name,
                -1 if entry.parent < 0 else int(joints[entry.parent]),
                translation=(x, y, z),
                rotation=entry.rotation,
                source_name="" if original == joint_name else original,
                humanoid=bones.get(node, ""),
            )
        )
    scales = np.array([gltf.nodes[node].scale for node in joint_nodes], np.float64)
    scales = np.where(folded_nodes(gltf)[joint_nodes][:, None], 1.0, scales)
    rig_without_meshes = Rig(name, tuple(joint_list), meters_per_unit, up)
    notices = renamed_joints_notice("GLT113", renamed, str(gltf.path))
    meshes: tuple[Mesh, ...] = ()
    shapes: tuple[Shape, ...] = ()
    keys: tuple[tuple[int, int], ...] = ()
    rig, nodes = rig_without_meshes, np.array(joint_nodes, np.int64)
    if surfaces:
        binder = SkinBinder(gltf, rig_without_meshes, joints, folded_scales, scales)
        meshes, shapes, keys, mesh_notices = mesh_parts(gltf, character, binder)
        rig, nodes = binder.build_rig(meshes, shapes), binder.joint_nodes(nodes)
        notices += [*mesh_notices, *binder.notices]
        scales = np.concatenate([scales, np.ones((len(nodes) - len(scales), 3))])
    else:
        keys, shapes = shape_keys(gltf, character)
        rig = Rig(name, tuple(joint_list), meters_per_unit, up, shapes=shapes)
    return GltfRig(rig, nodes, joints, folded_scales, scales, keys, notices)


def shape_keys(
    gltf: Gltf, character: CharacterNodes
) -> tuple[tuple[tuple[int, int], ...], tuple[Shape, ...]]:
    """Return node and target of each shape, and the shapes without arrays."""
    keys: list[tuple[int, int]] = []
    meshes = [node for node in character.nodes if gltf.nodes[node].mesh >= 0]
    for node in meshes:
        count = gltf.meshes[gltf.nodes[node].mesh].targets
        keys += [(node, target) for target in range(count)]
    names = names_of_shapes(gltf, keys, mesh_names(gltf, meshes))
    return tuple(keys), tuple(Shape(name) for name in names)


def _only_carries_skin(gltf: Gltf, node: int) -> bool:
    """Return whether a node only carries a skinned mesh."""
    entry = gltf.nodes[node]
    if entry.skin < 0 or entry.children or entry.mesh < 0:
        return False
    primitives = gltf.meshes[entry.mesh].primitives
    is_skinned = bool(primitives) and all(primitive.joints for primitive in primitives)
    return is_skinned and not any(node in skin.joints for skin in gltf.skins)


def _is_inserted_root(gltf: Gltf, node: int) -> bool:
    """Return whether a node is the identity node that animtool inserts above roots."""
    entry = gltf.nodes[node]
    if not entry.is_inserted or entry.parent >= 0:
        return False
    if any(node in skin.joints for skin in gltf.skins):
        return False
    if any(
        track.node == node
        for animation in gltf.animations
        for track in animation.tracks
    ):
        return False
    identity = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0)
    return (entry.translation, entry.rotation, entry.scale) == identity


def folded_nodes(gltf: Gltf) -> BoolArray:
    """Return which nodes have a uniform static scale ``(N,)``."""
    scales = np.array([node.scale for node in gltf.nodes]).reshape(-1, 3)
    smallest, largest = scales.min(axis=1), scales.max(axis=1)
    is_uniform = (smallest > 0) & (
        largest - smallest <= SCALE_TOLERANCE * np.abs(largest)
    )
    for animation in gltf.animations:
        for track in animation.tracks:
            if track.path is TargetPath.SCALE and is_uniform[track.node]:
                scale = scales[track.node]
                difference = np.abs(track.values - scale).max()
                slopes = [
                    slope for slope in (track.ins, track.outs) if slope is not None
                ]
                is_moving = any(
                    np.abs(slope).max() > SCALE_TOLERANCE for slope in slopes
                )
                is_uniform[track.node] = (
                    not is_moving and difference <= SCALE_TOLERANCE * scale.max()
                )
    return np.asarray(is_uniform)


def _folded_scales(gltf: Gltf, character: CharacterNodes) -> FloatArray:
    """Return the product of uniform scales from the root to each node ``(N,)``."""
    is_folded = folded_nodes(gltf)
    folded_scales = np.ones(len(gltf.nodes))
    for node in character.nodes:
        entry = gltf.nodes[node]
        parent_scale = 1.0 if entry.parent < 0 else folded_scales[entry.parent]
        folded_scales[node] = parent_scale * (
            float(np.mean(entry.scale)) if is_folded[node] else 1.0
        )
    return folded_scales


def scale_notice(gltf_rig: GltfRig, where: str) -> list[Fault]:
    """Return a notice of joint scales that a rig cannot store."""
    rig = gltf_rig.rig
    has_scale = np.abs(gltf_rig.scales - 1.0).max(axis=1) > 1e-4
    names = [rig.names[j] for j in np.flatnonzero(has_scale).tolist()]
    if not names:
        return []
    message = "scales at rest that a rig cannot store: "
    message += listed(names, MAX_LISTED_JOINTS)
    hint = "takes of the file keep them"
    return [Fault("GLT111", message, where, (), hint, Severity.WARNING)]
