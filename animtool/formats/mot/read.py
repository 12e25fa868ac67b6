"""Reads an OpenSim motion file as a take of joint coordinates."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    excerpt,
    names_fault,
)
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
from animtool.formats.mot.table import MotionTable, check_duplicates, read_table
from animtool.formats.row_times import (
    MAX_START_FRAME,
    STEP_TOLERANCE,
    fit_frames,
    median_step,
    rate_of_step,
    rounding_error,
)
from animtool.ik.sub_rig import with_mimics
from animtool.maths.filters import fill_gaps
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.joints import local_from_coordinates
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig

# Maximum frames per row at irregular times. More are gaps, and filling these would be
# invented motion.
MAX_FRAMES_PER_ROW = 10
# Two revolutions [rad]: joints of a body rotate less, and values in degrees soon exceed
# it.
MAX_RADIANS = 4 * np.pi


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
    notices = list(table.notices)
    take_rig = (
        _build_default_rig(table) if rig is None else at_origin(Rig.load(Path(rig)))
    )
    table_columns, columns, unmatched = _match_columns(table, take_rig)
    if rig is None:
        message = "names no rig: each coordinate became a joint"
        hint = f"set the rig of its coordinates with {argument('source.rig')}"
        notices.append(Fault("MOF106", message, str(path), (), hint, Severity.NOTE))
    elif unmatched:
        message = f"{len(unmatched)} columns are not coordinates of {take_rig.name!r}: "
        hint = "name columns after joints: knee.angle, lift.slide, hip_x"
        warning = Severity.WARNING
        notices.append(
            names_fault("MOF102", message, unmatched, str(path), hint, warning)
        )
    if table.degrees is None:
        notices.append(_radians_notice(table, path))
    values = fill_gaps(table.values[:, table_columns], table.times)
    if not table.degrees:
        is_angle = [coordinate.is_angle for coordinate in columns]
        names = [
            table.names[c] for c, a in zip(table_columns, is_angle, strict=True) if a
        ]
        notices += _degrees_notice(str(path), names, values[:, is_angle])
        values[:, is_angle] = np.degrees(values[:, is_angle])
    rate, values, timing_notices = _resample_rows(table, values, requested_rate)
    motion = _build_motion(take_rig, columns, values)
    details: dict[str, object] = {
        "format": "OpenSim motion",
        "columns": len(table.names),
        "coordinates": len(columns),
        "angles": "degrees" if table.degrees else "radians",
        "first_time": float(table.times[0]),
        "units": unit_name(take_rig.meters_per_unit),
    }
    if rig is not None:
        details["rig"] = str(rig)
        notices = [*take_rig.notices, *notices]
    first_frame = float(table.times[0]) * float(rate)
    start = (
        Fraction(round(first_frame) + 1) if abs(first_frame) < MAX_START_FRAME else None
    )
    return TakeStream(
        take_rig,
        rate,
        start,
        Fraction(1),
        iter([motion]),
        [*notices, *timing_notices],
        details,
    )


def _radians_notice(table: MotionTable, path: Path) -> Fault:
    """Warn that a header does not state the unit of angles (MOF107)."""
    message = "has no inDegrees in its header: using radians, as OpenSim does"
    if table.in_degrees:
        message = f"inDegrees is {excerpt(table.in_degrees)}, not yes or no: "
        message += "using radians, as OpenSim does"
    hint = "write inDegrees=yes or no in its header"
    return Fault("MOF107", message, str(path), (), hint, Severity.WARNING)


def read_mot_rig(path: Path) -> Rig:
    """Return a rig with a joint for each coordinate of a motion file."""
    return _build_default_rig(read_table(path))


def _build_default_rig(table: MotionTable) -> Rig:
    names = dict.fromkeys(filter(None, map(parse_coordinate_name, table.names)))
    if not names:
        message = "has no column with a coordinate"
        raise FormatError(Fault("MOF002", message, str(table.path)))
    return build_rig_from_columns(table.path.stem, list(names))


def _degrees_notice(path: str, names: list[str], angles: FloatArray) -> list[Fault]:
    """Return a warning about angles ``(R, A)`` [rad] that are likely degrees."""
    max_angles = np.abs(angles).max(axis=0, initial=0.0)
    if not (max_angles > MAX_RADIANS).any():
        return []
    name, value = names[int(max_angles.argmax())], float(max_angles.max())
    message = f"angles are read as radians, but {excerpt(name)} reaches {value:.4g}, "
    message += f"which is {value / (2 * np.pi):.3g} revolutions"
    hint = "write inDegrees=yes in the header if they are degrees"
    return [Fault("MOF112", message, path, (), hint, Severity.WARNING)]


def _match_columns(
    table: MotionTable, rig: Rig
) -> tuple[list[int], list[Coordinate], list[str]]:
    """Return indices of known columns, their coordinates, and unknown names."""
    coordinate_by_name = coordinates_by_name(rig)
    table_columns, columns, unmatched = [], [], []
    for c, name in enumerate(table.names):
        coordinate = coordinate_by_name.get(parse_coordinate_name(name) or "")
        if coordinate is None:
            unmatched.append(name)
        else:
            table_columns.append(c)
            columns.append(coordinate)
    if not columns:
        option = argument("source.rig")
        message = f"{option}: rig {rig.name!r} has none of the "
        message += f"{counted(len(unmatched), 'coordinate')}, such as {unmatched[0]!r}"
        similar_name = most_similar(unmatched[0], coordinate_by_name)
        hint = f"read it with the rig that it was made for, or without {option}; "
        hint += "animtool retarget transfers the take to another"
        hint = f"did you mean {similar_name}?" if similar_name else hint
        raise OptionError(Fault("MOF007", message, str(table.path), (), hint))
    check_duplicates(
        table.path, tuple(columns), tuple(table.names[c] for c in table_columns), None
    )
    return table_columns, columns, unmatched


def _resample_rows(
    table: MotionTable, values: FloatArray, requested_rate: Fraction | None
) -> tuple[Fraction, FloatArray, list[Fault]]:
    """Return the rate, and values resampled to constant steps."""
    times, path = table.times, str(table.path)
    if requested_rate is not None:
        return requested_rate, values, []
    if len(times) == 1:
        message = "has one row, which gives no rate"
        hint = f"set the rate with {argument('source.fps')}"
        raise FormatError(Fault("MOF006", message, path, (), hint))
    duration = float(times[-1] - times[0])
    rounding = rounding_error(table.decimals)
    steps = fit_frames(times, np.arange(len(times)), rounding)
    if steps.regular:
        return _table_rate(path, steps.step, rounding, len(times) - 1), values, []
    rate = _table_rate(path, median_step(times), rounding, 1)
    count = duration * float(rate) + 1
    if count > MAX_FRAMES_PER_ROW * len(times):
        message = f"{len(times)} rows span {count:.3g} frames at {float(rate):g} fps"
        hint = f"{argument('source.fps')} reads each row as a frame"
        raise FormatError(Fault("MOF006", message, path, (), hint))
    frame_times = times[0] + np.arange(int(count + STEP_TOLERANCE)) / float(rate)
    resampled_values = np.stack(
        [np.interp(frame_times, times, column) for column in values.T], axis=-1
    )
    message = f"times are uneven, up to {steps.error:.3g} s off: resampled at "
    message += f"{float(rate):g} fps, linearly between rows"
    hint = f"{argument('source.fps')} reads each row as a frame"
    return (
        rate,
        resampled_values,
        [Fault("MOF105", message, path, (), hint, Severity.WARNING)],
    )


def _table_rate(path: str, step: float, rounding: float, frames: int) -> Fraction:
    rate = rate_of_step(step, rounding, frames)
    if rate is None:
        message = f"has a row every {step:g} s"
        hint = f"set the rate with {argument('source.fps')}"
        raise FormatError(Fault("MOF006", message, path, (), hint))
    return rate


def _build_motion(rig: Rig, columns: list[Coordinate], values: FloatArray) -> Motion:
    coordinates = convert_columns_to_coordinates(rig, columns, values)
    animated_joints = {rig.joints[c.joint_index].name for c in columns}
    local = local_from_coordinates(rig, with_mimics(rig, coordinates, animated_joints))
    return Motion(
        Channel.from_dense(local.translations), Channel.from_dense(local.rotations)
    )
