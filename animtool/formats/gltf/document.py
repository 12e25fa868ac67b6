"""Reads a glTF file: nodes, meshes, skins, animations and humanoid bones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animtool.core.errors import excerpt, value_excerpt
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import FileSkin, Node, find_root_nodes
from animtool.formats.file_diagnostics import FileDiagnostics
from animtool.formats.gltf.accessors import Accessors
from animtool.formats.gltf.animation_targets import POINTER_EXTENSION
from animtool.formats.gltf.animations import Animation, read_animations
from animtool.formats.gltf.container import Container, read_container
from animtool.formats.gltf.json_items import JsonItem, escape_pointer, is_number
from animtool.formats.gltf.meshes import (
    QUANTIZATION_EXTENSION,
    GltfMesh,
    Primitive,
    read_meshes,
    read_skin_weights,
    read_skins,
)
from animtool.formats.gltf.nodes import VISIBILITY_EXTENSION, read_nodes, read_scenes
from animtool.formats.gltf.unused import find_unused_indices

# Required extensions that are supported.
SUPPORTED_EXTENSIONS = frozenset(
    {QUANTIZATION_EXTENSION, POINTER_EXTENSION, VISIBILITY_EXTENSION}
)
# Extensions that must be listed as required if they are used.
REQUIRED_EXTENSIONS = frozenset({QUANTIZATION_EXTENSION})
# Extensions for appearance only, which motion does not need.
APPEARANCE_PREFIXES = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "ADOBE_mat",
)
APPEARANCE_EXTENSIONS = frozenset(
    {
        "KHR_lights_punctual",
        "EXT_lights_ies",
        "EXT_lights_image_based",
        "KHR_xmp",
        "KHR_xmp_json_ld",
        "MSFT_packing_normalRoughnessMetallic",
        "MSFT_packing_occlusionRoughnessMetallic",
        "VRMC_materials_mtoon",
        "VRMC_vrm",
        "VRM",
    }
)
# Extensions that pack the data of meshes, and the command that unpacks a file.
PACKED_EXTENSIONS = frozenset(
    {
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "KHR_draco_mesh_compression",
    }
)
UNPACK_COMMAND = "npx @gltf-transform/cli copy {0} unpacked.glb"
_IGNORED_LISTS = ("materials", "textures", "images", "samplers", "cameras")


@dataclass(frozen=True, slots=True, eq=False)
class Gltf:
    """Nodes, meshes, skins and animations of a glTF file."""

    path: Path  # path of the file
    nodes: tuple[Node, ...]  # nodes in file order
    skins: tuple[FileSkin, ...]  # skins in file order
    meshes: tuple[GltfMesh, ...]  # meshes in file order
    animations: tuple[Animation, ...]  # animations in file order
    scenes: list[list[int]]  # root nodes of each scene
    default_scene: int  # index of the default scene; -1 if there is none
    accessors: Accessors  # accessors of the file
    json_root: JsonItem  # the JSON
    diagnostics: FileDiagnostics  # collects warnings and notes
    ignored_contents: tuple[str, ...]  # labels of contents that are not read


@expects_format("GLT001", "a glTF file")
def open_gltf(path: Path | str) -> Gltf:
    """Open a .gltf or .glb, and validate all numbers that affect motion."""
    path = Path(path)
    diagnostics = FileDiagnostics(str(path))
    container = read_container(path, diagnostics)
    json_root = container.json_root
    _check_asset(json_root)
    _check_extensions(container, path)
    unused_indices = find_unused_indices(json_root.values)
    accessors = Accessors(container, path.parent, unused_indices)
    nodes = read_nodes(
        json_root, _list_length(json_root, "meshes"), _list_length(json_root, "skins")
    )
    scenes, default_scene = read_scenes(json_root, nodes)
    meshes = read_meshes(json_root, accessors)
    skins = read_skins(json_root, accessors, len(nodes))
    _check_weights(nodes, meshes, diagnostics)
    animations = read_animations(json_root, accessors, nodes, meshes)
    gltf = Gltf(
        path,
        nodes,
        skins,
        meshes,
        animations,
        scenes,
        default_scene,
        accessors,
        json_root,
        diagnostics,
        _find_ignored_contents(container),
    )
    _check_geometry(gltf)
    return gltf


def _list_length(json_root: JsonItem, key: str) -> int:
    items: Any = json_root.values.get(key, [])
    return len(items) if isinstance(items, list) else 0


def _check_asset(json_root: JsonItem) -> None:
    diagnostics, asset = json_root.diagnostics, json_root.required_child("asset")
    version = asset.text("version")
    if version is None:
        asset.fail_missing("version")
    if version.split(".")[0] != "2":
        message = f"glTF {excerpt(version)} is not supported, only 2"
        diagnostics.fail(
            "GLT003", asset.pointer_to("version"), message, "export glTF 2.0"
        )
    min_version = asset.text("minVersion")
    if min_version is not None and min_version != "2.0":
        message = f"the file needs glTF {excerpt(min_version)}; 2.0 is supported"
        diagnostics.fail("GLT003", asset.pointer_to("minVersion"), message)


def _check_extensions(container: Container, path: Path) -> None:
    """Raise for unsupported required extensions that affect motion."""
    json_root, diagnostics = container.json_root, container.json_root.diagnostics
    used_names, required_names = _check_extension_lists(json_root)
    for i, name in enumerate(required_names):
        pointer = f"{json_root.pointer_to('extensionsRequired')}/{i}"
        if not isinstance(name, str):
            diagnostics.fail("GLT005", pointer, "the name of an extension must be text")
        if _can_read_without(name):
            continue
        hint = "export the file without it"
        if name in PACKED_EXTENSIONS:
            hint = f"unpack it with {UNPACK_COMMAND.format(path.name)}"
        message = f"the file needs the extension {name}, which is not supported"
        diagnostics.fail("GLT004", pointer, message, hint)
    used_extensions = (
        _used_extensions(json_root) if container.may_have_extensions else {}
    )
    for name, pointer in used_extensions.items():
        if name not in used_names:
            effect = "" if name in SUPPORTED_EXTENSIONS else ", so it is ignored"
            message = f"the extension {excerpt(name)} is not declared{effect}"
            diagnostics.warn("GLT106", pointer, message)


def _check_extension_lists(json_root: JsonItem) -> tuple[list[Any], list[Any]]:
    """Return extensionsUsed and extensionsRequired; warn of contradictions."""
    keys, diagnostics = ("extensionsUsed", "extensionsRequired"), json_root.diagnostics
    used_names, required_names = (json_root.read_list(key) for key in keys)
    for key, names in zip(keys, (used_names, required_names), strict=True):
        for i, name in enumerate(names):
            if name in names[:i]:
                message = f"{excerpt(str(name))} is listed twice"
                diagnostics.warn("GLT106", f"{json_root.pointer_to(key)}/{i}", message)
    for i, name in enumerate(used_names):
        pointer = f"{json_root.pointer_to('extensionsUsed')}/{i}"
        if not isinstance(name, str):
            message = f"{value_excerpt(name)} is not an extension name and is ignored"
            diagnostics.warn("GLT106", pointer, message)
        elif name in REQUIRED_EXTENSIONS and name not in required_names:
            diagnostics.warn("GLT106", pointer, f"{name} is used, but not required")
    for i, name in enumerate(required_names):
        if isinstance(name, str) and name not in used_names:
            message = f"{excerpt(name)} is required, but not listed as used"
            pointer = f"{json_root.pointer_to('extensionsRequired')}/{i}"
            diagnostics.warn("GLT106", pointer, message)
    return used_names, required_names


def _find_ignored_contents(container: Container) -> tuple[str, ...]:
    """Return labels of contents and extensions that are not read."""
    json_root = container.json_root
    labels = [key for key in _IGNORED_LISTS if json_root.values.get(key)]
    names = _used_extensions(json_root) if container.may_have_extensions else {}
    if "KHR_lights_punctual" in names:
        labels.append("lights")
    return (*labels, *(name for name in names if not _can_read_without(name)))


def _can_read_without(extension: str) -> bool:
    """Return whether an extension is supported, or affects only appearance."""
    is_known = extension in SUPPORTED_EXTENSIONS | APPEARANCE_EXTENSIONS
    return is_known or extension.startswith(APPEARANCE_PREFIXES)


def _used_extensions(json_root: JsonItem) -> dict[str, str]:
    """Return used extensions, each with the pointer to its first use."""
    first_uses: dict[str, str] = {}
    pending: list[tuple[Any, str]] = [(json_root.values, "")]
    while pending:
        value, pointer = pending.pop()
        if isinstance(value, dict):
            extensions = value.get("extensions")
            for name in extensions if isinstance(extensions, dict) else ():
                first_uses.setdefault(
                    name, f"{pointer}/extensions/{escape_pointer(name)}"
                )
            pending += [
                (value[key], f"{pointer}/{escape_pointer(key)}")
                for key in reversed(value)
                if key not in {"extras", "extensions"}
                and isinstance(value[key], dict | list)
            ]
        elif isinstance(value, list) and value and isinstance(value[0], dict | list):
            pending += [
                (value[i], f"{pointer}/{i}") for i in range(len(value) - 1, -1, -1)
            ]
    return first_uses


def _check_weights(
    nodes: tuple[Node, ...], meshes: tuple[GltfMesh, ...], diagnostics: FileDiagnostics
) -> None:
    for i, node in enumerate(nodes):
        if node.weights is not None:
            target_count = meshes[node.mesh].target_count
            if len(node.weights) != target_count:
                message = f"{len(node.weights)} weights for {target_count} targets"
                diagnostics.fail("GLT011", f"/nodes/{i}/weights", message)


def _check_geometry(gltf: Gltf) -> None:
    """Read the mesh data and skin weights that nodes use; check skins against nodes."""
    checked_mesh_skins: set[tuple[int, int]] = set()
    for node in gltf.nodes:
        if node.mesh < 0 or (node.mesh, node.skin) in checked_mesh_skins:
            continue
        checked_mesh_skins.add((node.mesh, node.skin))
        for primitive in gltf.meshes[node.mesh].primitives:
            _require_mesh_data(gltf.accessors, primitive)
            if primitive.joint_accessors and node.skin >= 0:
                joint_count = len(gltf.skins[node.skin].joints)
                read_skin_weights(primitive, joint_count, gltf.accessors)
    roots = find_root_nodes(gltf.nodes)
    _check_scenes(gltf, roots)
    for skin in gltf.skins:
        if skin.skeleton >= 0 and not _is_ancestor(gltf, skin.skeleton, skin.joints[0]):
            message = f"node {skin.skeleton} is not above the joints and is ignored"
            gltf.diagnostics.warn("GLT106", f"{skin.location}/skeleton", message)
        if len({roots[joint] for joint in skin.joints}) > 1:
            message = "the joints have no common root: each chain is read"
            gltf.diagnostics.warn("GLT106", f"{skin.location}/joints", message)


def _check_scenes(gltf: Gltf, roots: list[int]) -> None:
    """Warn about scenes with a skinned mesh but without its joints.

    ``roots`` has the root node of each node.
    """
    scenes = [set(scene) for scene in gltf.scenes]
    skin_roots = [{roots[joint] for joint in skin.joints} for skin in gltf.skins]
    for i, node in enumerate(gltf.nodes):
        if node.skin < 0:
            continue
        if any(roots[i] in s and not skin_roots[node.skin] & s for s in scenes):
            message = "a scene shows the mesh without the joints of its skin"
            gltf.diagnostics.warn("GLT106", f"/nodes/{i}", f"{message}: they count too")


def _require_mesh_data(accessors: Accessors, primitive: Primitive) -> None:
    """Read the accessors of a mesh primitive; raise if data is missing."""
    for index in (
        primitive.position_accessor,
        primitive.index_accessor,
        *primitive.joint_accessors,
        *primitive.weight_accessors,
        *(target.position_accessor for target in primitive.targets),
    ):
        if index >= 0:
            accessors.numbers(index)


def _is_ancestor(gltf: Gltf, ancestor: int, node: int) -> bool:
    while node >= 0 and node != ancestor:
        node = gltf.nodes[node].parent
    return node == ancestor


def humanoid_bones(gltf: Gltf) -> list[tuple[str, int]]:
    """Return the humanoid bones of a VRM 1.0 or 0.x, each with its node."""
    extensions = gltf.json_root.values.get("extensions")
    if not isinstance(extensions, dict):
        return []
    named_bones: list[tuple[str, Any]] = []
    for key in ("VRMC_vrm", "VRM"):
        extension = extensions.get(key)
        humanoid = extension.get("humanoid") if isinstance(extension, dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, dict):
            named_bones += [(str(name), bone) for name, bone in bones.items()]
        elif isinstance(bones, list):
            bone_objects = [bone for bone in bones if isinstance(bone, dict)]
            named_bones += [(str(bone.get("bone")), bone) for bone in bone_objects]
    return [
        (name, int(bone["node"]))
        for name, bone in named_bones
        if isinstance(bone, dict)
        and is_number(bone.get("node"))
        and 0 <= bone["node"] < len(gltf.nodes)
    ]
