"""Reads OpenSim tables of vectors (STO, DataType=Vec3) as marker trajectories."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError, counted, listed
from animtool.core.rates import FractionLike
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.delimited import read_lines
from animtool.formats.mot.table import (
    MotHeader,
    check_times,
    parse_numbers,
    read_header,
    read_rows,
    table_rate,
)
from animtool.formats.row_times import (
    MAX_FRAME_NUMBER,
    RowFrames,
    choose_frame_fit,
    has_few_empty_frames,
    matches_rate,
    rounding_error,
)
from animtool.formats.trajectories import CaptureFile
from animtool.motion.markers import Markers


def holds_points(path: Path) -> bool:
    """Return whether a file is an OpenSim table of vectors that can be read."""
    try:
        return read_header(CaptureFile(str(path)), read_lines(path)).has_points
    except AnimtoolError:
        return False


def read_points(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the vectors of a table as markers; NaN means not visible.

    Time 0 is frame 1. Frames without a row have no position; rows at irregular times
    are resampled linearly.

    Args:
        path: The file.
        unit: Unit of the lengths; None is the stated unit, or metres.
        up: The up axis; None is Y.
        fps: Rows per second, if the times are wrong.
        subject: Subject whose prefix is removed from names, as in `read_c3d`.
    """
    path = Path(path)
    file = CaptureFile(str(path))
    lines = read_lines(path)
    header = read_header(file, lines)
    if not header.has_points:
        message = f"has DataType {header.data_type or 'double'}, but markers are Vec3"
        raise file.error("MOF009", message)
    column_count = 1 + 3 * len(header.names)
    if header.separator != b",":
        row_lines = lines[header.first_row_index :]
        lines[header.first_row_index :] = [
            line.replace(b",", b"\t") for line in row_lines
        ]
    rows = read_rows(file, lines, header, column_count)
    values = parse_numbers(file, rows, column_count)
    message = f"{counted(len(header.names), 'column')} of vectors are read as positions"
    hint = "forces and other vectors are not markers"
    file.note("MOF111", f"{message}: {listed(list(header.names[:3]))}", hint)
    length_unit = file.choose_unit(header.unit, unit, LengthUnit.M)
    names, up_axis = file.unique_names(header.names, subject), file.choose_up(None, up)
    positions = values[:, 1:].reshape(len(values), -1, 3).copy()
    positions = file.clean_positions(positions, length_unit.meters)
    times = values[:, 0]
    check_times(file, times, rows.line_numbers)
    row_frames = _find_row_frames(
        file, header, times, rounding_error(rows.decimals(0)), fps
    )
    return row_frames.build_markers(file, names, positions, up_axis)


def _find_row_frames(
    file: CaptureFile,
    header: MotHeader,
    times: FloatArray,
    rounding: float,
    fps: FractionLike | None,
) -> RowFrames:
    """Return the frames of the rows; warn about uneven times and gaps."""
    stated_rate, row_count = header.stated_numbers.get("rate"), len(times)
    if fps is not None or row_count == 1:
        rate, frames = (
            file.choose_rate(stated_rate, fps),
            np.arange(row_count, dtype=np.float64),
        )
        return _build_row_frames(times, rate, frames, rounding)
    fit = choose_frame_fit(times, None, stated_rate, rounding)
    step_count = int(fit.frames[-1]) if fit.is_regular else 1
    rate = table_rate(file, fit.step, rounding, step_count)
    if stated_rate is not None and matches_rate(fit, stated_rate, rounding):
        rate = file.choose_rate(stated_rate, None)
    elif stated_rate is not None:
        message = f"states DataRate {stated_rate:g}, but its times are at "
        message += f"{float(rate):g}"
        file.warn("MOF101", f"{message} fps: using the times")
    with np.errstate(over="ignore"):
        frames = (times - times[0]) * float(rate)
    if fit.is_regular:
        frames = fit.frames.astype(np.float64)
    if not has_few_empty_frames(frames, len(header.names)):
        message = f"{row_count} rows span {float(frames[-1]) + 1:.3g} frames"
        hint = f"{argument('source.fps')} reads each row as a frame"
        raise file.error("MOF006", message, hint)
    if not fit.is_regular:
        message = f"times are uneven: resampled at {float(rate):g} fps, linearly "
        file.warn("MOF105", f"{message}between rows, but not over gaps")
    elif (missing_count := int(frames[-1]) + 1 - row_count) > 0:
        message = f"{counted(missing_count, 'frame')} without a row; markers have no "
        message += "positions there"
        file.warn("MOF105", message)
    return _build_row_frames(times, rate, frames, rounding)


def _build_row_frames(
    times: FloatArray, rate: Fraction, frames: FloatArray, rounding: float
) -> RowFrames:
    frame_position = float(times[0]) * float(rate)
    start = round(frame_position) + 1 if abs(frame_position) < MAX_FRAME_NUMBER else 1
    is_exact = abs(frame_position - (start - 1)) <= 3 * rounding * float(rate)
    return RowFrames(rate, start, frames, None if is_exact else float(times[0]))
