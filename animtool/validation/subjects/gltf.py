"""glTF files as subjects: reader faults, and one subject per clip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError, Fault, Severity
from animtool.core.files.reading import record_input
from animtool.core.rules import Kind
from animtool.formats.characters.choice import find_characters
from animtool.formats.gltf.animations import Animation
from animtool.formats.gltf.clip_keys import key_times_in_frames
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.document import open_gltf as open_document
from animtool.formats.gltf.rig import GltfRig, build_rig
from animtool.formats.gltf.sampling import (
    GltfSampler,
    animates_rig,
    build_sampler,
    build_stream,
)
from animtool.formats.gltf.timing import (
    FRAME_TOLERANCE,
    GltfFrames,
    find_frame_range,
    key_times,
)
from animtool.motion.take import Take
from animtool.rig.kinematics import bind_matrices, rest_world
from animtool.rig.parts import Skin
from animtool.rig.skeleton import Rig
from animtool.validation.motion.subject import MotionSubject, fault_factory_at
from animtool.validation.subjects.subject import CheckedFile

# Keys with this spacing are samples [frame].
MAX_SPACING_ERROR = 0.25


def open_gltf(path: Path) -> CheckedFile:
    """Read a glTF file; motion rules check each clip of each character."""
    record_input(path)
    gltf = open_document(path)
    checked_file = check_characters(Kind.GLTF, gltf, build_rig, _clip_subjects)
    checked_file.faults[:0] = gltf.diagnostics.notices
    return checked_file


def check_characters(
    kind: Kind,
    file: Any,
    build_rig: Callable[..., Any],
    open_takes: Callable[..., list[MotionSubject]],
) -> CheckedFile:
    """Build the rigs of an open glTF or FBX file, and open the takes of each.

    ``open_takes`` gets the file, a built rig, and the list of faults to extend.
    """
    checked_file = CheckedFile(kind)
    for character in find_characters(file) if file.nodes else ():
        built_rig = build_rig(file, character, file.path.stem)
        checked_file.faults += built_rig.notices
        takes = open_takes(file, built_rig, checked_file.faults)
        checked_file.takes += tuple(takes)
    return checked_file


def _clip_subjects(
    gltf: Gltf, built_rig: GltfRig, faults: list[Fault]
) -> list[MotionSubject]:
    subjects = []
    for animation in gltf.animations:
        if not animates_rig(built_rig, animation):
            continue
        sampler = build_sampler(gltf, built_rig, animation)
        try:
            frames = find_frame_range(
                animation, None, str(gltf.path), sampler.values_per_frame
            )
        except AnimtoolError as error:
            faults += error.faults
            continue
        faults += (n for n in frames.notices if n.severity is Severity.WARNING)
        take = build_stream(built_rig, sampler, frames).collect()
        subject = clip_subject(gltf.path, built_rig.rig, take, animation.pointer)
        subjects.append(_trim_to_keys(subject, sampler, animation, frames))
    return subjects


def _trim_to_keys(
    subject: MotionSubject,
    sampler: GltfSampler,
    animation: Animation,
    frames: GltfFrames,
) -> MotionSubject:
    """Return a clip without the frames before its first key.

    A clip with roughly one key per frame is sampled at its keys.
    """
    take, clock = subject.take, subject.take.clock
    key_seconds = key_times(animation)
    key_codes = key_times_in_frames(key_seconds, frames)
    rounded_codes = np.round(key_codes)
    is_near = np.abs(key_codes - rounded_codes) <= FRAME_TOLERANCE
    key_codes = np.where(is_near, rounded_codes, key_codes)
    frame_range = (float(min(clock.start, frames.start)), float(clock.times[-1]))
    if (
        len(key_codes) > 1
        and abs(np.median(np.diff(key_codes)) - 1.0) <= MAX_SPACING_ERROR
    ):
        if len(key_codes) == len(clock.times) and (key_codes == clock.times).all():
            return subject
        motion = sampler.sample(frames.seconds(key_codes))
    else:
        first_frame = int(np.searchsorted(clock.times, key_codes[0]))
        if not 0 < first_frame < clock.count:
            return subject
        key_codes = clock.times[first_frame:]
        motion = take.motion.select(slice(first_frame, None))
    clock = replace(clock, start=Fraction(key_codes[0]), count=len(key_codes))
    take = replace(take, motion=motion, clock=clock, curve=None)
    return replace(subject, take=take, time_codes=key_codes, frame_range=frame_range)


def clip_subject(path: Path, rig: Rig, take: Take, where: str) -> MotionSubject:
    """Return a clip for motion rules, with faults located at ``where`` in the file."""
    skins = [
        mesh.skin for mesh in rig.meshes if mesh.skin and len(mesh.skin.joints) > 1
    ]
    return MotionSubject(
        replace(take, curve=None),
        fault_factory_at(path, where),
        influencing_joints=_influencing_joints(rig, skins) if skins else None,
        bind_positions=_bind_positions(rig, skins),
    )


def _influencing_joints(rig: Rig, skins: Sequence[Skin]) -> frozenset[str]:
    """Return the joints that influence points, and the joints that no skin contains.

    Ancestors of joints that influence points influence them, too.
    """
    influencing_names = set(rig.names) - {
        name for skin in skins for name in skin.joints
    }
    for skin in skins:
        used_skin_joints = np.unique(skin.indices.load()[skin.weights.load() > 0])
        for joint in used_skin_joints.astype(int).tolist():
            joints = rig.upwards(rig.index(skin.joints[joint]))
            influencing_names.update(rig.names[ancestor] for ancestor in joints)
    return frozenset(influencing_names)


def _bind_positions(rig: Rig, skins: Sequence[Skin]) -> FloatArray | None:
    """Return the bind positions of the joints ``(J, 3)`` [m].

    A glTF does not state the mesh's position at bind time: the topmost bound joint is
    assumed to be at rest. Unbound joints are at rest; None if no joint is bound.
    """
    joints = sorted({rig.index(name) for skin in skins for name in skin.joints})
    if not joints:
        return None
    rest_transforms, bind_transforms = rest_world(rig), bind_matrices(rig)
    rest_matrix = np.eye(4)
    rest_matrix[:3, :3] = rest_transforms.linear[0, joints[0]]
    rest_matrix[:3, 3] = rest_transforms.positions[0, joints[0]]
    rest_from_bind = rest_matrix @ np.linalg.inv(bind_transforms[joints[0]])
    bind_positions = (rest_from_bind @ bind_transforms[joints])[:, :3, 3]
    if np.ptp(bind_positions, axis=0).max() == 0.0:
        # A skin without bind matrices.
        return None
    positions = rest_transforms.positions[0].copy()
    positions[joints] = bind_positions
    return np.asarray(positions)
