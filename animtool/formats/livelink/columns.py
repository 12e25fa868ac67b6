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

_DECIMAL_COMMA_PATTERN = re.compile(r"-?\d+,\d+")
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
    """Weights, angles and time codes of a recording's rows, in file order."""

    file: CaptureFile  # the file, with warnings
    # Name of each weight column, in ARKit's spelling if it is an ARKit shape.
    shape_names: tuple[str, ...]
    # The `ANGLE_COLUMNS` in the file, in the order of ``rotations``.
    angle_names: tuple[str, ...]
    timecodes: list[str]  # time code of each row, as written
    line_numbers: IntArray  # 1-based line number of each row ``(R,)``
    weights: FloatArray  # weights of the shapes ``(R, S)``; NaN if missing
    rotations: FloatArray  # angles [rad] ``(R, A)``; NaN if missing


@expects_format("LLF001", "a Live Link Face recording")
def read_recording(path: Path) -> Recording:
    """Return the weights, angles and time codes of a recording."""
    file, lines = CaptureFile(str(path)), _read_lines(path)
    header_index = next((i for i, line in enumerate(lines) if line.strip()), None)
    if header_index is None:
        raise file.error("LLF001", "is empty")
    table = _RecordingTable(file, lines[header_index], header_index + 1)
    rows = [(i + 1, line) for i, line in enumerate(lines) if i > header_index]
    return table.parse_rows(
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
    """Parses the rows of a recording by the columns that its header names."""

    def __init__(self, file: CaptureFile, header: str, header_line: int) -> None:
        self.file, self.header_line = file, header_line
        self.delimiter = max(_DELIMITERS, key=header.count)
        cells = header.split(self.delimiter)
        self.names = [n.strip().strip('"').strip() for n in cells]
        lowercase_names = [name.lower() for name in self.names]
        if TIMECODE_COLUMN.lower() not in lowercase_names:
            message = "no column is called Timecode: this is not a Live Link Face file"
            hint = f"the first columns are {listed(self.names[:4])}"
            raise file.error("LLF001", message, hint, header_line)
        if len(self.names) > MAX_COLUMNS:
            message = f"has {len(self.names)} columns; the limit is {MAX_COLUMNS}"
            raise file.error("LLF001", message, line=header_line)
        self.time_column = lowercase_names.index(TIMECODE_COLUMN.lower())
        has_count_column = COUNT_COLUMN.lower() in lowercase_names
        self.count_column = (
            lowercase_names.index(COUNT_COLUMN.lower()) if has_count_column else None
        )
        # Known columns get one spelling, so that duplicates are detected.
        canonical_names = [
            arkit_name(n) or _ANGLES_BY_LOWERCASE.get(n.lower(), n.lower())
            for n in self.names
        ]
        faults = [
            self._cell_fault("LLF002", i, f"duplicate column {name!r}", header_line)
            for i, name in enumerate(self.names)
            if name and canonical_names.index(canonical_names[i]) < i
        ]
        if faults:
            raise FormatError(faults)
        skipped_columns = (self.time_column, self.count_column)
        value_columns = [
            i for i in range(len(lowercase_names)) if i not in skipped_columns
        ]
        self.angle_columns = [
            i for i in value_columns if lowercase_names[i] in _ANGLES_BY_LOWERCASE
        ]
        self.shape_columns = [
            i for i in value_columns if i not in self.angle_columns and self.names[i]
        ]

    def _cell_fault(self, code: str, column: int, message: str, line: int) -> Fault:
        """Return a fault at a cell; ``column`` is its index in the row."""
        return Fault(code, message, self.file.path, (line,), column=column + 1)

    def parse_rows(self, rows: list[tuple[int, str]]) -> Recording:
        """Return the recording in the numbered lines below the header."""
        column_count, file = len(self.names), self.file
        numbered_rows = [
            (line_number, line.split(self.delimiter)) for line_number, line in rows
        ]
        # A comma after the last value of each row is not a column.
        for _, cells in numbered_rows:
            if len(cells) == column_count + 1 and not cells[-1].strip():
                cells.pop()
        if numbered_rows and len(numbered_rows[-1][1]) < column_count:
            line_number, cells = numbered_rows.pop()
            message = f"the last row ends at column {len(cells)} and is skipped"
            file.warn("LLF103", message, None, line_number)
        faults = []
        for line_number, cells in numbered_rows:
            if len(cells) != column_count:
                message = f"has {counted(len(cells), 'column')}, but the header names "
                message += str(column_count)
                faults.append(Fault("LLF003", message, file.path, (line_number,)))
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        if not numbered_rows:
            message = "has no frames, only a header"
            raise file.error("LLF001", message, line=self.header_line)
        values = self._parse_values(numbered_rows)
        if not self.shape_columns:
            message = "has no weight columns"
            raise file.error("LLF001", message, line=self.header_line)
        line_numbers = np.array(
            [line_number for line_number, _ in numbered_rows], np.int64
        )
        self._warn_of_counts(values, line_numbers)
        shape_names = [self.names[i] for i in self.shape_columns]
        angle_names = [self.names[i].lower() for i in self.angle_columns]
        return Recording(
            file,
            tuple(arkit_name(name) or name for name in shape_names),
            tuple(_ANGLES_BY_LOWERCASE[name] for name in angle_names),
            [cells[self.time_column].strip().strip('"') for _, cells in numbered_rows],
            line_numbers,
            values[:, self.shape_columns],
            values[:, self.angle_columns],
        )

    def _parse_values(
        self, numbered_rows: Sequence[tuple[int, list[str]]]
    ) -> FloatArray:
        """Return the numbers of all columns ``(R, C)``; NaN if missing or too large."""
        columns = [*self.shape_columns, *self.angle_columns]
        if self.count_column is not None:
            columns.append(self.count_column)
        values = np.full((len(numbered_rows), len(self.names)), np.nan)
        faults: list[Fault] = []
        for row, (line_number, cells) in enumerate(numbered_rows):
            try:
                values[row, columns] = [float(cells[column]) for column in columns]
            except ValueError:
                for column in columns:
                    text = cells[column].strip().strip('"')
                    try:
                        values[row, column] = float(text) if text else np.nan
                    except ValueError:
                        if _DECIMAL_COMMA_PATTERN.fullmatch(text):
                            message = "numbers have decimal commas, such as "
                            fault = self._cell_fault(
                                "LLF004", column, message + excerpt(text), line_number
                            )
                            hint = "write decimal points in their place"
                            raise FormatError(replace(fault, hint=hint)) from None
                        message = f"{excerpt(text)} is not a number"
                        message = f"{self.names[column]}: {message}"
                        faults.append(
                            self._cell_fault("LLF004", column, message, line_number)
                        )
            if len(faults) >= MAX_FAULTS:
                break
        if faults:
            raise FormatError(faults[:MAX_FAULTS])
        values[~(np.abs(values) <= MAX_ABS_VALUE)] = np.nan
        return values

    def _warn_of_counts(self, values: FloatArray, line_numbers: IntArray) -> None:
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
