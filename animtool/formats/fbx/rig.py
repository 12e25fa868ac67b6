"""An FBX character as a rig: joints, bind pose, meshes and shapes."""

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
from animtool.formats.fbx.geometry import FbxGeometry, ShapeChannel, skin_table
from animtool.formats.fbx.layers import ROTATION, SCALING, TRANSLATION
from animtool.formats.fbx.poses import (
    JointRow,
    NodeTransforms,
    RowKind,
    rows_of,
    uniform_scales,
)
from animtool.formats.fbx.scene import FbxScene
from animtool.rig.parts import Inbetween, LoadedArray, Mesh, Shape, Skin, Subdivision
from animtool.rig.skeleton import Joint, Rig

MAX_LISTED_MESHES = 6
# Tolerance for a mesh that moved since binding, relative to its size: rounding of files
# [1].
MOVED_TOLERANCE = 1e-4
# Shape weights closer to 0 or to each other are equal [1].
SAME_WEIGHT = 1e-5


@dataclass(slots=True, eq=False)
class FbxRig:
    """A rig with the nodes and channels that its joints and shapes come from.

    Attributes:
        rig: J joints.
        rows: Node of each joint; trailing joints that only carry a mesh are omitted.
        joints: Joint of each node; -1 for nodes that are not joints.
        folded_scales: By node, the uniform scale that is folded into lengths below it
            [1].
        factors: Factor of each joint's translations [m].
        is_folded: Whether each joint's scale is folded into lengths ``(J,)``.
        scales: Remaining scales as saved ``(J, 3)`` [1].
        shapes: Channel of each shape, and its percentage at weight 1 [%].
        meshes: Name of the mesh that each node shows.
        notices: Warnings about data that rigs cannot store.
    """

    rig: Rig
    rows: list[JointRow]
    joints: IntArray
    folded_scales: FloatArray
    factors: FloatArray
    is_folded: BoolArray
    scales: FloatArray
    shapes: list[tuple[ShapeChannel, float]]
    meshes: dict[int, str]
    notices: list[Fault] = field(default_factory=list)


def build_rig(
    scene: FbxScene,
    character: CharacterNodes,
    name: str,
    meters: float | None = None,
    *,
    surfaces: bool = True,
) -> FbxRig:
    """Return the rig of a character; the rest pose is the saved scene.

    Every node is a joint, except nodes of skinned meshes without children, whose
    transform has no effect. A uniform static scale is folded into the lengths below it;
    other scales remain in the takes.

    Args:
        scene: The file.
        character: Nodes of the character.
        name: Name of the rig.
        meters: Size of the file's unit [m]; None is the stated unit.
        surfaces: Whether to read meshes and shapes.
    """
    unit = scene.settings.meters if meters is None else meters
    joint_nodes = [
        node for node in character.nodes if not _only_carries_skin(scene, node)
    ]
    joint_nodes = joint_nodes or list(character.nodes)
    rows = rows_of(scene, joint_nodes)
    scales, is_folded = uniform_scales(scene, rows)
    joints = np.full(len(scene.models), -1, np.int64)
    folded_scales = np.ones(len(scene.models))
    parents, factors = [], np.ones(len(rows))
    for j, row in enumerate(rows):
        parent = scene.models[row.model].parent
        length = 1.0 if parent < 0 else float(folded_scales[parent])
        factors[j] = length * unit
        is_inner = row.kind is RowKind.INNER
        parents.append(j - 1 if is_inner else -1 if parent < 0 else int(joints[parent]))
        if row.kind is not RowKind.OUTER:
            joints[row.model] = j
            folded_scales[row.model] = length * (
                float(scales[j].mean()) if is_folded[j] else 1.0
            )
    names, notices = _joint_names(scene, rows)
    rest = NodeTransforms(scene, None, np.zeros(1, np.int64))
    joint_list = []
    for j, row in enumerate(rows):
        translations, rotations, _ = rest.row(row)
        x, y, z = (translations[0] * factors[j]).tolist()
        a, b, c, w = rotations[0].tolist()
        original = scene.models[row.model].name
        source = "" if original == names[j] or row.kind is RowKind.OUTER else original
        joint_list.append(
            Joint(
                names[j],
                parents[j],
                translation=(x, y, z),
                rotation=(a, b, c, w),
                source_name=source,
            )
        )
    scales = np.where(is_folded[:, None], 1.0, scales)
    rig = Rig(name, tuple(joint_list), unit, scene.settings.up)
    fbx_rig = FbxRig(
        rig, rows, joints, folded_scales, factors, is_folded, scales, [], {}, notices
    )
    _add_shapes_and_meshes(scene, character, fbx_rig, surfaces=surfaces)
    fbx_rig.notices += _moved_meshes(scene, character)
    return fbx_rig


