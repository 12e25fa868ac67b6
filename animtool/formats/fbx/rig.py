"""Builds the rig of an FBX character: joints, bind pose, meshes and shapes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.names import numbered_names
from animtool.core.record import dataclass
from animtool.formats.characters.binding import SkinBinder
from animtool.formats.characters.choice import CharacterNodes
from animtool.formats.characters.names import (
    joint_names,
    renamed_joints_notice,
    replace_unprintable,
    shape_names,
)
from animtool.formats.fbx.geometry import ShapeChannel, build_skin_table
from animtool.formats.fbx.models import TRANSFORM_PROPERTIES
from animtool.formats.fbx.poses import (
    JointSource,
    NodeTransforms,
    TransformPart,
    find_uniform_scales,
    list_joint_sources,
)
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.takes import find_track
from animtool.rig.parts import Inbetween, LoadedArray, Mesh, Shape, Subdivision
from animtool.rig.skeleton import Joint, Rig

MAX_LISTED_MESHES = 6
# Tolerance for a mesh that moved after binding, relative to its size [1].
BIND_TOLERANCE = 1e-4
# Tolerance of equal shape weights [1].
WEIGHT_TOLERANCE = 1e-5


@dataclass(slots=True, eq=False)
class FbxRig:
    """A rig, and the nodes and channels of its joints and shapes."""

    rig: Rig  # J joints
    # Source of each joint, without the helper joints of meshes at the end.
    joint_sources: list[JointSource]
    joint_of_node: IntArray  # joint of each node; -1 for nodes that are not joints
    # By node, the uniform scale that is baked into lengths below it [1].
    baked_scales: FloatArray
    translation_factors: FloatArray  # factor of each joint's translations [m]
    is_baked: BoolArray  # whether each joint's scale is baked into lengths ``(J,)``
    remaining_scales: FloatArray  # saved scales that are not baked ``(J, 3)`` [1]
    # Channel of each shape, and its percentage at weight 1 [%].
    shape_channels: list[tuple[ShapeChannel, float]] = field(default_factory=list)
    # Name of the mesh that each node shows.
    mesh_names: dict[int, str] = field(default_factory=dict)
    # Warnings about data that rigs cannot store.
    notices: list[Fault] = field(default_factory=list)


def build_rig(
    scene: FbxScene,
    character: CharacterNodes,
    name: str,
    meters_per_unit: float | None = None,
) -> FbxRig:
    """Return the rig of a character; the rest pose is the saved scene.

    Every node is a joint, except nodes of skinned meshes without children, whose
    transform has no effect. A uniform static scale is baked into the lengths below it;
    other scales remain in the takes.

    Args:
        scene: The file.
        character: Nodes of the character.
        name: Name of the rig.
        meters_per_unit: Size of the file's unit [m]; None is the stated unit.
    """
    unit_meters = scene.settings.meters if meters_per_unit is None else meters_per_unit
    joint_nodes = [n for n in character.nodes if not _is_skinned_mesh_only(scene, n)]
    joint_nodes = joint_nodes or list(character.nodes)
    sources = list_joint_sources(scene, joint_nodes)
    saved_scales, is_baked = find_uniform_scales(scene, sources)
    joint_of_node = np.full(len(scene.models), -1, np.int64)
    baked_scales = np.ones(len(scene.models))
    parents, factors = [], np.ones(len(sources))
    for j, source in enumerate(sources):
        parent = scene.models[source.model].parent
        scale_above = 1.0 if parent < 0 else float(baked_scales[parent])
        factors[j] = scale_above * unit_meters
        is_inner = source.part is TransformPart.INNER
        parents.append(
            j - 1 if is_inner else -1 if parent < 0 else int(joint_of_node[parent])
        )
        if source.part is not TransformPart.OUTER:
            joint_of_node[source.model] = j
            scale = float(saved_scales[j].mean()) if is_baked[j] else 1.0
            baked_scales[source.model] = scale_above * scale
    names, notices = _joint_names(scene, sources)
    rest_transforms = NodeTransforms(scene, None, np.zeros(1, np.int64))
    rig_joints = []
    for j, source in enumerate(sources):
        translations, rotations, _ = rest_transforms.joint_transforms(source)
        x, y, z = (translations[0] * factors[j]).tolist()
        a, b, c, w = rotations[0].tolist()
        joint = Joint(
            names[j], parents[j], translation=(x, y, z), rotation=(a, b, c, w)
        )
        file_name = scene.models[source.model].name
        if file_name != names[j] and source.part is not TransformPart.OUTER:
            joint = replace(joint, source_name=file_name)
        rig_joints.append(joint)
    saved_scales = np.where(is_baked[:, None], 1.0, saved_scales)
    rig = Rig(name, tuple(rig_joints), unit_meters, scene.settings.up)
    fbx_rig = FbxRig(
        rig, sources, joint_of_node, baked_scales, factors, is_baked, saved_scales
    )
    fbx_rig.notices += notices
    _add_shapes_and_meshes(scene, character, fbx_rig)
    fbx_rig.notices += _moved_meshes_notice(scene, character)
    return fbx_rig


def _moved_meshes_notice(scene: FbxScene, character: CharacterNodes) -> list[Fault]:
    """Return a warning about skinned meshes whose nodes were moved after binding."""
    rest = NodeTransforms(scene, None, np.zeros(1, np.int64))
    moved_names = []
    for node in character.nodes:
        skin_index = scene.nodes[node].skin
        if skin_index < 0:
            continue
        object_id = scene.models[node].object.id
        tracks = [
            find_track(take, object_id, name)
            for take in scene.takes
            for name in TRANSFORM_PROPERTIES
        ]
        is_animated = any(track and not track.is_static() for track in tracks)
        bind = scene.mesh_bind_worlds[skin_index]
        max_magnitude = float(np.abs(bind[:3]).max())
        deviation = np.abs(rest.world_matrices(node)[0] - bind).max()
        if is_animated or deviation > BIND_TOLERANCE * max_magnitude:
            moved_names.append(repr(scene.models[node].name))
    if not moved_names:
        return []
    message = "skinned meshes were moved by their nodes after binding: "
    message += f"{listed(moved_names, MAX_LISTED_MESHES)}; this is ignored, as in "
    message += "Blender and glTF, but Maya moves them"
    hint = "freeze the transforms of the nodes, or bind the meshes again"
    path = str(scene.path)
    return [Fault("FBX117", message, path, (), hint, Severity.WARNING)]


def _is_skinned_mesh_only(scene: FbxScene, node: int) -> bool:
    """Return whether a node is not a joint but has a skinned mesh and no children."""
    fbx_node = scene.nodes[node]
    if fbx_node.skin < 0 or fbx_node.children:
        return False
    return not any(node in skin.joints for skin in scene.skins)


def _joint_names(
    scene: FbxScene, sources: Sequence[JointSource]
) -> tuple[list[str], list[Fault]]:
    full_nodes = [
        source.model for source in sources if source.part is not TransformPart.OUTER
    ]
    nodes = [scene.nodes[node] for node in full_nodes]
    full_names, renamed_joints = joint_names(nodes, full_nodes)
    names_by_model = dict(zip(full_nodes, full_names, strict=True))
    outer_names = [
        f"{names_by_model[s.model]}_unscaled"
        for s in sources
        if s.part is TransformPart.OUTER
    ]
    added_names = numbered_names([*full_names, *outer_names])[len(full_names) :]
    next_names = iter(added_names)
    names = [
        next(next_names) if s.part is TransformPart.OUTER else names_by_model[s.model]
        for s in sources
    ]
    path = str(scene.path)
    notices = renamed_joints_notice("FBX113", renamed_joints, path)
    if added_names:
        message = (
            f"{counted(len(added_names), 'joint')} added above joints that do not "
            "inherit the non-uniform scale of their parent: "
            f"{listed(added_names, MAX_LISTED_MESHES)}"
        )
        notices.append(Fault("FBX112", message, path, severity=Severity.NOTE))
    return names, notices


def _add_shapes_and_meshes(
    scene: FbxScene, character: CharacterNodes, fbx_rig: FbxRig
) -> None:
    mesh_nodes = [node for node in character.nodes if node in scene.meshes]
    mesh_nodes = [node for node in mesh_nodes if len(scene.meshes[node].faces)]
    mesh_names = numbered_names(
        replace_unprintable(scene.nodes[node].name or "") or f"mesh_{node}"
        for node in mesh_nodes
    )
    fbx_rig.mesh_names = dict(zip(mesh_nodes, mesh_names, strict=True))
    channels = [(n, c) for n in mesh_nodes for c in scene.meshes[n].shapes]
    names = shape_names(
        (channel.name, f"{fbx_rig.mesh_names[node]}_shape", fbx_rig.mesh_names[node])
        for node, channel in channels
    )
    fbx_rig.shape_channels += [(c, _full_percent(c)) for _, c in channels]
    shapes = []
    for name, (node, channel) in zip(names, channels, strict=True):
        geometric_transform = scene.models[node].geometric_transform
        mesh_name = fbx_rig.mesh_names[node]
        shapes.append(_build_shape(name, mesh_name, channel, geometric_transform))
    binder = SkinBinder(
        scene,
        fbx_rig.rig,
        fbx_rig.joint_of_node,
        fbx_rig.baked_scales,
        scene.bind_worlds(),
    )
    meshes = tuple(
        _build_mesh(scene, node, name, binder)
        for node, name in fbx_rig.mesh_names.items()
    )
    fbx_rig.rig = binder.build_rig(meshes, tuple(shapes))
    fbx_rig.notices += binder.notices
    helper_count = len(fbx_rig.rig.joints) - len(fbx_rig.remaining_scales)
    scales = [fbx_rig.remaining_scales, np.ones((helper_count, 3))]
    fbx_rig.remaining_scales = np.concatenate(scales)


def _full_percent(channel: ShapeChannel) -> float:
    """Return the percentage at which a channel's last target has full effect."""
    percent = channel.targets[-1][0]
    return percent if abs(percent) > 100 * WEIGHT_TOLERANCE else 100.0


