"""Contents of a glTF or FBX file: nodes, skins, characters and clips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animtool.core.errors import Fault
from animtool.core.files.reading import record_input
from animtool.core.record import dataclass
from animtool.formats.characters.choice import find_characters
from animtool.formats.gltf.document import Gltf, humanoid_bones, open_gltf
from animtool.formats.gltf.timing import unique_clip_names


@dataclass(frozen=True, slots=True)
class GltfClip:
    """An animation of a glTF file, or a take of an FBX file."""

    name: str
    first_key: float  # [s]
    last_key: float  # [s]
    channels: int


@dataclass(frozen=True, slots=True)
class GltfContents:
    """Counts and names of what a glTF or FBX file contains, used or not."""

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
    """Open a glTF file and return its contents."""
    return _describe_gltf(open_gltf(path))


def describe_nodeless_gltf(path: Path) -> GltfDescription | None:
    """Return the description of a glTF file without nodes; None if it has nodes."""
    record_input(path)
    gltf = open_gltf(path)
    if gltf.nodes:
        return None
    return GltfDescription(
        str(path), "glTF", _describe_gltf(gltf), gltf.diagnostics.notices
    )


def _describe_gltf(gltf: Gltf) -> GltfContents:
    clip_names = unique_clip_names(gltf.animations)
    clips = [
        GltfClip(name, *animation.span, len(animation.tracks))
        for name, animation in zip(clip_names, gltf.animations, strict=True)
    ]
    bones = {bone: gltf.nodes[node].name or "" for bone, node in humanoid_bones(gltf)}
    return _collect_contents(gltf, clips, len(gltf.scenes), bones)


def _collect_contents(
    file: Any, clips: list[GltfClip], scene_count: int, bones: dict[str, str]
) -> GltfContents:
    """Count the contents of an open glTF or FBX file, and list its characters."""
    skeletons = find_characters(file) if file.nodes else ()
    return GltfContents(
        len(file.nodes),
        len(file.meshes),
        len(file.skins),
        len(clips),
        scene_count,
        [skeleton.path for skeleton in skeletons] if len(skeletons) > 1 else [],
        clips,
        bones,
        list(file.ignored_contents),
    )


def fbx_contents(path: Path | str) -> GltfContents:
    """Open an FBX file and return its contents, with takes as clips."""
    from animtool.formats.fbx.read import scene_take_names
    from animtool.formats.fbx.scene import open_fbx
    from animtool.formats.fbx.settings import TICKS_PER_SECOND

    scene = open_fbx(path)
    clips = []
    for name, take in zip(scene_take_names(scene), scene.takes, strict=True):
        start, end = (t / TICKS_PER_SECOND for t in (take.start_ticks, take.end_ticks))
        clips.append(GltfClip(name, start, end, len(take.curves())))
    return _collect_contents(scene, clips, 1, {})
