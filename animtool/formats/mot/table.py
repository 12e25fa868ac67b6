"""Reads the table of an OpenSim motion file: named columns over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
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
from animtool.formats.trajectories import FLOAT32_MAX

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


@dataclass(frozen=True, slots=True)
class MotionTable:
    """Header, times and columns of a motion file."""

    path: Path  # path of the file
    names: tuple[str, ...]  # names of the C columns, without the time
    values: FloatArray  # ``(R, C)``, NaN if a cell is empty or not a finite number
    times: FloatArray  # times of the rows ``(R,)`` [s], ascending
    decimals: int  # largest number of decimals of the times
    lines: IntArray  # 1-based line number of each row ``(R,)``
    degrees: bool | None  # whether angles are degrees; None if not stated
    in_degrees: str  # the value of inDegrees if it is neither yes nor no; else empty
    notices: tuple[Fault, ...]  # warnings about the file


@expects_format("MOF001", "an OpenSim motion file")
def read_table(path: Path) -> MotionTable:
    """Read the table of a MOT or STO file.

    Cells are separated by tabs, semicolons, commas or blanks.
    """
    lines = read_lines(path)
    header = read_header(path, lines)
    names, stated_counts, degrees = header.names, header.counts, header.degrees
    _check_data_type(path, header, lines)
    notices: list[Fault] = []
    rows = read_rows(path, lines, header, len(names) + 1, notices)
    decimals, line_numbers = rows.decimals(0), rows.line_numbers
    values = parse_numbers(path, rows, len(names) + 1)
    counts = {"rows": len(values), "columns": len(names) + 1}
    for noun, count in counts.items():
        if noun in stated_counts and stated_counts[noun] != count:
            message = f"states {stated_counts[noun]:g} {noun}, but has {count}"
            warning = Severity.WARNING
            hint = f"all {noun} are read; correct the header"
            notices.append(Fault("MOF101", message, str(path), (), hint, warning))
    times = values[:, 0].copy()
    check_times(path, times, line_numbers)
    cells = values[:, 1:].copy()
    with np.errstate(invalid="ignore"):
        cells[~(np.abs(cells) <= FLOAT32_MAX)] = np.nan
    notices += _missing_values_warning(path, names, cells, line_numbers)
    return MotionTable(
        path,
        names,
        cells,
        times,
        decimals,
        line_numbers,
        degrees,
        header.in_degrees,
        tuple(notices),
    )


def _table_error(
    code: str, path: Path, message: str, line: int | None = None
) -> FormatError:
    """Return the error of a file, or of one of its lines."""
    lines = () if line is None else (line,)
    return FormatError(Fault(code, message, str(path), lines))


@dataclass(frozen=True, slots=True)
class MotHeader:
    """Header values above the rows."""

    names: tuple[str, ...]  # names of the C columns, without the time
    counts: dict[str, float]  # ``rows`` and ``columns``, and ``rate`` [1/s], if stated
    degrees: bool | None  # whether angles are degrees; None if not stated
    in_degrees: str  # the value of inDegrees if it is neither yes nor no; else empty
    kind: str  # DataType; empty if not stated
    unit: str | None  # Units; None if not stated
    separator: bytes  # separator of cells
    begin: int  # index of the first line below the column names

    @property
    def has_points(self) -> bool:
        """Whether each cell is a vector of three numbers."""
        return self.kind.lower() in {"vec3", "vec<3>"}


def read_header(path: Path, lines: list[bytes]) -> MotHeader:
    """Return the header (MOF001) and column names (MOF002, MOF004)."""
    end_line = _find_header_end(path, lines)
    counts, degrees, texts = _parse_header(lines[:end_line])
    names_line = next(
        (
            i
            for i in range(end_line + 1, len(lines))
            if lines[i].strip(BLANK_CHARACTERS)
        ),
        None,
    )
    if names_line is None:
        raise _table_error("MOF002", path, "ends after its header", end_line + 1)
    separator = find_separator(lines[names_line])
    names = _column_names(path, lines[names_line], separator, names_line + 1)
    kind, unit = texts.get("datatype", ""), texts.get("units")
    in_degrees_text = texts.get("indegrees", "")
    return MotHeader(
        names, counts, degrees, in_degrees_text, kind, unit, separator, names_line + 1
    )


def _find_header_end(path: Path, lines: list[bytes]) -> int:
    """Return the index of the line that ends the header; raise MOF001 without one."""
    for i, line in enumerate(lines[:MAX_HEADER_LINES]):
        if line.strip(BLANK_CHARACTERS).lower() == b"endheader":
            return i
    message = "has no line 'endheader', which ends the header of OpenSim's files"
    raise _table_error("MOF001", path, message)


def _parse_header(
    lines: list[bytes],
) -> tuple[dict[str, float], bool | None, dict[str, str]]:
    """Parse counts, angle unit and texts of a header."""
    counts: dict[str, float] = {}
    texts: dict[str, str] = {}
    degrees = None
    stated_degrees = None
    for line in lines:
        text = decode_text(line).strip(" \t,;").lower()
        key, _, value = (part.strip() for part in text.partition("="))
        if not value:
            # SIMM writes: datarows 250.
            key, _, value = (part.strip() for part in text.partition(" "))
            if key in {"datarows", "datacolumns"}:
                stated_degrees = True  # SIMM files are in degrees
        count_name = {
            "nrows": "rows",
            "datarows": "rows",
            "ncolumns": "columns",
            "datacolumns": "columns",
        }.get(key)
        if count_name and value.isascii() and value.isdigit() and len(value) < 300:
            counts[count_name] = float(value)
        elif key in {"datatype", "units"}:
            texts[key] = decode_text(line).partition("=")[2].strip(" \t,;")
        elif key == "datarate" and (rate := parse_number(value)) is not None:
            counts["rate"] = rate
        elif key == "indegrees":
            degrees = _BOOLEAN_WORDS.get(value, degrees)
            if value not in _BOOLEAN_WORDS:
                texts[key] = decode_text(line).partition("=")[2].strip(" \t,;")
        elif text.startswith("angles are in "):
            units = {"degrees": True, "radians": False}
            stated_degrees = units.get(text[14:].rstrip(". "), stated_degrees)
    return counts, stated_degrees if degrees is None else degrees, texts


def _column_names(
    path: Path, line: bytes, separator: bytes, line_number: int
) -> tuple[str, ...]:
    """Return the names of a line's columns, without the time (MOF002, MOF004)."""
    text = line.strip(BLANK_CHARACTERS if separator == b" " else b" " + separator)
    cells = split_cells(text, separator)
    if cells[0].lower() != "time":
        message = f"the first column is {excerpt(cells[0])}, not time"
        raise _table_error("MOF002", path, message, line_number)
    if len(cells) < 2 or not all(cells):
        problem = "has an unnamed column"
        if len(cells) < 2:
            problem = "has no column besides the time"
        raise _table_error("MOF002", path, problem, line_number)
    if len(cells) - 1 > MAX_COLUMNS:
        message = f"has {len(cells) - 1} columns; the limit is {MAX_COLUMNS}"
        raise _table_error("MOF002", path, message, line_number)
    names = tuple(cells[1:])
    check_duplicates(path, names, names, line_number)
    return names


