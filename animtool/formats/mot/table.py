"""The table of an OpenSim motion file: named columns over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.files.signatures import expects
from animtool.core.record import dataclass
from animtool.formats.delimited import (
    BLANK,
    TextRows,
    decoded,
    gather_rows,
    number_of,
    read_lines,
    separator_of,
    split_cells,
)

# Headers of OpenSim hold some ten lines; those of results a page of remarks.
MAX_HEADER_LINES = 1000
MAX_COLUMNS = 10_000
FLOAT32_MAX = float(np.finfo(np.float32).max)
# Types of OpenSim's tables with one number in a cell.
_NUMBERS = {"", "double", "float", "real"}
_KINDS = {
    "quaternion": "orientations (w, x, y, z)",
    "vec": "vectors",
    "unitvec": "directions",
    "spatialvec": "rotations and translations",
    "spatial": "rotations and translations",
}
_IMU = (
    "OpenSim's IMU inverse kinematics turns orientations of sensors into "
    "coordinates: opensim-cmd run-tool imu_ik.xml; its MOT is read"
)
_POINTS = "animtool convert writes them as markers: .trc, .c3d or .npz"
_HINTS = {"quaternion": _IMU, "vec3": _POINTS}
_YES = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}


@dataclass(frozen=True, slots=True)
class MotionTable:
    """Header, times and columns of a motion file.

    Attributes:
        path: The file.
        names: Of the C columns, the time left out.
        values: ``(R, C)``, NaN where a cell is empty or no finite number.
        times: Of the rows ``(R,)`` [s], ascending.
        decimals: Places after the point of the times, at most.
        lines: Line of each row ``(R,)``, from 1.
        degrees: Whether angles are degrees; None where the file does not say.
        in_degrees: The value of inDegrees if it is neither yes nor no; else empty.
        notices: Warnings about the file.
    """

    path: Path
    names: tuple[str, ...]
    values: FloatArray
    times: FloatArray
    decimals: int
    lines: IntArray
    degrees: bool | None
    in_degrees: str
    notices: tuple[Fault, ...]


@expects("MOF001", "an OpenSim motion file")
def read_table(path: Path) -> MotionTable:
    """Read the table of a MOT or STO file.

    Cells are separated by tabs, semicolons, commas or blanks.

    Raises:
        FormatError: The file has no header (MOF001), no names of columns (MOF002), a
            row that is none (MOF003), a column twice (MOF004), or times that do not
            ascend (MOF005), or cannot be read.
    """
    lines = read_lines(path)
    header = read_header(path, lines)
    names, stated, degrees = header.names, header.counts, header.degrees
    _check_kind(path, header, lines)
    notices: list[Fault] = []
    rows = read_rows(path, lines, header, len(names) + 1, notices)
    decimals, numbers = rows.decimals(0), rows.lines
    values = numbers_of(path, rows, len(names) + 1)
    counts = {"rows": len(values), "columns": len(names) + 1}
    for what, count in counts.items():
        if what in stated and stated[what] != count:
            message = f"states {stated[what]:g} {what}, but has {count}"
            warning = Severity.WARNING
            notices.append(Fault("MOF101", message, str(path), (), None, warning))
    times = values[:, 0].copy()
    check_times(path, times, numbers)
    cells = values[:, 1:].copy()
    with np.errstate(invalid="ignore"):
        cells[~(np.abs(cells) <= FLOAT32_MAX)] = np.nan
    notices += _missing(path, names, cells, numbers)
    return MotionTable(
        path,
        names,
        cells,
        times,
        decimals,
        numbers,
        degrees,
        header.in_degrees,
        tuple(notices),
    )


def _error(code: str, path: Path, message: str, line: int | None = None) -> FormatError:
    lines = () if line is None else (line,)
    return FormatError(Fault(code, message, str(path), lines))


@dataclass(frozen=True, slots=True)
class MotHeader:
    """Header values above the rows.

    Attributes:
        names: Of the C columns, the time left out.
        counts: ``rows`` and ``columns``, and ``rate`` [1/s], where they are stated.
        degrees: Whether angles are degrees; None where the file does not say.
        in_degrees: The value of inDegrees if it is neither yes nor no; else empty.
        kind: DataType, empty without.
        unit: Units, None without.
        separator: Between cells.
        begin: Index of the first line below the names.
    """

    names: tuple[str, ...]
    counts: dict[str, float]
    degrees: bool | None
    in_degrees: str
    kind: str
    unit: str | None
    separator: bytes
    begin: int

    @property
    def has_points(self) -> bool:
        """Whether a cell is a vector of three."""
        return self.kind.lower() in {"vec3", "vec<3>"}


def read_header(path: Path, lines: list[bytes]) -> MotHeader:
    """Return the header (MOF001) and column names (MOF002, MOF004)."""
    at = _end_of_header(path, lines)
    counts, degrees, texts = _header(lines[:at])
    head = next((i for i in range(at + 1, len(lines)) if lines[i].strip(BLANK)), None)
    if head is None:
        raise _error("MOF002", path, "ends after its header", at + 1)
    separator = separator_of(lines[head])
    names = _names(path, lines[head], separator, head + 1)
    kind, unit = texts.get("datatype", ""), texts.get("units")
    stated = texts.get("indegrees", "")
    return MotHeader(names, counts, degrees, stated, kind, unit, separator, head + 1)


def _end_of_header(path: Path, lines: list[bytes]) -> int:
    for i, line in enumerate(lines[:MAX_HEADER_LINES]):
        if line.strip(BLANK).lower() == b"endheader":
            return i
    message = "has no line 'endheader', which ends the header of OpenSim's files"
    raise _error("MOF001", path, message)


def _header(
    lines: list[bytes],
) -> tuple[dict[str, float], bool | None, dict[str, str]]:
    """Parse counts, angle unit and texts of a header."""
    counts: dict[str, float] = {}
    texts: dict[str, str] = {}
    degrees = None
    said = None
    for line in lines:
        text = decoded(line).strip(" \t,;").lower()
        key, _, value = (part.strip() for part in text.partition("="))
        if not value:
            # As SIMM writes: datarows 250.
            key, _, value = (part.strip() for part in text.partition(" "))
            # SIMM files are in degrees.
            said = True if key in {"datarows", "datacolumns"} else said
        what = {
            "nrows": "rows",
            "datarows": "rows",
            "ncolumns": "columns",
            "datacolumns": "columns",
        }.get(key)
        if what and value.isascii() and value.isdigit() and len(value) < 300:
            counts[what] = float(value)
        elif key in {"datatype", "units"}:
            texts[key] = decoded(line).partition("=")[2].strip(" \t,;")
        elif key == "datarate" and (rate := number_of(value)) is not None:
            counts["rate"] = rate
        elif key == "indegrees":
            degrees = _YES.get(value, degrees)
            if value not in _YES:
                texts[key] = decoded(line).partition("=")[2].strip(" \t,;")
        elif text.startswith("angles are in "):
            said = {"degrees": True, "radians": False}.get(text[14:].rstrip(". "), said)
    return counts, said if degrees is None else degrees, texts


def _names(path: Path, line: bytes, separator: bytes, number: int) -> tuple[str, ...]:
    text = line.strip(BLANK if separator == b" " else b" " + separator)
    cells = split_cells(text, separator)
    if cells[0].lower() != "time":
        message = f"the first column is {excerpt(cells[0])}, not time"
        raise _error("MOF002", path, message, number)
    if len(cells) < 2 or not all(cells):
        what = (
            "has no column besides the time"
            if len(cells) < 2
            else "has an unnamed column"
        )
        raise _error("MOF002", path, what, number)
    if len(cells) - 1 > MAX_COLUMNS:
        message = f"has {len(cells) - 1} columns; the limit is {MAX_COLUMNS}"
        raise _error("MOF002", path, message, number)
    names = tuple(cells[1:])
    check_once(path, names, names, number)
    return names


def check_once(
    path: Path, keys: tuple[object, ...], names: tuple[str, ...], line: int | None
) -> None:
    """Raise for two columns with the same key (MOF004)."""
    first: dict[object, str] = {}
    for key, name in zip(keys, names, strict=True):
        if key in first:
            two = f"{excerpt(first[key])} and {excerpt(name)}"
            what = f"duplicate column {excerpt(name)}"
            message = what if first[key] == name else f"{two} are the same coordinate"
            raise _error("MOF004", path, message, line)
        first[key] = name


def _check_kind(path: Path, header: MotHeader, lines: list[bytes]) -> None:
    """Raise for cells with several numbers (MOF009): vectors, quaternions."""
    kind, names, begin = header.kind, header.names, header.begin
    separator = header.separator
    row = next(
        (i for i in range(begin, len(lines)) if lines[i].strip(BLANK)), begin - 1
    )
    cells = split_cells(lines[row], separator)[1:] if row >= begin else []
    width = max((cell.count(",") + 1 for cell in cells), default=1)
    decimal = width == 2 and b"." not in lines[row]
    if kind.lower() in _NUMBERS and (width == 1 or separator == b"," or decimal):
        return
    what = f"DataType {excerpt(kind)}" if kind else "no DataType"
    columns = counted(len(names), "column")
    message = f"has {what}: {columns} of {width} numbers in a cell"
    shown = _KINDS.get(kind.lower().partition("<")[0].rstrip("0123456789_"))
    message += f" ({shown})" if shown else ""
    message += f", {listed(list(names[:3]))}"
    hint = _HINTS.get(kind.lower(), "MOT and STO are read with one number in a cell")
    raise FormatError(Fault("MOF009", message, str(path), (row + 1,), hint))


def numbers_of(path: Path, rows: TextRows, width: int) -> FloatArray:
    """Parse the numbers of rows ``(R, width)`` (MOF003)."""
    return rows.values(width, lambda text, line: _error("MOF003", path, text, line))


def read_rows(
    path: Path,
    lines: list[bytes],
    header: MotHeader,
    width: int,
    notices: list[Fault],
) -> TextRows:
    """Return rows of equal width; a truncated last row is dropped (MOF103)."""
    rows = gather_rows(lines, header.begin, header.separator)
    warning = Severity.WARNING
    while len(rows.texts):
        wrong = np.flatnonzero((rows.filled > width) | (rows.cells < width))
        if not len(wrong):
            break
        row = int(wrong[0])
        line, short = int(rows.lines[row]), rows.cells[row] < width
        count = int(rows.cells[row] if short else rows.filled[row])
        message = f"has {count} values instead of {width}"
        # The last row of a truncated file has no line end.
        last = row == len(rows.texts) - 1 and line == len(lines)
        if not (last and short and row):
            raise _error("MOF003", path, message, line)
        message = f"is truncated: {message}; it is skipped"
        notices.append(Fault("MOF103", message, str(path), (line,), None, warning))
        rows = rows.without_last()
    if not rows.texts:
        raise _error("MOF003", path, "has no rows")
    if rows.decimal_commas:
        message = "numbers have decimal commas: read as such"
        hint = "export it with decimal points, which other programs need"
        notices.append(Fault("MOF110", message, str(path), (), hint, Severity.NOTE))
    return rows


def check_times(path: Path, times: FloatArray, lines: IntArray) -> None:
    """Raise for times that do not ascend (MOF005)."""
    with np.errstate(invalid="ignore", over="ignore"):
        wrong = ~np.isfinite(times)
        wrong[1:] |= ~(np.diff(times) > 0)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        message = f"time {times[row]:g} does not come after the row before"
        if not np.isfinite(times[row]):
            message = "the time is not a finite number"
        raise _error("MOF005", path, message, int(lines[row]))


def _missing(
    path: Path, names: tuple[str, ...], values: FloatArray, lines: IntArray
) -> list[Fault]:
    """Return a warning about columns with missing values."""
    missing: BoolArray = np.isnan(values)
    columns = np.flatnonzero(missing.any(axis=0)).tolist()
    if not columns:
        return []
    count = counted(int(missing.sum()), "value")
    message = (
        f"{count} missing in {listed([names[c] for c in columns])}: interpolated, or "
        "0 where a column has no values"
    )
    row = int(lines[np.flatnonzero(missing.any(axis=1))[0]])
    return [Fault("MOF104", message, str(path), (row,), None, Severity.WARNING)]
