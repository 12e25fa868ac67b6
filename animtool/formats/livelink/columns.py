"""Reads the columns of a Live Link Face recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.files.reading import read_input
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
from animtool.rig.head import HEAD, LEFT_EYE, RIGHT_EYE
from animtool.rig.shapes import ARKIT_SHAPES, arkit_name

# Names as written by the app; they are read case-insensitively.
TIMECODE_COLUMN, COUNT_COLUMN = "Timecode", "BlendShapeCount"
# Rotations about the axes of the face: up, left, and forward.
ANGLE_AXES = ("Yaw", "Pitch", "Roll")
FACE_PARTS = ("Head", "LeftEye", "RightEye")
JOINTS_BY_PART = dict(zip(FACE_PARTS, (HEAD, LEFT_EYE, RIGHT_EYE), strict=True))
ANGLE_COLUMNS = tuple(part + axis for part in FACE_PARTS for axis in ANGLE_AXES)
# Shapes in the order of the app.
APP_SHAPES = (
    *(
        f"Eye{what}{side}"
        for side in ("Left", "Right")
        for what in [
            "Blink",
            "LookDown",
            "LookIn",
            "LookOut",
            "LookUp",
            "Squint",
            "Wide",
        ]
    ),
    *("JawForward", "JawRight", "JawLeft", "JawOpen", "MouthClose", "MouthFunnel"),
    *("MouthPucker", "MouthRight", "MouthLeft"),
    *(
        f"Mouth{what}{side}"
        for what in ("Smile", "Frown", "Dimple", "Stretch")
        for side in ("Left", "Right")
    ),
    *("MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper"),
    *(
        f"Mouth{what}{side}"
        for what in ("Press", "LowerDown", "UpperUp")
        for side in ("Left", "Right")
    ),
    *("BrowDownLeft", "BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft"),
    *("BrowOuterUpRight", "CheekPuff", "CheekSquintLeft", "CheekSquintRight"),
    *("NoseSneerLeft", "NoseSneerRight", "TongueOut"),
)
MAX_COLUMNS = 4096
MAX_BYTES = 1_000_000_000
MAX_FAULTS = 100
# Weights are about 1 and angles a few radians; larger values are missing.
MAX_ABS_VALUE = 1e18
_DELIMITERS = ",;\t"
_ANGLES_BY_LOWERCASE = {name.lower(): name for name in ANGLE_COLUMNS}


@dataclass(slots=True)
class Recording:
    """The rows of a recording, in file order."""

    path: Path  # path of the file
    # Name of each weight column, in ARKit's spelling if it is an ARKit shape.
    shapes: tuple[str, ...]
    # The `ANGLE_COLUMNS` in the file, in the order of ``rotations``.
    angles: tuple[str, ...]
    labels: list[str]  # time code of each row, as written
    lines: IntArray  # 1-based line number of each row ``(R,)``
    weights: FloatArray  # weights of the shapes ``(R, S)``; NaN if missing
    rotations: FloatArray  # angles [rad] ``(R, A)``; NaN if missing
    notices: list[Fault] = field(default_factory=list)  # warnings about the file


@expects_format("LLF001", "a Live Link Face recording")
def read_recording(path: Path) -> Recording:
    """Read the rows of a recording."""
    lines = _read_lines(path)
    header_index = next((i for i, line in enumerate(lines) if line.strip()), None)
    if header_index is None:
        raise FormatError(Fault("LLF001", "is empty", str(path)))
    table = _RecordingTable(path, lines[header_index], header_index + 1)
    rows = [(i + 1, line) for i, line in enumerate(lines) if i > header_index]
    return table.read(
        [(number, line) for number, line in rows if line.strip(" \t,;\0")]
    )


def _read_lines(path: Path) -> list[str]:
    data = read_input(path, MAX_BYTES)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", "replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
            message = f"byte {data[error.start]:#04x} is not UTF-8"
            raise FormatError(Fault("LLF001", message, str(path), (line,))) from error
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


class _RecordingTable:
    """Parses rows by the columns that a header names."""

    def __init__(self, path: Path, header: str, line: int) -> None:
        self.path, self.line = path, line
        self.delimiter = max(_DELIMITERS, key=header.count)
        self.names = [n.strip().strip('"').strip() for n in self._cells(header)]
        lower = [name.lower() for name in self.names]
        if TIMECODE_COLUMN.lower() not in lower:
            message = "no column is called Timecode: this is not a Live Link Face file"
            hint = f"the first columns are {listed(self.names[:4])}"
            raise FormatError(Fault("LLF001", message, str(path), (line,), hint))
        if len(self.names) > MAX_COLUMNS:
            message = f"has {len(self.names)} columns; the limit is {MAX_COLUMNS}"
            raise FormatError(Fault("LLF001", message, str(path), (line,)))
        self.time = lower.index(TIMECODE_COLUMN.lower())
        self.count = (
            lower.index(COUNT_COLUMN.lower()) if COUNT_COLUMN.lower() in lower else None
        )
        # Known columns get one spelling, so that duplicates are detected.
        self.canonical = [
            arkit_name(n) or _ANGLES_BY_LOWERCASE.get(n.lower(), n.lower())
            for n in self.names
        ]
        faults = [
            self._fault("LLF002", i, f"duplicate column {name!r}")
            for i, name in enumerate(self.names)
            if name and self.canonical.index(self.canonical[i]) < i
        ]
        if faults:
            raise FormatError(faults)
        value_columns = [
            i for i in range(len(lower)) if i not in (self.time, self.count)
        ]
        self.angle_columns = [
            i for i in value_columns if lower[i] in _ANGLES_BY_LOWERCASE
        ]
        self.shapes = [
            i
            for i in value_columns
            if lower[i] not in _ANGLES_BY_LOWERCASE and self.names[i]
        ]

    def _cells(self, line: str) -> list[str]:
        return line.split(self.delimiter)

    def _fault(self, code: str, cell: int, message: str, line: int = 0) -> Fault:
        """Return a fault at a cell; ``cell`` is its index in the row."""
        return Fault(
            code, message, str(self.path), (line or self.line,), column=cell + 1
        )

    def read(self, rows: list[tuple[int, str]]) -> Recording:
        """Parse the rows below the header into weights and angles."""
        column_count = len(self.names)
        notices: list[Fault] = []
        cells = [(number, self._cells(line)) for number, line in rows]
        # A comma after the last value of each row is not a column.
        for _, row in cells:
            if len(row) == column_count + 1 and not row[-1].strip():
                row.pop()
        if cells and len(cells[-1][1]) < column_count:
            number, row = cells.pop()
            message = f"the last row ends at column {len(row)}: skipped"
            notices.append(self._warning("LLF103", message, number))
        faults = []
        for number, row in cells:
            if len(row) != column_count:
                message = f"has {counted(len(row), 'column')}, but the header names "
                message += str(column_count)
                faults.append(Fault("LLF003", message, str(self.path), (number,)))
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        if not cells:
            message = "has no frames, only a header"
            raise FormatError(Fault("LLF001", message, str(self.path), (self.line,)))
        values = self._numbers(cells)
        lines = np.array([number for number, _ in cells], np.int64)
        recording = Recording(
            self.path,
            tuple(arkit_name(self.names[i]) or self.names[i] for i in self.shapes),
            tuple(
                _ANGLES_BY_LOWERCASE[self.names[i].lower()] for i in self.angle_columns
            ),
            [row[self.time].strip().strip('"') for _, row in cells],
            lines,
            values[:, self.shapes],
            values[:, self.angle_columns],
            notices,
        )
        if not (set(recording.shapes) & set(ARKIT_SHAPES)) and not self.shapes:
            message = "has no weight columns"
            raise FormatError(Fault("LLF001", message, str(self.path), (self.line,)))
        notices += self._count_notice(values, lines)
        return recording

    def _numbers(self, cells: Sequence[tuple[int, list[str]]]) -> FloatArray:
        """Return all values ``(R, C)``; NaN where one is missing."""
        columns = [*self.shapes, *self.angle_columns]
        if self.count is not None:
            columns.append(self.count)
        values = np.full((len(cells), len(self.names)), np.nan)
        faults: list[Fault] = []
        for r, (number, row) in enumerate(cells):
            try:
                values[r, columns] = [float(row[c]) for c in columns]
            except ValueError:
                for c in columns:
                    text = row[c].strip().strip('"')
                    try:
                        values[r, c] = float(text) if text else np.nan
                    except ValueError:
                        message = f"{self.names[c]}: {excerpt(text)} is not a number"
                        faults.append(self._fault("LLF004", c, message, number))
            if len(faults) >= MAX_FAULTS:
                break
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        values[~(np.abs(values) <= MAX_ABS_VALUE)] = np.nan
        return values

    def _count_notice(self, values: FloatArray, lines: IntArray) -> list[Fault]:
        """Return a warning about rows whose BlendshapeCount is wrong."""
        if self.count is None:
            return []
        valid_counts = {len(self.shapes) + len(self.angle_columns), len(self.shapes)}
        stated_counts = values[:, self.count]
        is_mismatched: BoolArray = np.isfinite(stated_counts) & ~np.isin(
            stated_counts, list(valid_counts)
        )
        if not is_mismatched.any():
            return []
        row = int(np.flatnonzero(is_mismatched)[0])
        values_text = counted(max(valid_counts), "value")
        message = f"{COUNT_COLUMN} is {stated_counts[row]:g}, but the row has "
        message += f"{values_text}"
        return [self._warning("LLF106", message, int(lines[row]))]

    def _warning(self, code: str, message: str, line: int) -> Fault:
        path, warning = str(self.path), Severity.WARNING
        return Fault(code, message, path, (line,), severity=warning)