def check_duplicates(
    path: Path, keys: tuple[object, ...], names: tuple[str, ...], line: int | None
) -> None:
    """Raise for two columns with the same key (MOF004)."""
    first_names: dict[object, str] = {}
    for key, name in zip(keys, names, strict=True):
        if key in first_names:
            both_names = f"{excerpt(first_names[key])} and {excerpt(name)}"
            message = f"{both_names} are the same coordinate"
            if first_names[key] == name:
                message = f"duplicate column {excerpt(name)}"
            raise _table_error("MOF004", path, message, line)
        first_names[key] = name


def _check_data_type(path: Path, header: MotHeader, lines: list[bytes]) -> None:
    """Raise for cells with more than one number, such as quaternions (MOF009)."""
    data_type, names, begin = header.kind, header.names, header.begin
    separator = header.separator
    rows = (i for i in range(begin, len(lines)) if lines[i].strip(BLANK_CHARACTERS))
    row = next(rows, begin - 1)
    cells = split_cells(lines[row], separator)[1:] if row >= begin else []
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
    raise FormatError(Fault("MOF009", message, str(path), (row + 1,), hint))


def parse_numbers(path: Path, rows: TextRows, column_count: int) -> FloatArray:
    """Parse the numbers of rows ``(R, width)`` (MOF003)."""
    return rows.values(
        column_count, lambda text, line: _table_error("MOF003", path, text, line)
    )


def read_rows(
    path: Path,
    lines: list[bytes],
    header: MotHeader,
    column_count: int,
    notices: list[Fault],
) -> TextRows:
    """Return rows of equal width; a truncated last row is dropped (MOF103)."""
    rows = gather_rows(lines, header.begin, header.separator)
    warning = Severity.WARNING
    while len(rows.texts):
        is_bad = rows.value_counts > column_count
        is_bad |= rows.cell_counts < column_count
        if not is_bad.any():
            break
        row = int(is_bad.argmax())
        line = int(rows.line_numbers[row])
        is_short = rows.cell_counts[row] < column_count
        count = int(rows.cell_counts[row] if is_short else rows.value_counts[row])
        message = f"has {count} values instead of {column_count}"
        # The last row of a truncated file has no line end.
        is_last = row == len(rows.texts) - 1 and line == len(lines)
        if not (is_last and is_short and row):
            raise _table_error("MOF003", path, message, line)
        message = f"is truncated: {message}; it is skipped"
        notices.append(Fault("MOF103", message, str(path), (line,), None, warning))
        rows = rows.without_last()
    if not rows.texts:
        raise _table_error("MOF003", path, "has no rows")
    if rows.has_decimal_commas:
        message = "numbers have decimal commas: read as such"
        hint = "export it with decimal points, which other programs need"
        notices.append(Fault("MOF110", message, str(path), (), hint, Severity.NOTE))
    return rows


def check_times(path: Path, times: FloatArray, lines: IntArray) -> None:
    """Raise for times that do not ascend (MOF005)."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_invalid = ~np.isfinite(times)
        is_invalid[1:] |= ~(np.diff(times) > 0)
    if is_invalid.any():
        row = int(np.flatnonzero(is_invalid)[0])
        message = f"time {times[row]:g} does not come after the row before"
        if not np.isfinite(times[row]):
            message = "the time is not a finite number"
        raise _table_error("MOF005", path, message, int(lines[row]))


def _missing_values_warning(
    path: Path, names: tuple[str, ...], values: FloatArray, lines: IntArray
) -> list[Fault]:
    """Return a warning about columns with missing values."""
    is_missing: BoolArray = np.isnan(values)
    columns = np.flatnonzero(is_missing.any(axis=0)).tolist()
    if not columns:
        return []
    count = counted(int(is_missing.sum()), "value")
    message = f"{count} missing in {listed([names[c] for c in columns])}: "
    message += "interpolated, or 0 where a column has no values"
    row = int(lines[np.flatnonzero(is_missing.any(axis=1))[0]])
    return [Fault("MOF104", message, str(path), (row,), None, Severity.WARNING)]