def _moved_meshes(scene: FbxScene, character: CharacterNodes) -> list[Fault]:
    """Return a note of skinned meshes whose node moved since binding."""
    rest = NodeTransforms(scene, None, np.zeros(1, np.int64))
    names = []
    for node in character.nodes:
        index = scene.nodes[node].skin
        if index < 0:
            continue
        object_id = scene.models[node].object.id
        is_moved = any(
            track.object_id == object_id
            and track.constant(scene.models[node].base[k]) is None
            for take in scene.takes
            for k, name in enumerate((TRANSLATION, ROTATION, SCALING))
            for track in (take.tracks.get((object_id, name)),)
            if track is not None
        )
        bind = scene.bind[index]
        size = float(np.abs(bind[:3]).max())
        if (
            is_moved
            or np.abs(rest.world(node)[0] - bind).max() > MOVED_TOLERANCE * size
        ):
            names.append(repr(scene.models[node].name))
    if not names:
        return []
    message = "skinned meshes follow only their bones, but their own nodes were moved "
    message += f"after binding: {listed(names, MAX_LISTED_MESHES)}"
    hint = "as in Blender and glTF; Maya also moves them with their node"
    path = str(scene.path)
    return [Fault("FBX117", message, path, (), hint, Severity.WARNING)]


def _only_carries_skin(scene: FbxScene, node: int) -> bool:
    """Return whether a node only carries a skinned mesh."""
    entry = scene.nodes[node]
    if entry.skin < 0 or entry.children:
        return False
    return not any(node in skin.joints for skin in scene.skins)


def _joint_names(
    scene: FbxScene, rows: Sequence[JointRow]
) -> tuple[list[str], list[Fault]]:
    inner_nodes = [row.model for row in rows if row.kind is not RowKind.OUTER]
    inner_names, renamed = joint_names(
        [scene.nodes[node] for node in inner_nodes], inner_nodes
    )
    of_model = dict(zip(inner_nodes, inner_names, strict=True))
    outer_names = [
        f"{of_model[row.model]}_unscaled" if row.kind is RowKind.OUTER else ""
        for row in rows
    ]
    unique = numbered_names([*inner_names, *(name for name in outer_names if name)])
    helpers = iter(unique[len(inner_names) :])
    names = [
        next(helpers) if name else of_model[row.model]
        for name, row in zip(outer_names, rows, strict=True)
    ]
    path = str(scene.path)
    notices = renamed_joints_notice("FBX113", renamed, path)
    added = unique[len(inner_names) :]
    if added:
        message = (
            f"{counted(len(added), 'joint')} added above joints that do not inherit "
        )
        message += (
            f"the non-uniform scale of their parent: {listed(added, MAX_LISTED_MESHES)}"
        )
        notices.append(Fault("FBX112", message, path, severity=Severity.NOTE))
    return names, notices


