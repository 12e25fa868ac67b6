"""FBX files as subjects: reader faults, and one subject per take."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import AnimtoolError, Fault
from animtool.core.files.reading import record_input
from animtool.core.rules import Kind
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
from animtool.validation.subjects.gltf import check_characters, clip_subject
from animtool.validation.subjects.subject import CheckedFile


def open_fbx(path: Path) -> CheckedFile:
    """Read an FBX file; motion rules check each take of each character."""
    record_input(path)
    scene = open_scene(path)
    checked_file = check_characters(Kind.FBX, scene, build_rig, _take_subjects)
    checked_file.faults[:0] = scene.file.diagnostics.notices
    return checked_file


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
