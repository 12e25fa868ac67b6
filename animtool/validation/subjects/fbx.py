"""FBX files as their rules see them: what is wrong with them, and a take each."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import AnimtoolError, Fault
from animtool.core.files.reading import note_input
from animtool.core.rules import Kind
from animtool.formats.fbx.rig import FbxRig, build_rig
from animtool.formats.fbx.sampling import FbxSampler, frames_of, moves, take_stream
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.scene import open_fbx as open_scene
from animtool.formats.gltf.characters import characters
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.subjects.gltf import clip_subject
from animtool.validation.subjects.subject import CheckedFile


def open_fbx(path: Path) -> CheckedFile:
    """Return what is wrong with an FBX, and a take of each take of each character."""
    note_input(path)
    scene = open_scene(path)
    faults: list[Fault] = []
    takes: list[MotionSubject] = []
    if scene.nodes:
        for character in characters(scene):
            made = build_rig(scene, character, scene.path.stem)
            faults += made.notices
            takes += _takes(scene, made, faults)
    notices = [*scene.file.notes.notices, *faults]
    return CheckedFile(Kind.FBX, notices, takes=tuple(takes))


def _takes(scene: FbxScene, made: FbxRig, faults: list[Fault]) -> list[MotionSubject]:
    found = []
    for take in scene.takes:
        if not moves(made, take, scene):
            continue
        moving = FbxSampler(scene, made, take)
        try:
            frames = frames_of(scene, take, None, moving.numbers)
        except AnimtoolError as error:
            faults += error.faults
            continue
        whole = take_stream(made, moving, frames).collect()
        found.append(clip_subject(scene.path, made.rig, whole, take.where))
    return found