def _build_shape(
    name: str, mesh: str, channel: ShapeChannel, geometric_transform: FloatArray
) -> Shape:
    transposed_linear, full_percent = (
        geometric_transform[:3, :3].T,
        _full_percent(channel),
    )
    inbetweens = [
        Inbetween(
            weight_percent / full_percent, LoadedArray(offsets @ transposed_linear)
        )
        for weight_percent, offsets in channel.targets[:-1]
    ]
    inbetweens.sort(key=lambda inbetween: inbetween.at)
    full_offsets = LoadedArray(channel.targets[-1][1] @ transposed_linear)
    return Shape(name, mesh, full_offsets, None, tuple(inbetweens))


def _build_mesh(scene: FbxScene, node: int, name: str, binder: SkinBinder) -> Mesh:
    mesh, geometric_transform = (
        scene.meshes[node],
        scene.models[node].geometric_transform,
    )
    points = mesh.points @ geometric_transform[:3, :3].T + geometric_transform[:3, 3]
    skin_index = scene.nodes[node].skin
    if skin_index >= 0:
        geom_bind, joints = binder.bind_skin(skin_index)
        skin = binder.build_skin(mesh.method, joints, *build_skin_table(mesh))
    else:
        skin, geom_bind = binder.bind_node(node, len(points))
    bind = tuple(geom_bind.ravel().tolist())
    return Mesh(
        name,
        LoadedArray(points),
        LoadedArray(mesh.faces.astype(np.float64)),
        None,
        None if (geom_bind == np.eye(4)).all() else bind,
        skin,
        Subdivision.NONE,
    )


def scale_notice(fbx_rig: FbxRig, path: str) -> list[Fault]:
    """Return a warning about joint scales that a rig cannot store."""
    rig = fbx_rig.rig
    has_scale = np.abs(fbx_rig.remaining_scales - 1.0).max(axis=1) > 1e-4
    names = Counter(rig.names[j] for j in np.flatnonzero(has_scale).tolist())
    names.update(
        name
        for name, pose in rig.bind.items()
        if pose.stretch is not None
        and np.abs(np.array(pose.stretch).reshape(3, 3) - np.eye(3)).max() > 1e-4
    )
    if not names:
        return []
    message = "scales of rest or bind transforms that a rig file cannot store: "
    message += listed(list(names), MAX_LISTED_MESHES)
    hint = "takes of the file keep them; a rig file made from it does not"
    return [Fault("FBX111", message, path, (), hint, Severity.WARNING)]