def _add_shapes_and_meshes(
    scene: FbxScene, character: CharacterNodes, fbx_rig: FbxRig, *, surfaces: bool
) -> None:
    mesh_nodes = [node for node in character.nodes if node in scene.meshes]
    mesh_nodes = [node for node in mesh_nodes if len(scene.meshes[node].faces)]
    printable_names = [
        replace_unprintable(scene.nodes[node].name or "") for node in mesh_nodes
    ]
    mesh_names = numbered_names(
        name or f"mesh_{node}"
        for node, name in zip(mesh_nodes, printable_names, strict=True)
    )
    fbx_rig.meshes = dict(zip(mesh_nodes, mesh_names, strict=True))
    channels = [(n, channel) for n in mesh_nodes for channel in scene.meshes[n].shapes]
    names = shape_names(
        (channel.name, f"{fbx_rig.meshes[node]}_shape", fbx_rig.meshes[node])
        for node, channel in channels
    )
    fbx_rig.shapes += [(channel, _full_percent(channel)) for _, channel in channels]
    if not surfaces:
        shapes = tuple(map(Shape, names))
        fbx_rig.rig = replace(fbx_rig.rig, shapes=shapes)
        return
    shapes = tuple(
        _build_shape(name, fbx_rig.meshes[node], channel, scene.models[node].geometric)
        for name, (node, channel) in zip(names, channels, strict=True)
    )
    binder = SkinBinder(
        scene,
        fbx_rig.rig,
        fbx_rig.joints,
        fbx_rig.folded_scales,
        fbx_rig.scales,
        scene.bind_worlds(),
    )
    meshes = tuple(
        _build_mesh(scene, node, fbx_rig.meshes[node], binder) for node in mesh_nodes
    )
    fbx_rig.rig = binder.build_rig(meshes, shapes)
    fbx_rig.notices += binder.notices
    helper_count = len(fbx_rig.rig.joints) - len(fbx_rig.scales)
    fbx_rig.scales = np.concatenate([fbx_rig.scales, np.ones((helper_count, 3))])


def _full_percent(channel: ShapeChannel) -> float:
    """Return the percentage at which a channel's last target is full."""
    percent = channel.targets[-1][0]
    return percent if abs(percent) > 100 * SAME_WEIGHT else 100.0


def _build_shape(
    name: str, mesh: str, channel: ShapeChannel, geometric: FloatArray
) -> Shape:
    rotation, full_percent = geometric[:3, :3].T, _full_percent(channel)
    inbetweens = [
        Inbetween(at / full_percent, LoadedArray(offsets @ rotation))
        for at, offsets in channel.targets[:-1]
    ]
    inbetweens.sort(key=lambda inbetween_: inbetween_.at)
    full_offsets = LoadedArray(channel.targets[-1][1] @ rotation)
    return Shape(name, mesh, full_offsets, None, tuple(inbetweens))


def _build_mesh(scene: FbxScene, node: int, name: str, binder: SkinBinder) -> Mesh:
    mesh, geometric = scene.meshes[node], scene.models[node].geometric
    points = mesh.points @ geometric[:3, :3].T + geometric[:3, 3]
    skin, geometry = _build_skin(scene, node, mesh, binder)
    bind = tuple(geometry.ravel().tolist())
    return Mesh(
        name,
        LoadedArray(points),
        LoadedArray(mesh.faces.astype(np.float64)),
        None,
        None if (geometry == np.eye(4)).all() else bind,
        skin,
        Subdivision.NONE,
    )


def _build_skin(
    scene: FbxScene, node: int, mesh: FbxGeometry, binder: SkinBinder
) -> tuple[Skin, FloatArray]:
    """Return the skin of a mesh: its bones, or the node that shows it."""
    index = scene.nodes[node].skin
    if index >= 0:
        geometry, joints = binder.bind_skin(index)
        indices, weights = skin_table(mesh)
    else:
        geometry, joint = binder.bind_node(node)
        joints = [joint]
        count = len(mesh.points)
        indices, weights = np.zeros((count, 1), np.int64), np.ones((count, 1))
    names = binder.joint_names()
    skin = Skin(
        mesh.method if index >= 0 else "linear",
        tuple(names[joint] for joint in joints),
        LoadedArray(indices.astype(np.float64)),
        LoadedArray(weights),
    )
    return skin, geometry


def scale_notice(fbx_rig: FbxRig, where: str) -> list[Fault]:
    """Return a notice of joint scales that a rig cannot store."""
    rig = fbx_rig.rig
    has_scale = np.abs(fbx_rig.scales - 1.0).max(axis=1) > 1e-4
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
    return [Fault("FBX111", message, where, (), hint, Severity.WARNING)]
