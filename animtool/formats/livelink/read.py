"""Reads a Live Link Face recording as a take."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    Severity,
    counted,
    listed,
    names_fault,
)
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import unit_name
from animtool.formats.livelink.columns import (
    ANGLE_AXES,
    FACE_PARTS,
    JOINTS_BY_PART,
    Recording,
    read_recording,
)
from animtool.formats.livelink.timecodes import TimecodeFrames, row_frames
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
    frames = row_frames(recording.labels, recording.lines, str(path), label_rate)
    target_rig = face_rig(recording) if rig is None else Rig.load(Path(rig))
    table = None if remap is None else load_remap(remap)
    links = link_shapes(recording.shapes, [s.name for s in target_rig.shapes], table)
    joints = head_joints(target_rig)
    notices = [*recording.notices, *frames.notices]
    rotations = _part_angles(recording)
    if not links.links and not (set(rotations) & set(joints)):
        message = f"{target_rig.name!r} has no shape of this recording, and no head "
        message += "joint"
        hint = f"map the shapes of other conventions with {argument('source.remap')}"
        if not target_rig.shapes:
            hint = "the rig has no shapes"
        raise OptionError(Fault("LLF007", message, str(path), (), hint))
    notices += _recording_notices(recording, frames, dropped)
    notices += _unmatched_notices(recording, links, rotations, joints, rig is not None)
    motion = _build_motion(recording, frames, target_rig, links, joints, dropped)
    details: dict[str, object] = {
        "format": "Live Link Face",
        "timecode": recording.labels[int(frames.rows[0])],
        "clock": str(frames.clock),
        "rows": len(recording.labels),
        "dropped_frames": frames.dropped.tolist(),
        "units": unit_name(target_rig.meters_per_unit),
    }
    if rig is not None:
        details["rig"] = str(rig)
        notices = [*target_rig.notices, *notices]
    return TakeStream(
        target_rig, frames.rate, None, Fraction(1), iter([motion]), notices, details
    )


def read_livelink_rig(path: Path) -> Rig:
    """Return a rig with a recording's shapes, and joints for head and eyes."""
    return face_rig(read_recording(path))


def face_rig(recording: Recording) -> Rig:
    """Return the default rig of a recording: shapes without meshes, head, eyes."""
    parts = ["Head", *(part for part in _rotated_parts(recording) if part != "Head")]
    joints = tuple(
        Joint(_JOINT_NAMES[joint], -1 if joint == HEAD else 0, JointType.BALL,
              _DEFAULT_POSITIONS[joint])
        for joint in (JOINTS_BY_PART[part] for part in parts)
    )  # fmt: skip
    shapes = tuple(Shape(name) for name in recording.shapes)
    return Rig(recording.path.stem, joints, shapes=shapes)


def _rotated_parts(recording: Recording) -> list[str]:
    """Return the parts (head, eyes) that have all three angles."""
    return [
        part
        for part in FACE_PARTS
        if all(part + axis in recording.angles for axis in ANGLE_AXES)
    ]


def _part_angles(recording: Recording) -> dict[str, FloatArray]:
    """Return yaw, pitch and roll of head and eyes by joint [deg] ``(R, 3)``."""
    angles_by_joint = {}
    for part in _rotated_parts(recording):
        columns = [recording.angles.index(part + axis) for axis in ANGLE_AXES]
        angles = np.degrees(recording.rotations[:, columns])
        angles_by_joint[JOINTS_BY_PART[part]] = angles
    return angles_by_joint


def _build_motion(
    recording: Recording,
    frames: TimecodeFrames,
    rig: Rig,
    links: ShapeLinks,
    joints: dict[str, int],
    dropped: DroppedFrames,
) -> Motion:
    times = frames.frames if dropped != "close" else np.arange(len(frames.frames))
    frame_numbers = np.arange(int(times[-1]) + 1)
    filled_weights = fill_gaps(recording.weights[frames.rows], times)
    shape_weights = links.apply(filled_weights, len(rig.shapes))
    weights = np.stack(
        [_interpolated_rows(column, times, frame_numbers, dropped)
         for column in shape_weights.T],
        axis=-1,
    ) if len(rig.shapes) else np.zeros((len(frame_numbers), 0))  # fmt: skip
    channel = Channel.static(rig.rest_rotations, len(frame_numbers))
    for joint_key, angles in _part_angles(recording).items():
        if joint_key not in joints:
            continue
        rotations = to_quaternion(fill_gaps(angles[frames.rows], times), "YXZ")
        local_rotations_of_joint = local_rotations(rig, joints[joint_key], rotations)
        values = _slerp_rows(
            align_signs(local_rotations_of_joint), times, frame_numbers, dropped
        )
        joint_index = np.array([joints[joint_key]])
        channel = channel.put(joint_index, values[:, None])
    return Motion(
        Channel.static(rig.rest_translations, len(frame_numbers)),
        channel.compact(),
        weights=Channel.from_dense(weights[..., None]) if len(rig.shapes) else None,
    )


