"""Contents of an FBX file: nodes, skins, characters and takes."""

from __future__ import annotations

from pathlib import Path

from animtool.formats.characters.choice import find_characters
from animtool.formats.fbx.read import scene_take_names
from animtool.formats.fbx.scene import open_fbx
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.report.describe_gltf import GltfClip, GltfContents


def fbx_contents(path: Path | str) -> GltfContents:
    """Return the contents of an FBX file."""
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
        [take.path for take in skeletons] if len(skeletons) > 1 else [],
        clips,
        {},
        list(scene.ignored_contents),
    )
