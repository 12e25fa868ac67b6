"""Reads FBX files: rigs, and takes as streams of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.core.errors import Fault, Severity, listed
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.characters.choice import choose_character
from animtool.formats.characters.names import unique_take_names
from animtool.formats.characters.stream import (
    TakeMessages,
    choose_take,
    default_take,
    finish_stream,
)
from animtool.formats.fbx.clip_keys import build_clip
from animtool.formats.fbx.rig import build_rig, scale_notice
from animtool.formats.fbx.sampling import (
    FbxSampler,
    animates_rig,
    build_stream,
    count_animated_joints,
    find_frame_range,
    keys_outside_notice,
    off_frame_keys_notice,
)
from animtool.formats.fbx.scene import FbxScene, open_fbx
from animtool.formats.fbx.takes import AnimTake
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

# Codes for an unknown character, and for one of several.
CHARACTER_FAULT_CODES = "FBX014", "FBX115"
TAKE_MESSAGES = TakeMessages(
    "take",
    "has no animation of the character: it keeps its saved pose",
    unknown_code="FBX015",
    no_take_code="FBX116",
    skipped_code="FBX122",
)


def read_fbx(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    prim_path: str | None = None,
    take: str | None = None,
) -> TakeStream:
    """Open a take of an FBX file and its character, including meshes.

    Time 0 is frame 0. The stream is sampled at the file's rate; at times between
    frames, the file's curves are evaluated.

    Args:
        path: A .fbx file, binary or ASCII.
        unit: Unit of the lengths; None is the stated unit.
        up: The up axis; None is the stated axis.
        fps: Frames per second; None is the stated rate.
        prim_path: The character, if the file has several.
        take: Name of the take; None is the take that was current when the file was
            saved, or the first that animates the joints if that one does not.
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    scene = open_fbx(path, up)
    character, notices = choose_character(scene, prim_path, *CHARACTER_FAULT_CODES)
    fbx_rig = build_rig(
        scene, character, path.stem, None if unit is None else unit.meters
    )
    names = scene_take_names(scene)
    candidates = [
        i for i, c in enumerate(scene.takes) if animates_rig(fbx_rig, c, scene)
    ]
    joint_counts = {}
    if take is None and len(candidates) > 1:
        joint_counts = {
            i: count_animated_joints(fbx_rig, scene.takes[i], scene) for i in candidates
        }
    default_index = default_take(joint_counts, scene.default_take)
    index, take_notes = choose_take(
        TAKE_MESSAGES, str(path), names, take, candidates, default_index
    )
    anim_take = None if index < 0 else scene.takes[index]
    sampler = FbxSampler(scene, fbx_rig, anim_take)
    clock = find_frame_range(scene, anim_take, rate, sampler.values_per_frame)
    stream = build_stream(fbx_rig, sampler, clock)
    stream.notices[:] = [
        *scene.file.diagnostics.notices,
        *notices,
        *fbx_rig.notices,
        *take_notes,
    ]
    stream.notices += off_frame_keys_notice(scene, fbx_rig, sampler, clock)
    stream.notices += keys_outside_notice(scene, anim_take, clock)
    stream.notices += _ignored_contents_notice(scene, anim_take)
    return finish_stream(
        stream,
        "FBX",
        names,
        index,
        lambda name: build_clip(name, fbx_rig, sampler, clock),
    )


def read_fbx_rig(path: Path, prim_path: str | None = None) -> Rig:
    """Return the rig of an FBX with meshes and shapes, in its saved pose.

    Args:
        path: A .fbx file.
        prim_path: The character, as in `read_fbx`.
    """
    scene = open_fbx(path)
    character, notices = choose_character(scene, prim_path, *CHARACTER_FAULT_CODES)
    fbx_rig = build_rig(scene, character, Path(path).stem)
    notices = [*scene.file.diagnostics.notices, *notices, *fbx_rig.notices]
    notices += scale_notice(fbx_rig, str(path))
    return replace(fbx_rig.rig, notices=tuple(notices))


def take_names(path: Path) -> list[str]:
    """Return the names of an FBX's takes, in file order."""
    return scene_take_names(open_fbx(path))


def scene_take_names(scene: FbxScene) -> list[str]:
    """Return unique names of all takes of a scene."""
    return unique_take_names((take.name for take in scene.takes), "take")


def _ignored_contents_notice(scene: FbxScene, take: AnimTake | None) -> list[Fault]:
    """Return a notice about file contents that are ignored."""
    names = list(scene.ignored_contents)
    if take is not None and take.has_animated_visibility:
        names.append("animated visibility")
    if not names:
        return []
    message = f"ignored: {listed(names)}"
    return [Fault("FBX109", message, str(scene.path), severity=Severity.NOTE)]