def _interpolated_rows(
    values: FloatArray, times: IntArray, frame_numbers: IntArray, dropped: DroppedFrames
) -> FloatArray:
    if dropped == "hold":
        previous: FloatArray = values[
            np.searchsorted(times, frame_numbers, side="right") - 1
        ]
        return previous
    return np.interp(frame_numbers, times, values)


def _slerp_rows(
    rotations: FloatArray,
    times: IntArray,
    frame_numbers: IntArray,
    dropped: DroppedFrames,
) -> FloatArray:
    row_before = np.searchsorted(times, frame_numbers, side="right") - 1
    if dropped == "hold" or len(times) == 1:
        return rotations[row_before]
    row_after = np.minimum(row_before + 1, len(times) - 1)
    span = np.maximum(times[row_after] - times[row_before], 1)
    fraction = (frame_numbers - times[row_before]) / span
    interpolated = slerp(rotations[row_before], rotations[row_after], fraction)
    is_exact: BoolArray = fraction == 0
    interpolated[is_exact] = rotations[row_before[is_exact]]
    return interpolated


def _recording_notices(
    recording: Recording, frames: TimecodeFrames, dropped: DroppedFrames
) -> list[Fault]:
    """Return warnings about dropped frames, missing values and unusual weights."""
    path = str(recording.path)
    notices = []
    gaps = frames.dropped
    if len(gaps):
        fill = {
            "interpolate": "interpolated",
            "hold": "held from the frame before",
            "close": "removed, which moves later frames up",
        }[dropped]
        message = f"{len(gaps)} of {frames.count} frames have no row: {fill}; from the "
        message += f"first, frames {listed((gaps).tolist(), MAX_LISTED_SHAPES)}"
        hint = f"choose with {argument('source.dropped')}: interpolate, hold or close"
        notices.append(Fault("LLF101", message, path, (), hint, Severity.WARNING))
    for values, names in (
        (recording.weights, recording.shapes),
        (recording.rotations, recording.angles),
    ):
        is_missing = ~np.isfinite(values)
        for c in np.flatnonzero(is_missing.any(axis=0)).tolist():
            lines = recording.lines[is_missing[:, c]].tolist()
            treatment = "interpolated from its neighbours"
            if is_missing[:, c].all():
                treatment = "set to 0"
            message = f"{names[c]} has no value in {counted(len(lines), 'row')}: "
            message += f"{treatment}"
            rows, warning = tuple(lines[:MAX_LISTED_SHAPES]), Severity.WARNING
            notices.append(Fault("LLF102", message, path, rows, severity=warning))
    # Values are kept: some rigs exceed 1, and percentages are detected.
    with np.errstate(invalid="ignore"):
        out_of_range = (recording.weights < -1e-6) | (recording.weights > 1 + 1e-6)
    if out_of_range.any():
        row, column = np.argwhere(out_of_range)[0].tolist()
        message = (
            f"{counted(int(out_of_range.sum()), 'weight')} outside 0 to 1, the first "
            f"{recording.shapes[column]} = {recording.weights[row, column]:g}"
        )
        line = (int(recording.lines[row]),)
        hint = "set gain and clamp in a remap file"
        notices.append(Fault("LLF109", message, path, line, hint, Severity.WARNING))
    return notices


def _unmatched_notices(
    recording: Recording,
    links: ShapeLinks,
    rotations: dict[str, FloatArray],
    joints: dict[str, int],
    has_rig_option: bool,
) -> list[Fault]:
    """Return notices of names only in the recording or only in the rig."""
    path = str(recording.path)
    notices = []
    if has_rig_option and links.lost:
        zero_shapes = {
            name
            for name, column in zip(recording.shapes, recording.weights.T, strict=True)
            if not np.nan_to_num(column).any()
        }
        unmatched_names = [name for name in links.lost if name not in zero_shapes]
        if unmatched_names:
            message = f"{len(unmatched_names)} shapes are not in the rig: "
            hint = f"map them to its shapes with {argument('source.remap')}"
            notices.append(
                names_fault(
                    "LLF108", message, unmatched_names, path, hint, Severity.WARNING
                )
            )
    for part, angles in rotations.items():
        if part not in joints and np.nan_to_num(angles).any():
            message = f"the rig has no joint for the {part}: its rotation is skipped"
            notices.append(Fault("LLF110", message, path, (), None, Severity.NOTE))
    incomplete_angles = {
        angle
        for angle in recording.angles
        if not any(angle.startswith(part) for part in _rotated_parts(recording))
    }
    if incomplete_angles:
        message = f"{listed(sorted(incomplete_angles))} without the two others: skipped"
        notices.append(Fault("LLF110", message, path, (), None, Severity.NOTE))
    return notices
