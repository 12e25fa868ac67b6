"""Reads rigs and animations from glTF files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.core.errors import Fault, Severity, listed
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.characters.choice import choose_character
from animtool.formats.characters.stream import (
    TakeMessages,
    choose_take,
    default_take,
    finish_stream,
)
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import Animation
from animtool.formats.gltf.clip_keys import build_clip
from animtool.formats.gltf.document import Gltf, open_gltf
from animtool.formats.gltf.rig import build_rig, scale_notice
from animtool.formats.gltf.sampling import (
    NativeKeys,
    animates_rig,
    build_sampler,
    build_stream,
    count_animated_joints,
)
from animtool.formats.gltf.timing import find_frame_range, unique_clip_names
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_LISTED_CONTENTS = 8
# Codes for an unknown character, and for one of several.
CHARACTER_FAULT_CODES = "GLT014", "GLT109"
TAKE_MESSAGES = TakeMessages(
    "clip",
    "has no animation: the rig is read at rest",
    unknown_code="GLT015",
    no_take_code="GLT116",
    skipped_code="GLT121",
)


def read_gltf(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    prim_path: str | None = None,
    take: str | None = None,
) -> TakeStream:
    """Open an animation of a glTF file and its character, including meshes.

    Time 0 is frame 0. Outside the keys a track keeps the first or last value.

    Args:
        path: A .gltf, .glb or .vrm file.
        unit: Unit of the lengths; None is metres, as glTF specifies.
        up: The up axis; None is Y, as glTF specifies.
        fps: Frames per second; None is the first common rate with all keys on frames.
        prim_path: The character, if the file has several.
        take: Name of the animation; None is the first that animates the joints.
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    gltf = open_gltf(path)
    character, notices = choose_character(gltf, prim_path, *CHARACTER_FAULT_CODES)
    length_unit = LengthUnit.M if unit is None else unit
    gltf_rig = build_rig(gltf, character, path.stem, length_unit.meters, up or UpAxis.Y)
    names = unique_clip_names(gltf.animations)
    joint_counts = {
        i: count_animated_joints(gltf_rig, animation)
        for i, animation in enumerate(gltf.animations)
        if animates_rig(gltf_rig, animation)
    }
    default_index = default_take(joint_counts, next(iter(joint_counts), 0))
    index, take_notices = choose_take(
        TAKE_MESSAGES, str(path), names, take, range(len(names)), default_index
    )
    animation = None if index < 0 else gltf.animations[index]
    notices = [*gltf.diagnostics.notices, *notices, *gltf_rig.notices, *take_notices]
    notices += _ignored_contents_notice(gltf, animation)
    sampler = build_sampler(gltf, gltf_rig, animation)
    frames = find_frame_range(animation, rate, str(path), sampler.values_per_frame)
    stream = build_stream(gltf_rig, sampler, frames)
    stream.notices[:] = [*notices, *frames.notices]
    last_time = 0.0 if animation is None else animation.span[1]
    return finish_stream(
        stream,
        "glTF",
        names,
        index,
        lambda name: build_clip(name, gltf_rig, sampler, frames),
        NativeKeys(sampler, frames, last_time),
    )


def read_gltf_rig(path: Path, prim_path: str | None = None) -> Rig:
    """Return the rig of a glTF with meshes and shapes.

    The notices of the rig report what a rig cannot store.

    Args:
        path: A .gltf, .glb or .vrm file.
        prim_path: The character, as in `read_gltf`.
    """
    gltf = open_gltf(path)
    character, notices = choose_character(gltf, prim_path, *CHARACTER_FAULT_CODES)
    gltf_rig = build_rig(gltf, character, path.stem)
    notices = [*gltf.diagnostics.notices, *notices, *gltf_rig.notices]
    notices += scale_notice(gltf_rig, str(path))
    return replace(gltf_rig.rig, notices=tuple(notices))


def take_names(path: Path) -> list[str]:
    """Return the names of a glTF's animations, in file order."""
    return unique_clip_names(open_gltf(path).animations)


def _ignored_contents_notice(gltf: Gltf, animation: Animation | None) -> list[Fault]:
    """Return a note about contents that takes cannot store."""
    contents = [listed(gltf.ignored_contents)] if gltf.ignored_contents else []
    tracks = () if animation is None else animation.tracks
    if any(track.path is TargetPath.VISIBLE for track in tracks):
        contents.append("animated visibility")
    nodes = enumerate(gltf.nodes)
    hidden_names = [
        node.name or f"node_{i}" for i, node in nodes if not node.is_visible
    ]
    if hidden_names:
        contents.append(
            "the visibility of hidden nodes "
            f"({listed(hidden_names, MAX_LISTED_CONTENTS)})"
        )
    if not contents:
        return []
    message = f"the take leaves out {', '.join(contents)}"
    return [Fault("GLT108", message, str(gltf.path), severity=Severity.NOTE)]
