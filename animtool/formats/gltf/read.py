"""glTF reader: rigs, and animations as streams of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.clip.clip import Clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import nearest
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.formats.gltf.animations import Animation, TargetPath
from animtool.formats.gltf.characters import chosen
from animtool.formats.gltf.document import Gltf, left_out_text, open_gltf
from animtool.formats.gltf.keys import clip_of_gltf
from animtool.formats.gltf.rig import GltfRig, build_rig, scale_notice
from animtool.formats.gltf.sampling import (
    GltfSampler,
    NativeKeys,
    clip_stream,
    moves,
    sampler,
)
from animtool.formats.gltf.timing import GltfFrames, distinct_clip_names, frames_of
from animtool.motion.motion import MotionCurve
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_NAMED = 8


def read_gltf(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    prim_path: str | None = None,
    take: str | None = None,
) -> TakeStream:
    """Open an animation of a glTF on the character it moves, meshes included.

    Time 0 is frame 0. Outside of its keys a track holds its first or last value.

    Args:
        path: A .gltf, .glb or .vrm file.
        unit: What its lengths are in; None is metres, as the format says.
        up: Which of its axes points up; None is Y, likewise.
        fps: Frames a second; None is the first usual rate that has all keys on frames.
        prim_path: The character, where the file has several.
        take: The clip; None is the first.

    Raises:
        FormatError: The file is broken, needs an extension that is not read, or holds
            no such character or clip (GLT001 to GLT015).
        OptionError: fps is no rate (SCN022).
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    gltf = open_gltf(path)
    character, notices = chosen(gltf, prim_path)
    meters = LengthUnit.M if unit is None else unit
    gltf_rig = build_rig(gltf, character, path.stem, meters.meters, up or UpAxis.Y)
    index, more = _clip(gltf, gltf_rig, take)
    animation = None if index < 0 else gltf.animations[index]
    notices = [*gltf.notes.notices, *notices, *gltf_rig.notices, *more]
    notices += _left_out(gltf, animation)
    moving = sampler(gltf, gltf_rig, animation)
    frames = frames_of(animation, rate, str(path), moving.numbers)
    notices += frames.notices
    names = distinct_clip_names(gltf.animations)
    stream = clip_stream(gltf_rig, moving, frames)
    stream.notices[:] = notices
    if index >= 0:
        name = distinct_clip_names(gltf.animations)[index]
        last = gltf.animations[index].span[1]
        stream.curve = _keyed(stream, name, gltf_rig, moving, frames, last)
    stream.details = {
        "format": "glTF",
        "units": unit_name(meters.meters),
        "take": names[index] if index >= 0 else None,
        "takes": names,
    }
    return stream


def read_gltf_rig(path: Path, prim_path: str | None = None) -> Rig:
    """Return the rig of a glTF with meshes and shapes.

    Its notices say what a rig has no place for.

    Args:
        path: A .gltf, .glb or .vrm file.
        prim_path: The character, as `read_gltf` has it.

    Raises:
        FormatError: As `read_gltf` does.
    """
    gltf = open_gltf(path)
    character, notices = chosen(gltf, prim_path)
    gltf_rig = build_rig(gltf, character, path.stem)
    notices = [*gltf.notes.notices, *notices, *gltf_rig.notices]
    notices += scale_notice(gltf_rig, str(path))
    return replace(gltf_rig.rig, notices=tuple(notices))


def take_names(path: Path) -> list[str]:
    """Return the names of a glTF's animations, in file order.

    Raises:
        FormatError: As `read_gltf` does.
    """
    return distinct_clip_names(open_gltf(path).animations)


def _keyed(
    stream: TakeStream,
    name: str,
    gltf_rig: GltfRig,
    moving: GltfSampler,
    frames: GltfFrames,
    last: float,
) -> MotionCurve:
    """Attach the clip with the file's keys to a stream.

    last: when the last of them is [s].
    """

    def clip() -> Clip:
        clip_, notices = clip_of_gltf(name, gltf_rig, moving, frames)
        return replace(clip_, notices=tuple(notices))

    assert stream.curve is not None
    native = NativeKeys(moving, frames, last)
    return KeyedCurve(stream.curve, clip, foreign=True, native=native)


def _clip(gltf: Gltf, gltf_rig: GltfRig, take: str | None) -> tuple[int, list[Fault]]:
    """Return the index of the animation to read, -1 for none, and a note."""
    path, names = str(gltf.path), distinct_clip_names(gltf.animations)
    if take is not None:
        if take in names:
            return names.index(take), []
        message = f"has no clip {take!r}"
        raise FormatError(Fault("GLT015", message, path, (), nearest(take, names)))
    if not names:
        message = "has no animation: the rig is read at rest"
        return -1, [Fault("GLT116", message, path, severity=Severity.NOTE)]
    index = next(
        (i for i, one in enumerate(gltf.animations) if moves(gltf_rig, one)), 0
    )
    if len(names) == 1:
        return index, []
    message = f"reading clip {names[index]!r} of {counted(len(names), 'clip')}"
    hint = f"read another with {argument('source.take')}: {listed(names, MAX_NAMED)}"
    return index, [Fault("GLT121", message, path, (), hint, Severity.NOTE)]


def _left_out(gltf: Gltf, animation: Animation | None) -> list[Fault]:
    """Return one notice about file contents that takes cannot hold."""
    names = [left_out_text(gltf)] if gltf.left_out else []
    tracks = () if animation is None else animation.tracks
    if any(track.path is TargetPath.VISIBLE for track in tracks):
        names.append("animated visibility")
    nodes = enumerate(gltf.nodes)
    hidden = [node.name or f"node_{i}" for i, node in nodes if not node.visible]
    if hidden:
        names.append(f"that nodes are hidden: {listed(hidden, MAX_NAMED)}")
    if not names:
        return []
    message = f"ignored: {', '.join(names)}"
    return [Fault("GLT108", message, str(gltf.path), severity=Severity.NOTE)]
