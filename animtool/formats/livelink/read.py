"""Reads a Live Link Face recording as a take."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, counted, listed
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import unit_name
from animtool.formats.livelink.columns import (
    ANGLE_AXES,
    FACE_PARTS,
    JOINTS_BY_PART,
    Recording,
    read_recording,
)
from animtool.formats.livelink.timecodes import RecordingFrames, find_row_frames
from animtool.maths.euler import to_quaternion
from animtool.maths.filters import fill_gaps
from animtool.maths.so3 import align_signs, slerp
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.head import HEAD, LEFT_EYE, RIGHT_EYE, head_joints, local_rotations
from animtool.rig.parts import Shape
from animtool.rig.remap import ShapeLinks, link_shapes, load_remap
from animtool.rig.skeleton import Joint, JointType, Rig

DroppedFrames: TypeAlias = Literal["interpolate", "hold", "close"]
DROPPED_FRAME_OPTIONS: tuple[DroppedFrames, ...] = ("interpolate", "hold", "close")
MAX_LISTED_SHAPES = 12
# Weights are percentages if this fraction is above 1, and none above the maximum.
MIN_PERCENTAGE_FRACTION, MAX_PERCENTAGE = 0.25, 200.0
# Angles of a recording are from -pi to pi, rounded to a few digits [1].
ANGLE_TOLERANCE = 1e-3
# Joint names and positions [m] of the default rig; positions only need to be distinct.
_JOINT_NAMES = {HEAD: "head", LEFT_EYE: "eye_l", RIGHT_EYE: "eye_r"}
_DEFAULT_POSITIONS = {HEAD: (0.0, 0.0, 0.0), LEFT_EYE: (0.032, 0.03, 0.08)}
_DEFAULT_POSITIONS[RIGHT_EYE] = (-0.032, 0.03, 0.08)


def read_livelink(
    path: Path | str,
    *,
    rig: Path | str | None = None,
    fps: FractionLike | None = None,
    remap: Path | str | None = None,
    dropped: DroppedFrames = "interpolate",
) -> TakeStream:
    """Open a Live Link Face recording (CSV) as a take.

    Weights drive the shapes of the same names, in any of ARKit's spellings. Head and
    eyes rotate joints of those names; angles are radians about the axes of the face:
    yaw about up, then pitch about left, then roll about forward.

    Args:
        path: The file.
        rig: The rig to animate; None builds one with the columns as shapes.
        fps: Time code labels per second; None derives it.
        remap: A remap file, for shapes with other names.
        dropped: Handling of frames without a row: ``interpolate`` between neighbours,
            ``hold`` the previous frame, or ``close`` the gap, so that later frames move
            up.
    """
    path = Path(path)
    if dropped not in DROPPED_FRAME_OPTIONS:
        message = f"dropped is {dropped!r}"
        hint = f"allowed: {', '.join(DROPPED_FRAME_OPTIONS)}"
        raise OptionError(Fault("SCN022", message, str(path), (), hint))
    label_rate = None if fps is None else rate_option(fps)
    recording = read_recording(path)
    file, timecodes = recording.file, recording.timecodes
    timing = find_row_frames(file, timecodes, recording.line_numbers, label_rate)
    target_rig = (
        _build_default_rig(path, recording) if rig is None else Rig.load(Path(rig))
    )
    remap_table = None if remap is None else load_remap(remap)
    links = link_shapes(
        recording.shape_names, [s.name for s in target_rig.shapes], remap_table
    )
    joints = head_joints(target_rig)
    part_angles = _part_angles(recording)
    if not links.links and not (set(part_angles) & set(joints)):
        message = f"{target_rig.name!r} has no shape of this recording, and no head "
        message += "joint"
        hint = f"map the shapes of other conventions with {argument('source.remap')}"
        if not target_rig.shapes:
            hint = "the rig has no shapes"
        raise OptionError(Fault("LLF007", message, str(path), (), hint))
    _warn_of_values(recording, timing, links, dropped)
    _warn_of_unmatched_names(recording, links, part_angles, joints, rig is not None)
    motion = _build_motion(recording, timing, target_rig, links, joints, dropped)
    details: dict[str, object] = {
        "format": "Live Link Face",
        "timecode": timecodes[int(timing.row_indices[0])],
        "clock": str(timing.label_rate),
        "rows": len(timecodes),
        "dropped_frames": timing.dropped_frames.tolist(),
        "units": unit_name(target_rig.meters_per_unit),
    }
    notices = file.notices
    if rig is not None:
        details["rig"] = str(rig)
        notices = [*target_rig.notices, *notices]
    return TakeStream(
        target_rig, timing.rate, None, Fraction(1), iter([motion]), notices, details
    )


def read_livelink_rig(path: Path) -> Rig:
    """Return a rig with a recording's shapes, and joints for head and eyes."""
    return _build_default_rig(path, read_recording(path))


