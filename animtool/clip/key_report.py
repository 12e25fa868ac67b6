"""Errors of a keyed take by channel, and notes on motion that a rig cannot produce."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from animtool.clip.channels import ClipUnits
from animtool.clip.clip import Clip
from animtool.clip.control_keys import keys_of_control_channel
from animtool.clip.coordinates import JointMotion
from animtool.clip.reduction.tracks import KeyTrack
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.control_inverse import SolvedControls
from animtool.rig.joints import KEYED_PARTS, split_part
from animtool.rig.skeleton import JointType, Rig

MAX_LISTED_NAMES = 6


@dataclass(frozen=True, slots=True)
class ChannelDeviation:
    """Largest deviation of a clip's channel from the take."""

    target: str  # target of the channel
    error: float  # the largest error, in ``unit``
    # Unit in the clip's file: ``deg``, ``rad`` or a length; None if it has no unit.
    unit: str | None
    frame: float  # time code of the largest error
    json_keys: ClassVar[str] = "target error unit frame"


def channel_deviations(
    clip: Clip,
    rig: Rig,
    take: Take,
    keyed_motion: Motion,
    controls: Mapping[str, FloatArray],
) -> tuple[ChannelDeviation, ...]:
    """Return the largest error of each channel of a clip; controls are ``(F,)``."""
    units = ClipUnits.of_rig(rig)
    control_keys = {}
    if keyed_motion.controls is not None:
        control_keys = keys_of_control_channel(rig.controls, keyed_motion.controls)
    motions = take.motion, keyed_motion
    shape_index_by_name = {shape.name: i for i, shape in enumerate(rig.shapes)}

    def target_errors(target: str) -> tuple[FloatArray, str | None]:
        """Return the error of a target in every frame, and its unit."""
        group, _, name = target.partition("/")
        if group == "control":
            return np.abs(control_keys[name] - controls[name]), None
        if group == "shape":
            weights = [motion.weights for motion in motions]
            return _value_errors(weights, shape_index_by_name[name], 0.0), None
        joint, part = split_part(name, KEYED_PARTS)
        joint_indices = np.array([rig.index(joint)])
        if part in {"angle", "rotation", "local_rotation"}:
            rotations = [
                motion.rotations.gather(joint_indices)[:, 0] for motion in motions
            ]
            return so3.angle_between(*rotations) / units.angle, units.angle_name
        if part == "scale":
            scales = [motion.scales for motion in motions]
            return _value_errors(scales, rig.index(joint), 1.0), None
        positions = [
            motion.translations.gather(joint_indices)[:, 0] for motion in motions
        ]
        distances = np.linalg.norm(positions[0] - positions[1], axis=1)
        return distances / units.length, unit_name(units.length)

    deviations = []
    for channel in clip.channels:
        frame_errors, unit = target_errors(channel.target)
        worst_frame = int(np.argmax(frame_errors))
        error = float(frame_errors[worst_frame])
        time_code = float(take.clock.times[worst_frame])
        deviations.append(ChannelDeviation(channel.target, error, unit, time_code))
    return tuple(deviations)


def _value_errors(
    channels: Sequence[Channel | None], index: int, default: float
) -> FloatArray:
    """Return the errors ``(F,)`` between a row of two channels, or a default value."""
    take_values, keyed_values = (
        np.full((1, 1, 1), default) if c is None else c.gather(np.array([index]))
        for c in channels
    )
    return np.asarray(np.abs(take_values - keyed_values).max(axis=(1, 2)))


def key_notices(
    rig: Rig,
    joint_motions: Sequence[JointMotion],
    solution: SolvedControls,
    tracks: Sequence[KeyTrack],
    driven_targets: Mapping[str, FloatArray],
) -> tuple[Fault, ...]:
    """Return notes on motion that the rig's controls and mimics cannot produce."""
    notices = [
        *_released_notes(solution),
        *_additional_motion_notes(rig, tracks, driven_targets),
        *_off_type_notes(rig, joint_motions, tracks),
        *_unreachable_notes(rig, tracks),
    ]
    return tuple(Fault(c, m, severity=Severity.NOTE, hint=h) for c, m, h in notices)


_Note = tuple[str, str, str | None]


def _released_notes(solution: SolvedControls) -> Iterator[_Note]:
    """Yield a note on controls that have no values that reproduce their targets."""
    if solution.reset_names:
        names = listed(solution.reset_names, MAX_LISTED_NAMES)
        message = f"controls not keyed: no values of {names} reproduce what they drive"
        hint = "the joints and shapes that they drive have keys instead"
        yield "CLIP115", message, hint


def _additional_motion_notes(
    rig: Rig, tracks: Sequence[KeyTrack], driven_targets: Mapping[str, FloatArray]
) -> Iterator[_Note]:
    """Yield notes on joints that move in addition to their keyed controls."""
    units = ClipUnits.of_rig(rig)
    for track in tracks:
        if not track.part:
            continue
        target_prefix = f"joint/{rig.joints[track.index].name}."
        driven_parts = [
            target for target in driven_targets if target.startswith(target_prefix)
        ]
        if not any(np.ptp(driven_targets[target]) > 0 for target in driven_parts):
            continue
        if track.part in {"angle", "rotation"}:
            rotations = track.to_parent_space(track.samples)
            driven_rotation = track.reference
            assert driven_rotation is not None
            largest_value = (
                so3.angle_between(rotations, driven_rotation).max() / units.angle
            )
            unit = units.angle_name
        elif track.part in {"slide", "translation"}:
            largest_value = np.linalg.norm(track.samples, axis=1).max() / units.length
            unit = unit_name(units.length)
        else:
            continue
        joint = rig.joints[track.index].name
        message = f"joint {joint!r} has keys on top of what controls drive: "
        message += f"{track.part} up to {plain_number(largest_value)} {unit}"
        yield "CLIP116", message, None


def _off_type_notes(
    rig: Rig, joint_motions: Sequence[JointMotion], tracks: Sequence[KeyTrack]
) -> Iterator[_Note]:
    """Yield notes on joints whose motion their types do not allow."""
    units = ClipUnits.of_rig(rig)
    for track in tracks:
        if not track.part:
            continue
        joint, motion = rig.joints[track.index], joint_motions[track.index]
        if track.part == "local_rotation":
            verb = "rotates off its axis" if joint.type is JointType.PIN else "turns"
            error_text = plain_number(motion.rotation_error / units.angle)
            amount_text = f"{error_text} {units.angle_name}"
        elif track.part == "local_translation":
            is_slider = joint.type is JointType.PRISMATIC
            verb = "moves off its axis" if is_slider else "moves"
            error_text = plain_number(motion.translation_error / units.length)
            amount_text = f"{error_text} {unit_name(units.length)}"
        else:
            continue
        message = (
            f"joint {joint.name!r} of type {joint.type} {verb}, by up to {amount_text}"
        )
        hint = f"it has keys for {track.part} instead of its own coordinates"
        yield "CLIP117", message, hint


def _unreachable_notes(rig: Rig, tracks: Sequence[KeyTrack]) -> Iterator[_Note]:
    """Yield notes on mimic joints that do not follow their leaders."""
    keyed_joints = {t.index for t in tracks if t.part not in {"", "scale"}}
    for j in sorted(keyed_joints):
        joint = rig.joints[j]
        if joint.mimic is not None:
            message = f"joint {joint.name!r} does not follow {joint.mimic.joint!r}"
            yield "CLIP118", message, "it has keys"
