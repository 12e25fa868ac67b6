"""Reads the rows and columns of a Live Link Face recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, counted, excerpt, listed
from animtool.core.files.reading import read_input
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
from animtool.formats.trajectories import CaptureFile
from animtool.rig.head import HEAD, LEFT_EYE, RIGHT_EYE
from animtool.rig.shapes import arkit_name

_DECIMAL_COMMA = re.compile(r"-?\d+,\d+")
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
        f"Eye{action}{side}"
        for side in ("Left", "Right")
        for action in [
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
        f"Mouth{action}{side}"
        for action in ("Smile", "Frown", "Dimple", "Stretch")
        for side in ("Left", "Right")
    ),
    *("MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper"),
    *(
        f"Mouth{action}{side}"
        for action in ("Press", "LowerDown", "UpperUp")
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

    file: CaptureFile  # the file, with warnings
    # Name of each weight column, in ARKit's spelling if it is an ARKit shape.
    shapes: tuple[str, ...]
    # The `ANGLE_COLUMNS` in the file, in the order of ``rotations``.
    angles: tuple[str, ...]
    timecodes: list[str]  # time code of each row, as written
    line_numbers: IntArray  # 1-based line number of each row ``(R,)``
    weights: FloatArray  # weights of the shapes ``(R, S)``; NaN if missing
    rotations: FloatArray  # angles [rad] ``(R, A)``; NaN if missing


@expects_format("LLF001", "a Live Link Face recording")
def read_recording(path: Path) -> Recording:
    """Read the rows of a recording."""
    file, lines = CaptureFile(str(path)), _read_lines(path)
    header_index = next((i for i, line in enumerate(lines) if line.strip()), None)
    if header_index is None:
        raise file.error("LLF001", "is empty")
    table = _RecordingTable(file, lines[header_index], header_index + 1)
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

    def __init__(self, file: CaptureFile, header: str, line: int) -> None:
        self.file, self.header_line = file, line
        self.delimiter = max(_DELIMITERS, key=header.count)
        cells = header.split(self.delimiter)
        self.names = [n.strip().strip('"').strip() for n in cells]
        lower = [name.lower() for name in self.names]
        if TIMECODE_COLUMN.lower() not in lower:
            message = "no column is called Timecode: this is not a Live Link Face file"
            hint = f"the first columns are {listed(self.names[:4])}"
            raise file.error("LLF001", message, hint, line)
        if len(self.names) > MAX_COLUMNS:
            message = f"has {len(self.names)} columns; the limit is {MAX_COLUMNS}"
            raise file.error("LLF001", message, line=line)
        self.time_column = lower.index(TIMECODE_COLUMN.lower())
        has_count = COUNT_COLUMN.lower() in lower
        self.count_column = lower.index(COUNT_COLUMN.lower()) if has_count else None
        # Known columns get one spelling, so that duplicates are detected.
        canonical_names = [
            arkit_name(n) or _ANGLES_BY_LOWERCASE.get(n.lower(), n.lower())
            for n in self.names
        ]
        faults = [
            self._cell_fault("LLF002", i, f"duplicate column {name!r}", line)
            for i, name in enumerate(self.names)
            if name and canonical_names.index(canonical_names[i]) < i
        ]
        if faults:
            raise FormatError(faults)
        other_columns = (self.time_column, self.count_column)
        value_columns = [i for i in range(len(lower)) if i not in other_columns]
        self.angle_columns = [
            i for i in value_columns if lower[i] in _ANGLES_BY_LOWERCASE
        ]
        self.shape_columns = [
            i for i in value_columns if i not in self.angle_columns and self.names[i]
        ]

    def _cell_fault(self, code: str, column: int, message: str, line: int) -> Fault:
        """Return a fault at a cell; ``column`` is its index in the row."""
        return Fault(code, message, self.file.path, (line,), column=column + 1)

    def read(self, rows: list[tuple[int, str]]) -> Recording:
        """Parse the rows below the header into weights and angles."""
        column_count, file = len(self.names), self.file
        cells = [(number, line.split(self.delimiter)) for number, line in rows]
        # A comma after the last value of each row is not a column.
        for _, row in cells:
            if len(row) == column_count + 1 and not row[-1].strip():
                row.pop()
        if cells and len(cells[-1][1]) < column_count:
            number, row = cells.pop()
            message = f"the last row ends at column {len(row)}: skipped"
            file.warn("LLF103", message, None, number)
        faults = []
        for number, row in cells:
            if len(row) != column_count:
                message = f"has {counted(len(row), 'column')}, but the header names "
                message += str(column_count)
                faults.append(Fault("LLF003", message, file.path, (number,)))
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        if not cells:
            message = "has no frames, only a header"
            raise file.error("LLF001", message, line=self.header_line)
        values = self._numbers(cells)
        if not self.shape_columns:
            message = "has no weight columns"
            raise file.error("LLF001", message, line=self.header_line)
        line_numbers = np.array([number for number, _ in cells], np.int64)
        self._check_counts(values, line_numbers)
        shape_names = [self.names[i] for i in self.shape_columns]
        angle_names = [self.names[i].lower() for i in self.angle_columns]
        return Recording(
            file,
            tuple(arkit_name(name) or name for name in shape_names),
            tuple(_ANGLES_BY_LOWERCASE[name] for name in angle_names),
            [row[self.time_column].strip().strip('"') for _, row in cells],
            line_numbers,
            values[:, self.shape_columns],
            values[:, self.angle_columns],
        )

    def _numbers(self, cells: Sequence[tuple[int, list[str]]]) -> FloatArray:
        """Return all values ``(R, C)``; NaN for missing ones."""
        columns = [*self.shape_columns, *self.angle_columns]
        if self.count_column is not None:
            columns.append(self.count_column)
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
                        if _DECIMAL_COMMA.fullmatch(text):
                            message = "numbers have decimal commas, such as "
                            fault = self._cell_fault(
                                "LLF004", c, message + excerpt(text), number
                            )
                            hint = "write decimal points in their place"
                            raise FormatError(replace(fault, hint=hint)) from None
                        message = f"{self.names[c]}: {excerpt(text)} is not a number"
                        faults.append(self._cell_fault("LLF004", c, message, number))
            if len(faults) >= MAX_FAULTS:
                break
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        values[~(np.abs(values) <= MAX_ABS_VALUE)] = np.nan
        return values

    def _check_counts(self, values: FloatArray, line_numbers: IntArray) -> None:
        """Warn about rows whose BlendshapeCount is wrong (LLF106)."""
        if self.count_column is None:
            return
        shape_count = len(self.shape_columns)
        valid_counts = [shape_count + len(self.angle_columns), shape_count]
        stated_counts = values[:, self.count_column]
        is_mismatched = np.isfinite(stated_counts)
        is_mismatched &= ~np.isin(stated_counts, valid_counts)
        if is_mismatched.any():
            row = int(np.flatnonzero(is_mismatched)[0])
            message = f"{COUNT_COLUMN} is {stated_counts[row]:g}, but the row has "
            message += counted(valid_counts[0], "value")
            self.file.warn("LLF106", message, None, int(line_numbers[row]))
