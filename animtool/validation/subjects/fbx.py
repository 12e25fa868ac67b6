"""FBX files as subjects: reader faults, and one subject per take."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import AnimtoolError, Fault
from animtool.core.files.reading import record_input
from animtool.core.rules import Kind
from animtool.formats.characters.choice import find_characters
from animtool.formats.fbx.rig import FbxRig, build_rig
from animtool.formats.fbx.sampling import (
    FbxSampler,
    animates_rig,
    build_stream,
    find_frame_range,
)
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.scene import open_fbx as open_scene
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.subjects.gltf import clip_subject
from animtool.validation.subjects.subject import CheckedFile


def open_fbx(path: Path) -> CheckedFile:
    """Read an FBX file; motion rules check each take of each character."""
    record_input(path)
    scene = open_scene(path)
    faults: list[Fault] = []
    take_subjects: list[MotionSubject] = []
    if scene.nodes:
        for character in find_characters(scene):
            built_rig = build_rig(scene, character, scene.path.stem)
            faults += built_rig.notices
            take_subjects += _take_subjects(scene, built_rig, faults)
    notices = [*scene.file.notes.notices, *faults]
    return CheckedFile(Kind.FBX, notices, takes=tuple(take_subjects))


def _take_subjects(
    scene: FbxScene, built_rig: FbxRig, faults: list[Fault]
) -> list[MotionSubject]:
    subjects = []
    for take in scene.takes:
        if not animates_rig(built_rig, take, scene):
            continue
        sampler = FbxSampler(scene, built_rig, take)
        try:
            frames = find_frame_range(scene, take, None, sampler.values_per_frame)
        except AnimtoolError as error:
            faults += error.faults
            continue
        take_data = build_stream(built_rig, sampler, frames).collect()
        subjects.append(
            clip_subject(scene.path, built_rig.rig, take_data, take.location)
        )
    return subjects
