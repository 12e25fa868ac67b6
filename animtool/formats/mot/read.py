"""Reads an OpenSim motion file as a take of joint coordinates."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, counted, excerpt
from animtool.core.names import most_similar
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import unit_name
from animtool.formats.mot.coordinates import (
    Coordinate,
    build_rig_from_columns,
    convert_columns_to_coordinates,
    coordinates_by_name,
    parse_coordinate_name,
)
from animtool.formats.mot.table import (
    MotionTable,
    check_duplicates,
    read_table,
    table_rate,
)
from animtool.formats.row_times import (
    MAX_FRAME_NUMBER,
    STEP_TOLERANCE,
    fit_frames,
    median_step,
    rounding_error,
)
from animtool.formats.trajectories import CaptureFile
from animtool.formats.zero_rows import ZeroRows
from animtool.ik.sub_rig import with_mimics
from animtool.maths.filters import fill_gaps
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Joint, JointType, Rig

# Maximum frames per row at irregular times. More are gaps, and filling these would be
# invented motion.
MAX_FRAMES_PER_ROW = 10
# Values of joints that follow others differ by more than rounding [rad], [m].
FOLLOWING_TOLERANCE = 1e-3
# Smaller shifts of a take are rounding of times [s].
MIN_TIME_SHIFT = 1e-4
# Two revolutions [rad]: joints of a body rotate less, and values in degrees soon exceed
# it.
MAX_PLAUSIBLE_ANGLE = 4 * np.pi
# A body whose root moves by so much [m] bends so many joints farther than 2π degrees;
# one that stands bends some of so many farther than π, with a margin, in degrees.
MIN_TRAVEL, MIN_TRAVELLING_ANGLES = 0.5, 5
MIN_STANDING_ANGLES, MAX_STANDING_RADIANS = 8, 3.3
# Smaller changes and angles are noise [deg].
MIN_ANGLE_CHANGE, MIN_LARGEST_ANGLE = 0.1, 0.7


def read_mot(
    path: Path | str, *, rig: Path | str | None = None, fps: FractionLike | None = None
) -> TakeStream:
    """Open an OpenSim motion file (MOT, STO) as a take.

    Columns are coordinates of a rig by name, see
    `animtool.formats.mot.coordinates.coordinates_by_name`: angles in degrees or
    radians, as the header states, lengths in metres, all relative to the rest pose.
    Time 0 is frame 1. Rows at irregular times are resampled linearly.

    Args:
        path: The file.
        rig: The rig to animate; None builds one with a joint for each column.
        fps: Rows per second, if the times are wrong; None derives it from the times.
    """
    path = Path(path)
    requested_rate = None if fps is None else rate_option(fps)
    table = read_table(path)
    file, header = table.file, table.header
    take_rig = (
        _build_default_rig(path, table)
        if rig is None
        else at_origin(Rig.load(Path(rig)))
    )
    column_indices, coordinates, unmatched_names = _match_columns(table, take_rig)
    if rig is None:
        message = "names no rig: each coordinate became a joint"
        hint = f"set the rig of its coordinates with {argument('source.rig')}"
        file.note("MOF106", message, hint)
    elif unmatched_names:
        message = f"{len(unmatched_names)} columns are not coordinates of "
        message += f"{take_rig.name!r}: "
        hint = "name columns after joints: knee.angle, lift.slide, hip_x"
        file.warn_of_names("MOF102", message, unmatched_names, hint)
    if header.in_degrees is None:
        _warn_unstated_unit(file, header.invalid_in_degrees)
    if rig is not None:
        # Without a rig, the columns may be forces, which are zero between contacts.
        zero_rows = ZeroRows()
        zero_rows.add(table.values[:, column_indices], table.line_numbers)
        file.notices += zero_rows.warnings(file.path)
    values = fill_gaps(table.values[:, column_indices], table.times)
    is_angle = np.array([coordinate.is_angle for coordinate in coordinates], np.bool_)
    if header.in_degrees:
        _warn_likely_radians(file, values[:, is_angle], values[:, ~is_angle])
    else:
        names = [
            header.names[column]
            for column, has_angle in zip(column_indices, is_angle, strict=True)
            if has_angle
        ]
        _warn_likely_degrees(file, names, values[:, is_angle])
        values[:, is_angle] = np.degrees(values[:, is_angle])
    rate, values = _resample_rows(table, values, requested_rate)
    motion = _build_motion(file, take_rig, coordinates, values)
    details: dict[str, object] = {
        "format": "OpenSim motion",
        "columns": len(header.names),
        "coordinates": len(coordinates),
        "angles": "degrees" if header.in_degrees else "radians",
        "first_time": float(table.times[0]),
        "units": unit_name(take_rig.meters_per_unit),
    }
    start = _first_frame(table, rate)
    notices = file.notices
    if rig is not None:
        details["rig"] = str(rig)
        notices = [*take_rig.notices, *notices]
    return TakeStream(
        take_rig, rate, start, Fraction(1), iter([motion]), notices, details
    )


def _first_frame(table: MotionTable, rate: Fraction) -> Fraction | None:
    """Return the frame of the first row; None if it is too large.

    A row between two frames is noted (MOF113).
    """
    first_time = float(table.times[0])
    frame_position = first_time * float(rate)
    if abs(frame_position) >= MAX_FRAME_NUMBER:
        return None
    frame = round(frame_position)
    shift = frame / float(rate) - first_time
    if abs(shift) > max(MIN_TIME_SHIFT, 3 * rounding_error(table.time_decimals)):
        message = f"starts at {first_time:.6g} s, which is between frames "
        message += f"{math.floor(frame_position) + 1} and "
        message += f"{math.floor(frame_position) + 2} at {float(rate):.6g} fps: "
        message += f"frame {frame + 1} is its first row, {abs(shift):.3g} s "
        message += "later" if shift > 0 else "earlier"
        hint = "move other data of the trial, such as forces, by as much"
        table.file.note("MOF113", message, hint)
    return Fraction(frame + 1)


def _warn_unstated_unit(file: CaptureFile, invalid_in_degrees: str) -> None:
    """Warn that a header does not state the unit of angles (MOF107)."""
    message = "has no inDegrees in its header: using radians, as OpenSim does"
    if invalid_in_degrees:
        message = f"inDegrees is {excerpt(invalid_in_degrees)}, not yes or no: "
        message += "using radians, as OpenSim does"
    file.warn("MOF107", message, "write inDegrees=yes or no in its header")


def read_mot_rig(path: Path) -> Rig:
    """Return a rig with a joint for each coordinate of a motion file."""
    return _build_default_rig(path, read_table(path))


def _build_default_rig(path: Path, table: MotionTable) -> Rig:
    names = dict.fromkeys(filter(None, map(parse_coordinate_name, table.header.names)))
    if not names:
        raise table.file.error("MOF002", "has no column with a coordinate")
    return build_rig_from_columns(path.stem, list(names))


def _warn_likely_degrees(
    file: CaptureFile, names: list[str], angles: FloatArray
) -> None:
    """Warn about angles ``(R, A)`` [rad] that are likely degrees (MOF112)."""
    max_angles = np.abs(angles).max(axis=0, initial=0.0)
    if not (max_angles > MAX_PLAUSIBLE_ANGLE).any():
        return
    name, value = names[int(max_angles.argmax())], float(max_angles.max())
    message = f"angles are read as radians, but {excerpt(name)} reaches {value:.4g}, "
    message += f"which is {value / (2 * np.pi):.3g} revolutions"
    hint = "write inDegrees=yes in the header if they are degrees"
    file.warn("MOF112", message, hint)


def _warn_likely_radians(
    file: CaptureFile, angles: FloatArray, slides: FloatArray
) -> None:
    """Warn about angles ``(R, A)`` [deg] that are likely radians (MOF112).

    Either the body travels by ``slides`` ``(R, S)`` [m], or many angles change, and all
    angles are tiny.
    """
    changing_count = int((np.ptp(angles, axis=0) > MIN_ANGLE_CHANGE).sum())
    largest_angle = float(np.abs(angles).max(initial=0.0))
    travel = float(np.ptp(slides, axis=0).max(initial=0.0))
    is_travelling = travel >= MIN_TRAVEL and changing_count >= MIN_TRAVELLING_ANGLES
    max_radians = 2 * np.pi if is_travelling else MAX_STANDING_RADIANS
    is_body = is_travelling or changing_count >= MIN_STANDING_ANGLES
    if not is_body or not MIN_LARGEST_ANGLE <= largest_angle <= max_radians:
        return
    message = f"angles are read as degrees, but none of {changing_count} that change "
    message += f"exceeds {largest_angle:.3g}"
    hint = "write inDegrees=no in the header if they are radians: "
    hint += f"{largest_angle:.3g} rad is {np.degrees(largest_angle):.3g} deg"
    file.warn("MOF112", message, hint)


def _match_columns(
    table: MotionTable, rig: Rig
) -> tuple[list[int], list[Coordinate], list[str]]:
    """Return indices and coordinates of the known columns, and the unknown names."""
    coordinate_by_name = coordinates_by_name(rig)
    column_indices, coordinates, unmatched_names = [], [], []
    for c, name in enumerate(table.header.names):
        coordinate = coordinate_by_name.get(parse_coordinate_name(name) or "")
        if coordinate is None:
            unmatched_names.append(name)
        else:
            column_indices.append(c)
            coordinates.append(coordinate)
    if not coordinates:
        option = argument("source.rig")
        message = f"{option}: rig {rig.name!r} has none of the "
        message += f"{counted(len(unmatched_names), 'coordinate')}, such as "
        message += repr(unmatched_names[0])
        similar_name = most_similar(unmatched_names[0], coordinate_by_name)
        hint = f"read it with the rig that it was made for, or without {option}; "
        hint += "animtool retarget transfers the take to another"
        hint = f"did you mean {similar_name}?" if similar_name else hint
        raise OptionError(Fault("MOF007", message, table.file.path, (), hint))
    names = [table.header.names[c] for c in column_indices]
    check_duplicates(table.file, coordinates, names)
    return column_indices, coordinates, unmatched_names


def _resample_rows(
    table: MotionTable, values: FloatArray, requested_rate: Fraction | None
) -> tuple[Fraction, FloatArray]:
    """Return the frame rate, and values ``(F, C)`` resampled to constant steps."""
    times, file = table.times, table.file
    if requested_rate is not None:
        return requested_rate, values
    if len(times) == 1:
        message = "has one row, which gives no rate"
        hint = f"set the rate with {argument('source.fps')}"
        raise file.error("MOF006", message, hint)
    duration = float(times[-1] - times[0])
    rounding = rounding_error(table.time_decimals)
    fit = fit_frames(times, np.arange(len(times)), rounding)
    if fit.is_regular:
        return table_rate(file, fit.step, rounding, len(times) - 1), values
    rate = table_rate(file, median_step(times), rounding, 1)
    frame_count = duration * float(rate) + 1
    hint = f"{argument('source.fps')} reads each row as a frame"
    if frame_count > MAX_FRAMES_PER_ROW * len(times):
        message = (
            f"{len(times)} rows span {frame_count:.3g} frames at {float(rate):g} fps"
        )
        raise file.error("MOF006", message, hint)
    frame_times = times[0] + np.arange(int(frame_count + STEP_TOLERANCE)) / float(rate)
    resampled_values = np.stack(
        [np.interp(frame_times, times, column) for column in values.T], axis=-1
    )
    message = f"times are uneven, up to {fit.max_error:.3g} s off: resampled at "
    message += f"{float(rate):g} fps, linearly between rows"
    file.warn("MOF105", message, hint)
    return rate, resampled_values


def _build_motion(
    file: CaptureFile,
    rig: Rig,
    column_coordinates: list[Coordinate],
    values: FloatArray,
) -> Motion:
    """Return the motion of columns ``(F, C)`` [deg, m]; joints without one may follow.

    Warns about columns of mimic and driven joints that do not follow (MOF114).
    """
    file_coordinates = convert_columns_to_coordinates(rig, column_coordinates, values)
    animated_joints = {rig.joints[c.joint_index].name for c in column_coordinates}
    coordinates = with_mimics(rig, file_coordinates, animated_joints)
    slices = coordinate_slices(rig)
    offsets: dict[str, float] = {}
    for j in sorted({c.joint_index for c in column_coordinates}):
        offset = _following_error(
            rig.joints[j], coordinates[:, slices[j]] - file_coordinates[:, slices[j]]
        )
        if offset > FOLLOWING_TOLERANCE:
            offsets[rig.names[j]] = offset
        coordinates[:, slices[j]] = file_coordinates[:, slices[j]]
    if offsets:
        name = max(offsets, key=lambda n: offsets[n])
        is_pin = rig.joints[rig.index(name)].type is JointType.PIN
        size_text = (
            f"{np.degrees(offsets[name]):.4g}°" if is_pin else f"{offsets[name]:.4g} m"
        )
        message = f"{counted(len(offsets), 'column')} of joints that follow others do "
        message += (
            f"not follow, {excerpt(name)} by up to {size_text}: the file's values "
        )
        message += "are used"
        hint = "remove the columns to make these joints follow"
        file.warn("MOF114", message, hint)
    local = local_from_coordinates(rig, coordinates)
    return Motion(
        Channel.from_dense(local.translations), Channel.from_dense(local.rotations)
    )


def _following_error(joint: Joint, coordinate_offsets: FloatArray) -> float:
    """Return the largest offset of a joint that follows [rad], [m].

    Angles may differ by whole revolutions of the joint or of the one it follows.
    """
    gain = 0.0 if joint.mimic is None else joint.mimic.gain
    revolutions = gain * np.arange(-1, 2)[:, None] + np.arange(-2, 3)
    distances = np.abs(
        coordinate_offsets.ravel() - 2 * np.pi * revolutions.reshape(-1, 1)
    )
    return float(distances.min(axis=0).max())
