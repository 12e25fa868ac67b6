"""Contents of a glTF or FBX file: nodes, skins, characters and clips."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import Fault
from animtool.core.files.reading import note_input
from animtool.core.record import dataclass
from animtool.formats.characters.choice import find_characters
from animtool.formats.gltf.document import Gltf, humanoid_bones, open_gltf
from animtool.formats.gltf.timing import unique_clip_names


@dataclass(frozen=True, slots=True)
class GltfClip:
    """An animation clip of a file."""

    name: str
    first_key: float  # [s]
    last_key: float  # [s]
    channels: int


@dataclass(frozen=True, slots=True)
class GltfContents:
    """Contents of a file, both used and unused."""

    nodes: int
    meshes: int
    skins: int
    animations: int
    scenes: int
    characters: list[str]  # paths; empty if the file is one character
    clips: list[GltfClip]
    bones: dict[str, str]  # humanoid bones of a VRM, and the names of their nodes
    not_read: list[str]  # contents that are not read


@dataclass(frozen=True, slots=True)
class GltfDescription:
    """Description of a file that has no nodes to animate."""

    path: str
    format: str
    contents: GltfContents
    notices: list[Fault]


def gltf_contents(path: Path | str) -> GltfContents:
    """Return the contents of a glTF file."""
    return _contents(open_gltf(path))


def describe_without_nodes(path: Path) -> GltfDescription | None:
    """Return the description of a glTF file without nodes; None if it has nodes."""
    note_input(path)
    gltf = open_gltf(path)
    if gltf.nodes:
        return None
    return GltfDescription(str(path), "glTF", _contents(gltf), gltf.notes.notices)


def _contents(gltf: Gltf) -> GltfContents:
    skeletons = find_characters(gltf) if gltf.nodes else ()
    names = unique_clip_names(gltf.animations)
    clips = [
        GltfClip(name, *animation.span, len(animation.tracks))
        for name, animation in zip(names, gltf.animations, strict=True)
    ]
    return GltfContents(
        len(gltf.nodes),
        len(gltf.meshes),
        len(gltf.skins),
        len(gltf.animations),
        len(gltf.scenes),
        [skeleton.path for skeleton in skeletons] if len(skeletons) > 1 else [],
        clips,
        {bone: gltf.nodes[node].name or "" for bone, node in humanoid_bones(gltf)},
        list(gltf.ignored_contents),
    )


def fbx_contents(path: Path | str) -> GltfContents:
    """Return the contents of an FBX file."""
    from animtool.formats.fbx.read import scene_take_names
    from animtool.formats.fbx.scene import open_fbx
    from animtool.formats.fbx.settings import TICKS_PER_SECOND

    scene = open_fbx(path)
    skeletons = find_characters(scene) if scene.nodes else ()
    clips = [
        GltfClip(
            name,
            take.start_ticks / TICKS_PER_SECOND,
            take.end_ticks / TICKS_PER_SECOND,
            len(take.curves()),
        )
        for name, take in zip(scene_take_names(scene), scene.takes, strict=True)
    ]
    return GltfContents(
        len(scene.nodes),
        len(scene.meshes),
        len(scene.skins),
        len(scene.takes),
        1,
        [skeleton.path for skeleton in skeletons] if len(skeletons) > 1 else [],
        clips,
        {},
        list(scene.ignored_contents),
    )
