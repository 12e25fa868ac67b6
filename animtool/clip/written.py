"""Writes a take as a clip file of sparse keys with its rig file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.clip.clip import Clip, clip_text
from animtool.clip.keyed_curve import KeyedCurve, clip_of
from animtool.clip.keyed_take import fit_take_keys
from animtool.clip.reduction.tolerance import KEY_TOLERANCE
from animtool.core.clock import FrameSpan
from animtool.core.errors import Fault, listed, warning
from animtool.core.files.reading import path_from_folder
from animtool.core.units import parse_length
from animtool.core.writers import CLIP, output_stem
from animtool.motion.take import Take
from animtool.motion.take_files import Contents, TakeFiles, WriteOptions
from animtool.rig.skeleton import JointType, Rig
from animtool.rig.surfaces import StoredArrays, with_array_file
from animtool.rig.write import rig_text

MAX_LISTED_NAMES = 6


def build_clip_files(take: Take, path: Path, options: WriteOptions) -> TakeFiles:
    """Return the files of a take: a sparse clip, its rig, and the rig's arrays.

    ``tolerance`` of the options defaults to half a millimetre. An additive take has
    deltas.
    """
    skipped_content_warnings = _skipped_content_warnings(take)
    base_take = options.base
    if base_take is not None:
        take = replace(take, rig=with_identity_rest(take.rig))
    stem = output_stem(path)
    rig_path = options.rig_file or CLIP.files(path)[0]
    contents_by_path: dict[Path, Contents] = {}
    rig: Rig = take.rig
    if options.rig_file is None:
        arrays_path = path.with_name(f"{stem}.npz")
        arrays: StoredArrays
        rig, arrays = with_array_file(
            with_types_for_motion(take), arrays_path, copies_all=True
        )
        contents_by_path |= {arrays_path: arrays} if arrays else {}
        contents_by_path[rig_path] = [rig_text(rig).encode()]
    keyed_result = None
    clip = _unchanged_keys(take, options)
    if clip is None:
        tolerance = options.tolerance
        keyed_result = fit_take_keys(
            take,
            rig,
            stem,
            parse_length(KEY_TOLERANCE) if tolerance is None else tolerance,
            joint_tolerances=options.joint_tolerances,
            base=base_take,
        )
        clip = keyed_result.clip
    text = clip_text(clip, rig, path_from_folder(rig_path, path.parent))
    contents_by_path[path] = [text.encode()]
    notices = clip.notices if keyed_result is None else keyed_result.notices
    return TakeFiles(
        contents_by_path,
        FrameSpan(clip.first, clip.last, clip.fps),
        len(rig.joints),
        [*skipped_content_warnings, *notices],
        keyed_result,
    )


def _unchanged_keys(take: Take, options: WriteOptions) -> Clip | None:
    """Return the keys that a take was read with in another format, if still valid."""
    has_tolerance = options.tolerance is not None or options.joint_tolerances
    is_foreign = isinstance(take.curve, KeyedCurve) and take.curve.is_foreign
    if not is_foreign or has_tolerance or options.base is not None:
        return None
    clip_of_take: Clip | None = clip_of(take)
    return clip_of_take


def _skipped_content_warnings(take: Take) -> list[Fault]:
    """Return a warning about content that a clip cannot store."""
    skipped_names = [*(track.path for track in take.tracks), *take.motion.points]
    if not skipped_names:
        return []
    message = f"a clip cannot hold {listed(skipped_names, MAX_LISTED_NAMES)}: skipped"
    hint = "write USD too, which can hold them"
    return [warning("CLIP119", message, hint)]


def with_identity_rest(rig: Rig) -> Rig:
    """Return a rig with an identity rest pose, for an additive take."""
    joints = tuple(
        replace(joint, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0, 1.0))
        for joint in rig.joints
    )
    return replace(rig, joints=joints, bind={})


def with_types_for_motion(take: Take) -> Rig:
    """Return a take's rig with joint types that allow its motion.

    A joint whose translation moves or differs from rest becomes free, the others balls.
    A rig with controls, pins, slides or fixed joints keeps its types.
    """
    free_types = {JointType.FREE, JointType.BALL}
    if take.rig.controls or any(j.type not in free_types for j in take.rig.joints):
        return take.rig
    channel = take.motion.translations
    is_translated = (channel.rest != take.rig.rest_translations).any(axis=1)
    is_translated[channel.animated] = True
    typed_joints = tuple(
        replace(joint, type=JointType.FREE if is_moving else JointType.BALL)
        if joint.type is JointType.FREE
        else joint
        for joint, is_moving in zip(
            take.rig.joints, is_translated.tolist(), strict=True
        )
    )
    return replace(take.rig, joints=typed_joints)
