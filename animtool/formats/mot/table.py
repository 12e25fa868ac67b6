"""Reads the table of an OpenSim motion file: named columns over time."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted, excerpt, listed
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.delimited import (
    BLANK_CHARACTERS,
    TextRows,
    decode_text,
    find_separator,
    gather_rows,
    parse_number,
    read_lines,
    split_cells,
)
from animtool.formats.row_times import rate_of_step
from animtool.formats.trajectories import CaptureFile

# OpenSim headers have about ten lines; those of results may have a page of remarks.
MAX_HEADER_LINES = 1000
MAX_COLUMNS = 10_000
# OpenSim data types with one number per cell.
_NUMBER_TYPES = {"", "double", "float", "real"}
_UNSUPPORTED_TYPES = {
    "quaternion": "orientations (w, x, y, z)",
    "vec": "vectors",
    "unitvec": "directions",
    "spatialvec": "rotations and translations",
    "spatial": "rotations and translations",
}
_IMU_HINT = "OpenSim's IMU inverse kinematics turns orientations of sensors into "
_IMU_HINT += "coordinates: opensim-cmd run-tool imu_ik.xml; its MOT is read"
_POINTS_HINT = "animtool convert writes them as markers: .trc, .c3d or .npz"
_TYPE_HINTS = {"quaternion": _IMU_HINT, "vec3": _POINTS_HINT}
_BOOLEAN_WORDS = {
    "yes": True,
    "true": True,
    "1": True,
    "no": False,
    "false": False,
    "0": False,
}

# Header keys of numbers of rows and columns, also those of SIMM.
_NOUN_BY_COUNT_KEY = {
    "nrows": "rows",
    "datarows": "rows",
    "ncolumns": "columns",
    "datacolumns": "columns",
}


@dataclass(frozen=True, slots=True)
class MotHeader:
    """Values that the header of a MOT or STO file states, and its column names."""

    names: tuple[str, ...]  # names of the C columns, without the time
    # Stated numbers of ``rows`` and ``columns``, and the ``rate`` [1/s].
    stated_numbers: dict[str, float]
    in_degrees: bool | None  # whether angles are degrees; None if not stated
    # The value of inDegrees if it is neither yes nor no; else empty.
    invalid_in_degrees: str
    data_type: str  # DataType; empty if not stated
    unit: str | None  # Units; None if not stated
    separator: bytes  # separator of cells
    first_row_index: int  # index of the first line below the column names

    @property
    def has_points(self) -> bool:
        """Whether each cell is a vector of three numbers."""
        return self.data_type.lower() in {"vec3", "vec<3>"}


@dataclass(frozen=True, slots=True)
class MotionTable:
    """Times and columns of a motion file."""

    file: CaptureFile  # the file, with warnings
    header: MotHeader  # names of the C columns, and the unit of angles
    values: FloatArray  # ``(R, C)``, NaN if a cell is empty or not a finite number
    times: FloatArray  # times of the rows ``(R,)`` [s], ascending
    time_decimals: int  # largest number of decimals of the times
    line_numbers: IntArray  # lines of the rows ``(R,)``


@expects_format("MOF001", "an OpenSim motion file")
def read_table(path: Path) -> MotionTable:
    """Return the header, times and values of a MOT or STO file, checked.

    Cells are separated by tabs, semicolons, commas or blanks.
    """
    file, lines = CaptureFile(str(path)), read_lines(path)
    header = read_header(file, lines)
    _check_data_type(file, header, lines)
    column_count = len(header.names) + 1
    rows = read_rows(file, lines, header, column_count)
    time_decimals = rows.decimals(0)
    values = parse_numbers(file, rows, column_count)
    for noun, count in (("rows", len(values)), ("columns", column_count)):
        if header.stated_numbers.get(noun, count) != count:
            message = f"states {header.stated_numbers[noun]:g} {noun}, but has {count}"
            file.warn("MOF101", message, f"all {noun} are read; correct the header")
    times = values[:, 0].copy()
    check_times(file, times, rows.line_numbers)
    cells = values[:, 1:].copy()
    with np.errstate(invalid="ignore"):
        cells[~(np.abs(cells) <= FLOAT32_MAX)] = np.nan
    _warn_missing_values(file, header.names, cells, rows.line_numbers)
    return MotionTable(file, header, cells, times, time_decimals, rows.line_numbers)


def read_header(file: CaptureFile, lines: list[bytes]) -> MotHeader:
    """Return the header (MOF001) and column names (MOF002, MOF004)."""
    stripped_lines = [line.strip(BLANK_CHARACTERS) for line in lines[:MAX_HEADER_LINES]]
    header_end = next(
        (i for i, line in enumerate(stripped_lines) if line.lower() == b"endheader"),
        None,
    )
    if header_end is None:
        message = "has no line 'endheader', which ends the header of OpenSim's files"
        raise file.error("MOF001", message)
    indices_below = range(header_end + 1, len(lines))
    names_index = next(
        (i for i in indices_below if lines[i].strip(BLANK_CHARACTERS)), None
    )
    if names_index is None:
        raise file.error("MOF002", "ends after its header", line=header_end + 1)
    separator = find_separator(lines[names_index])
    names = _column_names(file, lines[names_index], separator, names_index + 1)
    stated_numbers, in_degrees, stated_texts = _parse_header(lines[:header_end])
    return MotHeader(
        names,
        stated_numbers,
        in_degrees,
        stated_texts.get("indegrees", ""),
        stated_texts.get("datatype", ""),
        stated_texts.get("units"),
        separator,
        names_index + 1,
    )


def _parse_header(
    lines: list[bytes],
) -> tuple[dict[str, float], bool | None, dict[str, str]]:
    """Return a header's numbers, whether its angles are degrees, and its texts."""
    stated_numbers: dict[str, float] = {}
    stated_texts: dict[str, str] = {}
    in_degrees: bool | None = None
    default_in_degrees: bool | None = None  # stated by other lines than inDegrees
    for line in lines:
        text = decode_text(line).strip(" \t,;").lower()
        key, _, value = (part.strip() for part in text.partition("="))
        if not value:
            # SIMM writes: datarows 250.
            key, _, value = (part.strip() for part in text.partition(" "))
            if key in {"datarows", "datacolumns"}:
                default_in_degrees = True  # SIMM files are in degrees
        noun = _NOUN_BY_COUNT_KEY.get(key)
        if noun and value.isascii() and value.isdigit() and len(value) < 300:
            stated_numbers[noun] = float(value)
        elif key in {"datatype", "units"}:
            stated_texts[key] = decode_text(line).partition("=")[2].strip(" \t,;")
        elif key == "datarate" and (rate := parse_number(value)) is not None:
            stated_numbers["rate"] = rate
        elif key == "indegrees":
            in_degrees = _BOOLEAN_WORDS.get(value, in_degrees)
            if value not in _BOOLEAN_WORDS:
                stated_texts[key] = decode_text(line).partition("=")[2].strip(" \t,;")
        elif text.startswith("angles are in "):
            is_degrees_by_unit = {"degrees": True, "radians": False}
            default_in_degrees = is_degrees_by_unit.get(
                text[14:].rstrip(". "), default_in_degrees
            )
    if in_degrees is None:
        in_degrees = default_in_degrees
    return stated_numbers, in_degrees, stated_texts