def _build_default_rig(path: Path, recording: Recording) -> Rig:
    """Return a rig of a recording's shapes, without meshes, with head and eyes."""
    parts = ["Head", *(part for part in _rotated_parts(recording) if part != "Head")]
    joints = tuple(
        Joint(_JOINT_NAMES[joint], -1 if joint == HEAD else 0, JointType.BALL,
              _DEFAULT_POSITIONS[joint])
        for joint in (JOINTS_BY_PART[part] for part in parts)
    )  # fmt: skip
    shapes = tuple(Shape(name) for name in recording.shape_names)
    return Rig(path.stem, joints, shapes=shapes)


def _rotated_parts(recording: Recording) -> list[str]:
    """Return those of head and eyes whose three angles are all recorded."""
    return [
        part
        for part in FACE_PARTS
        if all(part + axis in recording.angle_names for axis in ANGLE_AXES)
    ]


def _part_angles(recording: Recording) -> dict[str, FloatArray]:
    """Return yaw, pitch and roll of head and eyes by joint [deg] ``(R, 3)``."""
    angles_by_joint = {}
    for part in _rotated_parts(recording):
        columns = [recording.angle_names.index(part + axis) for axis in ANGLE_AXES]
        angles = np.degrees(recording.rotations[:, columns])
        angles_by_joint[JOINTS_BY_PART[part]] = angles
    return angles_by_joint


def _build_motion(
    recording: Recording,
    timing: RecordingFrames,
    rig: Rig,
    links: ShapeLinks,
    joints: dict[str, int],
    dropped: DroppedFrames,
) -> Motion:
    row_frames = timing.frames if dropped != "close" else np.arange(len(timing.frames))
    frame_numbers = np.arange(int(row_frames[-1]) + 1)
    filled_weights = fill_gaps(recording.weights[timing.row_indices], row_frames)
    shape_weights = links.apply(filled_weights, len(rig.shapes))
    weights = _interpolate_rows(shape_weights, row_frames, frame_numbers, dropped)
    channel = Channel.static(rig.rest_rotations, len(frame_numbers))
    for joint_key, angles in _part_angles(recording).items():
        if joint_key not in joints:
            continue
        rotations = to_quaternion(
            fill_gaps(angles[timing.row_indices], row_frames), "YXZ"
        )
        joint = joints[joint_key]
        local = align_signs(local_rotations(rig, joint, rotations))
        values = _slerp_rows(local, row_frames, frame_numbers, dropped)
        channel = channel.put(np.array([joint]), values[:, None])
    return Motion(
        Channel.static(rig.rest_translations, len(frame_numbers)),
        channel.compact(),
        weights=Channel.from_dense(weights[..., None]) if len(rig.shapes) else None,
    )


def _interpolate_rows(
    values: FloatArray,
    row_frames: IntArray,
    frame_numbers: IntArray,
    dropped: DroppedFrames,
) -> FloatArray:
    """Return values ``(F, S)`` at frames, held or linear between rows ``(R, S)``."""
    if dropped == "hold":
        row_before = np.searchsorted(row_frames, frame_numbers, side="right") - 1
        return values[row_before]
    frame_values = np.zeros((len(frame_numbers), values.shape[1]))
    for column, row_values in enumerate(values.T):
        frame_values[:, column] = np.interp(frame_numbers, row_frames, row_values)
    return frame_values


def _slerp_rows(
    rotations: FloatArray,
    row_frames: IntArray,
    frame_numbers: IntArray,
    dropped: DroppedFrames,
) -> FloatArray:
    row_before = np.searchsorted(row_frames, frame_numbers, side="right") - 1
    if dropped == "hold" or len(row_frames) == 1:
        return rotations[row_before]
    row_after = np.minimum(row_before + 1, len(row_frames) - 1)
    interval = np.maximum(row_frames[row_after] - row_frames[row_before], 1)
    fraction = (frame_numbers - row_frames[row_before]) / interval
    frame_rotations = slerp(rotations[row_before], rotations[row_after], fraction)
    is_on_row = fraction == 0
    frame_rotations[is_on_row] = rotations[row_before[is_on_row]]
    return frame_rotations


