"""The table of an OpenSim motion file: columns with names over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.files import MAX_INPUT_BYTES, read_input

# Headers of OpenSim hold some ten lines; those of results a page of remarks.
MAX_HEADER_LINES = 1000
MAX_COLUMNS = 10_000
FLOAT32_MAX = float(np.finfo(np.float32).max)
_BLANK = b" \t,"
_YES = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}


@dataclass(frozen=True, slots=True)
class MotionTable:
    """What a motion file holds.

    Attributes:
        path: The file.
        names: Of the C columns, the time left out.
        values: ``(R, C)``, NaN where a cell is empty or no finite number.
        times: Of the rows ``(R,)`` [s], ascending.
        decimals: Places after the point of the times, at most.
        lines: Line of each row ``(R,)``, from 1.
        degrees: Whether angles are degrees; None where the file does not say.
        notices: What is odd.
    """

    path: Path
    names: tuple[str, ...]
    values: FloatArray
    times: FloatArray
    decimals: int
    lines: IntArray
    degrees: bool | None
    notices: tuple[Fault, ...]


def read_table(path: Path) -> MotionTable:
    """Return the table of a MOT or STO file.

    Cells are separated by tabs, blanks or commas.

    Raises:
        FormatError: The file has no header (MOF001), no names of columns (MOF002), a
            row that is none (MOF003), a column twice (MOF004), or times that do not
            ascend (MOF005), or cannot be read.
    """
    text = read_input(path, MAX_INPUT_BYTES).removeprefix(b"\xef\xbb\xbf")
    lines = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    at = _end_of_header(path, lines)
    stated, degrees = _header(lines[:at])
    head = next((i for i in range(at + 1, len(lines)) if lines[i].strip(_BLANK)), None)
    if head is None:
        raise _error("MOF002", path, "ends with its header", at + 1)
    separator = next((s for s in (b"\t", b",") if s in lines[head]), b" ")
    names = _names(path, lines[head], separator, head + 1)
    rows = _Rows(path, separator, len(names) + 1, lines[-1] != b"")
    for i in range(head + 1, len(lines)):
        if lines[i].strip(_BLANK):
            rows.add(lines[i], i + 1, last=i == len(lines) - 1)
    values, numbers = rows.numbers()
    notices = list(rows.notices)
    wanted = {"rows": len(values), "columns": len(names) + 1}
    for what, count in wanted.items():
        if what in stated and stated[what] != count:
            message = f"states {stated[what]:g} {what} and has {count}"
            warning = Severity.WARNING
            notices.append(Fault("MOF101", message, str(path), (), None, warning))
    times = values[:, 0].copy()
    _check_times(path, times, numbers)
    cells = values[:, 1:].copy()
    with np.errstate(invalid="ignore"):
        cells[~(np.abs(cells) <= FLOAT32_MAX)] = np.nan
    notices += _missing(path, names, cells, numbers)
    return MotionTable(
        path, names, cells, times, rows.decimals, numbers, degrees, tuple(notices)
    )


def _error(code: str, path: Path, message: str, line: int | None = None) -> FormatError:
    lines = () if line is None else (line,)
    return FormatError(Fault(code, message, str(path), lines))


def _end_of_header(path: Path, lines: list[bytes]) -> int:
    for i, line in enumerate(lines[:MAX_HEADER_LINES]):
        if line.strip(_BLANK).lower() == b"endheader":
            return i
    message = "has no line 'endheader', which ends the header of OpenSim's files"
    raise _error("MOF001", path, message)


def _header(lines: list[bytes]) -> tuple[dict[str, float], bool | None]:
    """Return the counts that a header states, and whether angles are degrees."""
    counts: dict[str, float] = {}
    degrees = None
    said = None
    for line in lines:
        text = line.decode("utf-8", "replace").strip(" \t,").lower()
        key, _, value = (part.strip() for part in text.partition("="))
        if not value:
            # As SIMM writes: datarows 250.
            key, _, value = (part.strip() for part in text.partition(" "))
            # Which has degrees.
            said = True if key in {"datarows", "datacolumns"} else said
        what = {
            "nrows": "rows",
            "datarows": "rows",
            "ncolumns": "columns",
            "datacolumns": "columns",
        }.get(key)
        if what and value.isascii() and value.isdigit() and len(value) < 300:
            counts[what] = float(value)
        elif key == "indegrees":
            degrees = _YES.get(value, degrees)
        elif text.startswith("angles are in "):
            said = {"degrees": True, "radians": False}.get(text[14:].rstrip(". "), said)
    return counts, said if degrees is None else degrees


def _names(path: Path, line: bytes, separator: bytes, number: int) -> tuple[str, ...]:
    text = line.strip(_BLANK if separator == b" " else b" " + separator)
    parts = text.split() if separator == b" " else text.split(separator)
    cells = [cell.strip().decode("utf-8", "replace") for cell in parts]
    if cells[0].lower() != "time":
        message = f"the first column is {excerpt(cells[0])}, not time"
        raise _error("MOF002", path, message, number)
    if len(cells) < 2 or not all(cells):
        what = (
            "has no column but the time" if len(cells) < 2 else "has an unnamed column"
        )
        raise _error("MOF002", path, what, number)
    if len(cells) - 1 > MAX_COLUMNS:
        message = f"has {len(cells) - 1} columns, and {MAX_COLUMNS} are read"
        raise _error("MOF002", path, message, number)
    names = tuple(cells[1:])
    check_once(path, names, names, number)
    return names


def check_once(
    path: Path, keys: tuple[object, ...], names: tuple[str, ...], line: int | None
) -> None:
    """Refuse columns of which two have the same key (MOF004)."""
    first: dict[object, str] = {}
    for key, name in zip(keys, names, strict=True):
        if key in first:
            two = f"{excerpt(first[key])} and {excerpt(name)}"
            what = f"{excerpt(name)} stands twice"
            message = what if first[key] == name else f"{two} are the same coordinate"
            raise _error("MOF004", path, message, line)
        first[key] = name


class _Rows:
    """Lines of numbers as they are gathered."""

    def __init__(self, path: Path, separator: bytes, width: int, unended: bool) -> None:
        self.notices: list[Fault] = []
        self.decimals = 0
        self._path = path
        self._separator = separator
        self._width = width
        self._unended = unended
        self._lines: list[bytes] = []
        self._numbers: list[int] = []

    def add(self, line: bytes, number: int, *, last: bool) -> None:
        """Take a line, empty cells as NaN; one that the file's end cuts is left out."""
        if self._separator == b" ":
            cells = line.split()
        else:
            cells = line.strip(b" ").split(self._separator)
            while len(cells) > self._width and not cells[-1].strip():
                cells.pop()
            if (
                self._separator * 2 in line
                or b" " in line
                or not (cells[0] and cells[-1])
            ):
                cells = [cell.strip() or b"nan" for cell in cells]
        if len(cells) != self._width:
            message = f"has {len(cells)} values and not {self._width}"
            if last and self._unended and len(cells) < self._width and self._lines:
                message = f"is cut short: {message}; it is left out"
                path, warning = str(self._path), Severity.WARNING
                self.notices.append(
                    Fault("MOF103", message, path, (number,), None, warning)
                )
                return
            raise _error("MOF003", self._path, message, number)
        places = len(cells[0].partition(b".")[2])
        exact = b"e" in cells[0].lower()
        self.decimals = max(self.decimals, 15 if exact else places)
        self._lines.append(b" ".join(cells))
        self._numbers.append(number)

    def numbers(self) -> tuple[FloatArray, IntArray]:
        """Return the rows ``(R, 1 + C)`` and the line of each ``(R,)``."""
        if not self._lines:
            raise _error("MOF003", self._path, "has no rows")
        text = b"\n".join(self._lines) + b"\n"
        values, _, _, _, fault, _, token = _kernels.parse_bvh_rows(
            text, self._width, len(self._lines), True
        )
        if fault or len(values) < len(self._lines):
            line = self._numbers[min(len(values), len(self._lines) - 1)]
            message = f"{excerpt(token.decode('utf-8', 'replace'))} is no number"
            raise _error("MOF003", self._path, message, line)
        return values, np.array(self._numbers, np.int64)


def _check_times(path: Path, times: FloatArray, lines: IntArray) -> None:
    with np.errstate(invalid="ignore", over="ignore"):
        wrong = ~np.isfinite(times)
        wrong[1:] |= ~(np.diff(times) > 0)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        message = f"time {times[row]:g} does not come after the row before"
        if not np.isfinite(times[row]):
            message = "the time is no finite number"
        raise _error("MOF005", path, message, int(lines[row]))


def _missing(
    path: Path, names: tuple[str, ...], values: FloatArray, lines: IntArray
) -> list[Fault]:
    """Return a warning of the columns in which values are missing."""
    missing: BoolArray = np.isnan(values)
    columns = np.flatnonzero(missing.any(axis=0)).tolist()
    if not columns:
        return []
    count = counted(int(missing.sum()), "value")
    message = (
        f"{count} missing in {listed([names[c] for c in columns])}: put in between "
        "those around, 0 where a column has none"
    )
    row = int(lines[np.flatnonzero(missing.any(axis=1))[0]])
    return [Fault("MOF104", message, str(path), (row,), None, Severity.WARNING)]