def _column_names(
    file: CaptureFile, line: bytes, separator: bytes, line_number: int
) -> tuple[str, ...]:
    """Return the names of a line's columns, without the time (MOF002, MOF004)."""
    text = line.strip(BLANK_CHARACTERS if separator == b" " else b" " + separator)
    cells = split_cells(text, separator)
    if cells[0].lower() != "time":
        message = f"the first column is {excerpt(cells[0])}, not time"
        raise file.error("MOF002", message, line=line_number)
    if len(cells) < 2 or not all(cells):
        message = "has an unnamed column"
        if len(cells) < 2:
            message = "has no column besides the time"
        raise file.error("MOF002", message, line=line_number)
    if len(cells) - 1 > MAX_COLUMNS:
        message = f"has {len(cells) - 1} columns; the limit is {MAX_COLUMNS}"
        raise file.error("MOF002", message, line=line_number)
    names = tuple(cells[1:])
    check_duplicates(file, names, names, line_number)
    return names


def check_duplicates(
    file: CaptureFile,
    keys: Sequence[object],
    names: Sequence[str],
    line: int | None = None,
) -> None:
    """Raise if two columns have the same key (MOF004)."""
    first_names: dict[object, str] = {}
    for key, name in zip(keys, names, strict=True):
        if key in first_names:
            both_names = f"{excerpt(first_names[key])} and {excerpt(name)}"
            message = f"{both_names} are the same coordinate"
            if first_names[key] == name:
                message = f"duplicate column {excerpt(name)}"
            raise file.error("MOF004", message, line=line)
        first_names[key] = name