def _warn_of_values(
    recording: Recording,
    timing: RecordingFrames,
    links: ShapeLinks,
    dropped: DroppedFrames,
) -> None:
    """Warn about dropped frames, missing values and unusual weights."""
    file, dropped_frames = recording.file, timing.dropped_frames
    if len(dropped_frames):
        frame_treatment = {
            "interpolate": "interpolated",
            "hold": "held from the frame before",
            "close": "removed, which moves later frames up",
        }[dropped]
        verbs = ("has", "was") if len(dropped_frames) == 1 else ("have", "were")
        message = f"{len(dropped_frames)} of {timing.count} frames {verbs[0]} no row "
        message += f"and {verbs[1]} {frame_treatment}: "
        message += listed(dropped_frames.tolist(), MAX_LISTED_SHAPES)
        message += " (the first frame is 0)"
        hint = f"to change this, set {argument('source.dropped')} to interpolate, hold "
        hint += "or close"
        file.warn("LLF101", message, hint)
    for values, names in (
        (recording.weights, recording.shape_names),
        (recording.rotations, recording.angle_names),
    ):
        is_missing = ~np.isfinite(values)
        for column_index in np.flatnonzero(is_missing.any(axis=0)).tolist():
            lines = recording.line_numbers[is_missing[:, column_index]].tolist()
            value_treatment = "interpolated from its neighbours"
            if is_missing[:, column_index].all():
                value_treatment = "set to 0"
            message = (
                f"{names[column_index]} has no value in {counted(len(lines), 'row')}; "
                f"it is {value_treatment} there"
            )
            file.warn("LLF102", message, None, *lines[:MAX_LISTED_SHAPES])
    _warn_of_degrees(recording)
    # Values are kept: some rigs exceed 1, and percentages are detected.
    weights = links.map_sources(recording.weights)
    with np.errstate(invalid="ignore"):
        is_out_of_range = (weights < -1e-6) | (weights > 1 + 1e-6)
    if is_out_of_range.any():
        row, column = np.argwhere(is_out_of_range)[0].tolist()
        count, shape = int(is_out_of_range.sum()), recording.shape_names[column]
        message = f"{counted(count, 'weight')} outside 0 to 1, the first {shape} = "
        message += f"{weights[row, column]:g}"
        hint = "correct gain, offset and clamp of these shapes in the remap file"
        if weights[row, column] == recording.weights[row, column]:
            is_remapped = (weights != recording.weights) & np.isfinite(weights)
            hint = _scale_hint(weights[:, ~is_remapped.any(axis=0)], shape)
        else:
            message += " after the remap file"
        file.warn("LLF109", message, hint, int(recording.line_numbers[row]))


def _warn_of_degrees(recording: Recording) -> None:
    """Warn about angles outside -pi to pi, which are likely degrees (LLF112)."""
    magnitudes = np.abs(np.nan_to_num(recording.rotations, posinf=0.0, neginf=0.0))
    is_too_large = magnitudes > np.pi * (1 + ANGLE_TOLERANCE)
    if not is_too_large.any():
        return
    row, column = np.argwhere(is_too_large)[0].tolist()
    angle, name = recording.rotations[row, column], recording.angle_names[column]
    count = int(is_too_large.sum())
    message = f"{counted(count, 'angle')} outside -pi to pi, the first {name} = "
    message += f"{angle:g}: in radians that is {np.degrees(angle):.0f}°"
    hint = "the head and the eyes are in radians: divide the columns by 57.2958, or "
    hint += "export radians"
    recording.file.warn("LLF112", message, hint, int(recording.line_numbers[row]))


def _scale_hint(weights: FloatArray, shape: str) -> str:
    """Return a hint to bring the weights into 0 to 1; ``shape`` has one outside."""
    magnitudes = np.abs(weights[np.isfinite(weights) & (weights != 0)])
    fraction_above_1 = np.count_nonzero(magnitudes > 1) / len(magnitudes)
    is_percentage = 1 < magnitudes.max() <= MAX_PERCENTAGE
    if not is_percentage or fraction_above_1 < MIN_PERCENTAGE_FRACTION:
        return "set gain and clamp in a remap file"
    example = f"{{source: {shape}, target: {shape}, gain: 0.01}}"
    return (
        f"weights up to {magnitudes.max():g} look like percentages: pair each shape in "
        f"a remap file with gain 0.01, such as {example}"
    )


def _warn_of_unmatched_names(
    recording: Recording,
    links: ShapeLinks,
    part_angles: dict[str, FloatArray],
    joints: dict[str, int],
    has_rig_option: bool,
) -> None:
    """Warn about names that only the recording or only the rig has."""
    file = recording.file
    if has_rig_option and links.unlinked:
        zero_shapes = {
            name
            for name, column in zip(
                recording.shape_names, recording.weights.T, strict=True
            )
            if not np.nan_to_num(column).any()
        }
        unmatched_names = [name for name in links.unlinked if name not in zero_shapes]
        if unmatched_names:
            message = f"{len(unmatched_names)} shapes are not in the rig: "
            hint = f"map them to its shapes with {argument('source.remap')}"
            file.warn_of_names("LLF108", message, unmatched_names, hint)
    for part, angles in part_angles.items():
        if part not in joints and np.nan_to_num(angles).any():
            message = f"the rig has no joint for the {part}: its rotation is skipped"
            file.note("LLF110", message)
    incomplete_angles = {
        angle
        for angle in recording.angle_names
        if not any(angle.startswith(part) for part in _rotated_parts(recording))
    }
    if incomplete_angles:
        message = (
            f"skipped {listed(sorted(incomplete_angles))}: a rotation needs three "
        )
        message += "angles"
        file.note("LLF110", message)
