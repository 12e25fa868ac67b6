"""glTF files as their rules see them: what is wrong with them, and a take a clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.core.errors import AnimtoolError, Fault
from animtool.core.files.reading import note_input
from animtool.core.rules import Kind
from animtool.formats.gltf.characters import Character, characters
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.document import open_gltf as open_document
from animtool.formats.gltf.rig import GltfRig, build_rig
from animtool.formats.gltf.sampling import clip_stream, moves, sampler
from animtool.formats.gltf.timing import frames_of
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.subjects.subject import CheckedFile


def open_gltf(path: Path) -> CheckedFile:
    """Return what is wrong with a glTF, and a take of each clip of each character."""
    note_input(path)
    gltf = open_document(path)
    faults: list[Fault] = []
    takes: list[MotionSubject] = []
    if gltf.nodes:
        for character in characters(gltf):
            made = _made(gltf, character, faults)
            takes += _takes(gltf, made, faults)
    return CheckedFile(Kind.GLTF, [*gltf.notes.notices, *faults], takes=tuple(takes))


def _made(gltf: Gltf, character: Character, faults: list[Fault]) -> GltfRig:
    made = build_rig(gltf, character, gltf.path.stem)
    faults += made.notices
    return made


def _takes(gltf: Gltf, made: GltfRig, faults: list[Fault]) -> list[MotionSubject]:
    found = []
    for animation in gltf.animations:
        if not moves(made, animation):
            continue
        moving = sampler(gltf, made, animation)
        try:
            frames = frames_of(animation, None, str(gltf.path), moving.numbers)
        except AnimtoolError as error:
            faults += error.faults
            continue
        take = clip_stream(made, moving, frames).collect()
        found.append(clip_subject(gltf.path, made.rig, take, animation.where))
    return found


def clip_subject(path: Path, rig: Rig, take: Take, where: str) -> MotionSubject:
    """Return a clip as the motion rules see it; its faults are at its place."""

    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del joint, frame
        return Fault(code, message, str(path), (), hint, where=where)

    skinned = {name for mesh in rig.meshes if mesh.skin for name in mesh.skin.joints}
    influencing: set[str] = set()
    for name in skinned:
        influencing.update(rig.names[j] for j in rig.upwards(rig.index(name)))
    return MotionSubject(
        replace(take, curve=None),
        fault_at,
        influencing=frozenset(influencing) if skinned else None,
    )
