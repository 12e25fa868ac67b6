"""glTF reader: rigs, and animations as streams of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.core.errors import Fault, Severity, listed
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.characters.choice import choose_character
from animtool.formats.characters.stream import TakeMessages, choose_take, finish_stream
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import Animation
from animtool.formats.gltf.document import Gltf, left_out_text, open_gltf
from animtool.formats.gltf.keys import clip_of_gltf
from animtool.formats.gltf.rig import build_rig, scale_notice
from animtool.formats.gltf.sampling import (
    NativeKeys,
    animates_rig,
    clip_stream,
    sampler_of,
)
from animtool.formats.gltf.timing import distinct_clip_names, frames_of
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_LISTED_CONTENTS = 8
# Codes for an unknown character, and for one of several.
CHARACTER_CODES = "GLT014", "GLT109"
MESSAGES = TakeMessages(
    "clip",
    "has no animation: the rig is read at rest",
    unknown="GLT015",
    none="GLT116",
    several="GLT121",
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
    """Open an animation of a glTF on the character it animates, meshes included.

    Time 0 is frame 0. Outside its keys a track keeps its first or last value.

    Args:
        path: A .gltf, .glb or .vrm file.
        unit: Unit of its lengths; None is metres, as glTF specifies.
        up: Its up axis; None is Y, as glTF specifies.
        fps: Frames per second; None is the first common rate with all keys on frames.
        prim_path: The character, if the file has several.
        take: Name of the animation; None is the first.
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    gltf = open_gltf(path)
    character, notices = choose_character(gltf, prim_path, *CHARACTER_CODES)
    meters = LengthUnit.M if unit is None else unit
    gltf_rig = build_rig(gltf, character, path.stem, meters.meters, up or UpAxis.Y)
    names = distinct_clip_names(gltf.animations)
    animated = (
        i
        for i, animation_ in enumerate(gltf.animations)
        if animates_rig(gltf_rig, animation_)
    )
    candidates = range(len(names))
    index, notes = choose_take(
        MESSAGES, str(path), names, take, candidates, next(animated, 0)
    )
    animation = None if index < 0 else gltf.animations[index]
    notices = [*gltf.notes.notices, *notices, *gltf_rig.notices, *notes]
    notices += _unread_notice(gltf, animation)
    sampler = sampler_of(gltf, gltf_rig, animation)
    frames = frames_of(animation, rate, str(path), sampler.numbers)
    stream = clip_stream(gltf_rig, sampler, frames)
    stream.notices[:] = [*notices, *frames.notices]
    last_time = 0.0 if animation is None else animation.span[1]
    return finish_stream(
        stream,
        "glTF",
        names,
        index,
        lambda name: clip_of_gltf(name, gltf_rig, sampler, frames),
        NativeKeys(sampler, frames, last_time),
    )


def read_gltf_rig(path: Path, prim_path: str | None = None) -> Rig:
    """Return the rig of a glTF with meshes and shapes.

    Its notices report what a rig cannot store.

    Args:
        path: A .gltf, .glb or .vrm file.
        prim_path: The character, as in `read_gltf`.
    """
    gltf = open_gltf(path)
    character, notices = choose_character(gltf, prim_path, *CHARACTER_CODES)
    gltf_rig = build_rig(gltf, character, path.stem)
    notices = [*gltf.notes.notices, *notices, *gltf_rig.notices]
    notices += scale_notice(gltf_rig, str(path))
    return replace(gltf_rig.rig, notices=tuple(notices))


def take_names(path: Path) -> list[str]:
    """Return the names of a glTF's animations, in file order."""
    return distinct_clip_names(open_gltf(path).animations)


def _unread_notice(gltf: Gltf, animation: Animation | None) -> list[Fault]:
    """Return one notice about file contents that takes cannot store."""
    names = [left_out_text(gltf)] if gltf.left_out else []
    tracks = () if animation is None else animation.tracks
    if any(track.path is TargetPath.VISIBLE for track in tracks):
        names.append("animated visibility")
    nodes = enumerate(gltf.nodes)
    hidden_names = [node.name or f"node_{i}" for i, node in nodes if not node.visible]
    if hidden_names:
        names.append(
            f"that nodes are hidden: {listed(hidden_names, MAX_LISTED_CONTENTS)}"
        )
    if not names:
        return []
    message = f"ignored: {', '.join(names)}"
    return [Fault("GLT108", message, str(gltf.path), severity=Severity.NOTE)]
