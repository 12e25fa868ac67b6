"""FBX reader: rigs, and takes as streams of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.clip.clip import Clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import distinct, nearest
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.formats.fbx.clip_keys import clip_of_fbx
from animtool.formats.fbx.rig import FbxRig, build_rig, scale_notice
from animtool.formats.fbx.sampling import (
    FbxFrames,
    FbxSampler,
    between_notices,
    frames_of,
    moves,
    take_stream,
)
from animtool.formats.fbx.scene import FbxScene, open_fbx
from animtool.formats.fbx.takes import AnimTake
from animtool.formats.gltf.characters import CharacterNodes, chosen
from animtool.motion.motion import MotionCurve
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_NAMED = 8


def read_fbx(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    prim_path: str | None = None,
    take: str | None = None,
) -> TakeStream:
    """Open a take of an FBX on the character it animates, meshes included.

    Time 0 is frame 0. The stream is sampled at the file's rate; between frames its
    curve is what the file's curves give.

    Args:
        path: A .fbx file, binary or ASCII.
        unit: What its lengths are in; None is what it says.
        up: Which of its axes points up; None is what it says.
        fps: Frames a second; None is the rate that it says.
        prim_path: The character, where the file has several.
        take: The take; None is the one that the file was saved with.

    Raises:
        FormatError: The file is broken, needs what is not read, or holds no such
            character or take (FBX001 to FBX015).
        OptionError: fps is no rate (SCN022).
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    scene = open_fbx(path, up)
    character, more = _character(scene, prim_path)
    fbx_rig = build_rig(
        scene, character, path.stem, None if unit is None else unit.meters
    )
    index, of_takes = _take(scene, fbx_rig, take)
    anim_take = None if index < 0 else scene.takes[index]
    moving = FbxSampler(scene, fbx_rig, anim_take)
    frames = frames_of(scene, anim_take, rate, moving.numbers)
    stream = take_stream(fbx_rig, moving, frames)
    stream.notices[:] = [*scene.file.notes.notices, *more, *fbx_rig.notices, *of_takes]
    stream.notices += between_notices(scene, fbx_rig, moving, frames)
    stream.notices += _left_out(scene, anim_take)
    names = take_names_of(scene)
    names = take_names_of(scene)
    if anim_take is not None:
        stream.curve = _keyed(stream, names[index], fbx_rig, moving, frames)
    stream.details = {
        "format": "FBX",
        "units": unit_name(fbx_rig.rig.meters_per_unit),
        "take": names[index] if index >= 0 else None,
        "takes": names,
    }
    return stream


def _keyed(
    stream: TakeStream,
    name: str,
    fbx_rig: FbxRig,
    moving: FbxSampler,
    frames: FbxFrames,
) -> MotionCurve:
    """Attach the clip with the file's keys to a stream."""

    def clip() -> Clip:
        clip_, notices = clip_of_fbx(name, fbx_rig, moving, frames)
        return replace(clip_, notices=tuple(notices))

    assert stream.curve is not None
    return KeyedCurve(stream.curve, clip, foreign=True)


def read_fbx_rig(path: Path, prim_path: str | None = None) -> Rig:
    """Return the rig of an FBX with meshes and shapes, as saved.

    Args:
        path: A .fbx file.
        prim_path: The character, as `read_fbx` has it.

    Raises:
        FormatError: As `read_fbx` does.
    """
    scene = open_fbx(path)
    character, notices = _character(scene, prim_path)
    fbx_rig = build_rig(scene, character, Path(path).stem)
    notices = [*scene.file.notes.notices, *notices, *fbx_rig.notices]
    notices += scale_notice(fbx_rig, str(path))
    return replace(fbx_rig.rig, notices=tuple(notices))


def take_names(path: Path) -> list[str]:
    """Return the names of an FBX's takes, in file order.

    Raises:
        FormatError: As `read_fbx` does.
    """
    return take_names_of(open_fbx(path))


def take_names_of(scene: FbxScene) -> list[str]:
    """Return distinct names of all takes."""
    plain = [
        "".join(c if c.isprintable() else "_" for c in one.name).strip()
        for one in scene.takes
    ]
    return distinct(name or f"take_{i + 1}" for i, name in enumerate(plain))


def _character(
    scene: FbxScene, prim_path: str | None
) -> tuple[CharacterNodes, list[Fault]]:
    return chosen(scene, prim_path, "FBX014", "FBX115")


def _left_out(scene: FbxScene, take: AnimTake | None) -> list[Fault]:
    """Return one notice about file contents that takes cannot hold."""
    names = list(scene.left_out)
    if take is not None and take.visible:
        names.append("animated visibility")
    if not names:
        return []
    message = f"ignored: {listed(names)}"
    return [Fault("FBX109", message, str(scene.path), severity=Severity.NOTE)]


def _take(
    scene: FbxScene, fbx_rig: FbxRig, take: str | None
) -> tuple[int, list[Fault]]:
    """Return the index of the take to read, -1 for none, and a note of others."""
    path, names = str(scene.path), take_names_of(scene)
    if take is not None:
        if take in names:
            return names.index(take), []
        message = f"has no take {take!r}"
        raise FormatError(Fault("FBX015", message, path, (), nearest(take, names)))
    moving = [i for i, one in enumerate(scene.takes) if moves(fbx_rig, one, scene)]
    if not moving:
        message = "has no animation of the character: it keeps its saved pose"
        return -1, [Fault("FBX116", message, path, severity=Severity.NOTE)]
    index = scene.default if scene.default in moving else moving[0]
    if len(moving) == 1:
        return index, []
    message = f"reading take {names[index]!r} of {counted(len(moving), 'take')}"
    hint = f"read another with {argument('source.take')}: {listed(names, MAX_NAMED)}"
    return index, [Fault("FBX122", message, path, (), hint, Severity.NOTE)]