def _check_data_type(file: CaptureFile, header: MotHeader, lines: list[bytes]) -> None:
    """Raise if cells have more than one number, such as quaternions (MOF009)."""
    data_type, names, first_row_index = (
        header.data_type,
        header.names,
        header.first_row_index,
    )
    separator = header.separator
    indices = (
        i
        for i in range(first_row_index, len(lines))
        if lines[i].strip(BLANK_CHARACTERS)
    )
    row = next(indices, first_row_index - 1)
    cells = split_cells(lines[row], separator)[1:] if row >= first_row_index else []
    numbers_per_cell = max((cell.count(",") + 1 for cell in cells), default=1)
    has_decimal_commas = numbers_per_cell == 2 and b"." not in lines[row]
    has_numbers = numbers_per_cell == 1 or separator == b"," or has_decimal_commas
    if has_numbers and data_type.lower() in _NUMBER_TYPES:
        return
    stated_type = f"DataType {excerpt(data_type)}" if data_type else "no DataType"
    columns = counted(len(names), "column")
    message = f"has {stated_type}: {columns} of {numbers_per_cell} numbers in a cell"
    base_type = data_type.lower().partition("<")[0].rstrip("0123456789_")
    type_label = _UNSUPPORTED_TYPES.get(base_type)
    message += f" ({type_label})" if type_label else ""
    message += f", {listed(list(names[:3]))}"
    default_hint = "MOT and STO are read with one number in a cell"
    hint = _TYPE_HINTS.get(data_type.lower(), default_hint)
    raise file.error("MOF009", message, hint, row + 1)


def parse_numbers(file: CaptureFile, rows: TextRows, column_count: int) -> FloatArray:
    """Parse the numbers of rows ``(R, column_count)`` (MOF003)."""
    return rows.values(
        column_count, lambda text, line: file.error("MOF003", text, line=line)
    )


def read_rows(
    file: CaptureFile, lines: list[bytes], header: MotHeader, column_count: int
) -> TextRows:
    """Return rows of equal width; a truncated last row is dropped (MOF103)."""
    rows = gather_rows(lines, header.first_row_index, header.separator)
    while len(rows.texts):
        is_invalid = rows.value_counts > column_count
        is_invalid |= rows.cell_counts < column_count
        if not is_invalid.any():
            break
        row = int(is_invalid.argmax())
        line = int(rows.line_numbers[row])
        is_short = rows.cell_counts[row] < column_count
        count = int(rows.cell_counts[row] if is_short else rows.value_counts[row])
        message = f"has {count} values instead of {column_count}"
        # The last row of a truncated file has no line end.
        is_last = row == len(rows.texts) - 1 and line == len(lines)
        if not (is_last and is_short and row):
            raise file.error("MOF003", message, line=line)
        message = f"is truncated: {message}; it is skipped"
        file.warn("MOF103", message, None, line)
        rows = rows.without_last()
    if not rows.texts:
        raise file.error("MOF003", "has no rows")
    if rows.has_decimal_commas:
        message = "numbers have decimal commas: read as such"
        hint = "export it with decimal points, which other programs need"
        file.note("MOF110", message, hint)
    return rows


def check_times(file: CaptureFile, times: FloatArray, line_numbers: IntArray) -> None:
    """Raise if the times do not ascend (MOF005)."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_invalid = ~np.isfinite(times)
        is_invalid[1:] |= ~(np.diff(times) > 0)
    if is_invalid.any():
        row = int(np.flatnonzero(is_invalid)[0])
        message = f"time {times[row]:g} does not come after the row before"
        if not np.isfinite(times[row]):
            message = "the time is not a finite number"
        raise file.error("MOF005", message, None, int(line_numbers[row]))


def table_rate(
    file: CaptureFile, step: float, rounding: float, step_count: int
) -> Fraction:
    """Return the rate of rows with a step [s]; raise if there is none (MOF006).

    ``step_count`` is the number of steps between the two times it was measured from.
    """
    rate = rate_of_step(step, rounding, step_count)
    if rate is None:
        message = f"has a row every {step:g} s"
        hint = f"set the rate with {argument('source.fps')}"
        raise file.error("MOF006", message, hint)
    return rate


def _warn_missing_values(
    file: CaptureFile, names: Sequence[str], values: FloatArray, line_numbers: IntArray
) -> None:
    """Warn about columns with missing values (MOF104)."""
    is_missing = np.isnan(values)
    incomplete_columns = np.flatnonzero(is_missing.any(axis=0)).tolist()
    if not incomplete_columns:
        return
    count_text = counted(int(is_missing.sum()), "value")
    message = (
        f"{count_text} missing in {listed([names[c] for c in incomplete_columns])}: "
    )
    message += "interpolated, or 0 where a column has no values"
    first_row_index = np.flatnonzero(is_missing.any(axis=1))[0]
    file.warn("MOF104", message, None, int(line_numbers[first_row_index]))
