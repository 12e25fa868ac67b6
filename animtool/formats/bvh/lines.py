"""Reads a BVH file: header lines, then rows of finite numbers block by block.

It assumes nothing about the content of the file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.files.reading import (
    FileState,
    InputFile,
    changed_error,
    open_input,
    unreadable_error,
)
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.zero_rows import ZeroRows

CHUNK_BYTES = 1 << 19
# Maximum length of a header line, which names one joint or its channels.
MAX_HEADER_LINE_BYTES = 1 << 16
# Maximum number of header lines; a joint has five or six.
MAX_HEADER_LINES = 1_000_000
# Values per block: 256 KB of float64, which stay in the processor's cache from parser
# to writer.
BLOCK_VALUES = 1 << 15
# Maximum length of a number, including blanks [byte].
MAX_NUMBER_BYTES = 1024
# Maximum number and fraction of a channel's missing samples to fill by interpolation;
# more would invent motion.
MAX_FILLED_SAMPLES = 10
MAX_FILLED_FRACTION = 0.1
MAX_LISTED_CHANNELS = 20

_LINE_END_PATTERN = re.compile(rb"\r\n?|\n")


class HeaderLines:
    """Reads header lines and counts them; CR, LF and CR LF all end a line.

    Attributes:
        number: 1-based number of the line last returned.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self.number = 0
        self._file = file
        self._path = path
        self._data = file.read(CHUNK_BYTES)
        self._offset = 0
        self._check_text()

    @property
    def unread_bytes(self) -> bytes:
        """Bytes that were read from the file but not returned as lines yet."""
        return self._data[self._offset :]

    def _check_text(self) -> None:
        if not self._data:
            self.fail("BVH002", "the file is empty", has_line=False)
        if self._data.startswith((b"\xff\xfe", b"\xfe\xff")):
            message = "the file is UTF-16 text"
            self.fail("BVH001", message, "save it as UTF-8", has_line=False)
        self._data = self._data.removeprefix(b"\xef\xbb\xbf")
        if b"\0" in self._data:
            message = "the file is binary, not BVH text"
            self.fail("BVH001", message, has_line=False)

    def next_line(self) -> str | None:
        """Return the next line without its line break; None after the last line."""
        while True:
            match = _LINE_END_PATTERN.search(self._data, self._offset)
            is_chunk_end = match is not None and match.end() == len(self._data)
            # A CR at the end of the chunk may be half of a CR LF.
            if match is not None and not (is_chunk_end and match.group() == b"\r"):
                break
            if len(self._data) - self._offset > MAX_HEADER_LINE_BYTES and match is None:
                self._fail_line_too_long()
            chunk = self._file.read(CHUNK_BYTES)
            if not chunk:
                break
            self._data, self._offset = self.unread_bytes + chunk, 0
        if self._offset == len(self._data):
            return None
        data_end = len(self._data)
        line_stop, next_start = match.span() if match else (data_end, data_end)
        if line_stop - self._offset > MAX_HEADER_LINE_BYTES:
            self._fail_line_too_long()
        line, self._offset = self._data[self._offset : line_stop], next_start
        self.number += 1
        if self.number > MAX_HEADER_LINES:
            message = f"more than {MAX_HEADER_LINES} lines before the rows of numbers"
            self.fail("BVH013", message, "is this a BVH file?")
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError:
            # Windows-1252 has letters where Latin-1 has control characters.
            return line.decode("cp1252", "replace")

    def _fail_line_too_long(self) -> NoReturn:
        self.number += 1
        message = f"the line is longer than {MAX_HEADER_LINE_BYTES} bytes"
        self.fail("BVH013", message, "is this a BVH file?")

    def fail(
        self, code: str, message: str, hint: str | None = None, *, has_line: bool = True
    ) -> NoReturn:
        """Raise a `FormatError` at the current line, or else about the whole file."""
        lines = (max(1, self.number),) if has_line else ()
        raise FormatError(Fault(code, message, str(self._path), lines, hint))


@dataclass(slots=True)
class RowSource:
    """The rows of numbers in a BVH file: their location, channels and stated count."""

    path: Path  # path of the file
    file_state: FileState  # state of the file when its header was read
    first_row_offset: int  # offset of the first row [byte]
    header_line_count: int  # number of lines before the rows
    channels: list[str]  # name of each column, ``joint.Xposition``
    declared_frame_count: int  # number of frames in the header
    frames_line: int  # line of the header with that number
    # Called with the fraction of the file read so far.
    progress: Callable[[float], None] | None = None


class RowReader:
    """Reads blocks of rows ``(F, C)`` with all values finite and in float32 range.

    Attributes:
        notices: Repairs and mismatches; complete after the last block.
    """

    def __init__(self, source: RowSource) -> None:
        self.source = source
        self.notices: list[Fault] = []
        self._path = str(source.path)
        self._column_count = len(source.channels)
        self._row_count = 0
        self._first_surplus_line: int | None = None
        self._last_row: FloatArray | None = None
        self._zero_rows = ZeroRows()
        self._missing_lines_by_column: dict[int, list[int]] = {}
        self._out_of_range_lines_by_column: dict[int, list[int]] = {}

    def blocks(self) -> Iterator[FloatArray]:
        """Yield rows ``(F, C)`` in blocks, missing values filled; raise if invalid."""
        pending_blocks: list[FloatArray] = []
        for rows, lines in self._parse_rows():
            self._count_rows(lines)
            self._zero_rows.add(rows, lines)
            block = rows
            if not (rows.min() >= -FLOAT32_MAX and rows.max() <= FLOAT32_MAX):
                self._record_invalid_lines(rows, lines)
                block = np.clip(rows, -FLOAT32_MAX, FLOAT32_MAX)
            if pending_blocks or np.isnan(block).any():
                pending_blocks.append(block)
                # A gap at the end of the block is filled with the next block.
                if np.isnan(block[-1]).any():
                    continue
                block = np.concatenate(pending_blocks)
                pending_blocks.clear()
                self._fill_missing(block)
            self._last_row = block[-1].copy()
            yield block
        self._check_rows()
        if pending_blocks:
            block = np.concatenate(pending_blocks)
            self._fill_missing(block)
            yield block
        self._add_notices()

    def _parse_rows(self) -> Iterator[tuple[FloatArray, IntArray]]:
        """Yield rows ``(F, C)`` and their line numbers ``(F,)``."""
        source = self.source
        with open_input(source.path, None) as file:
            if file.state != source.file_state:
                raise changed_error(source.path)
            try:
                file.seek(source.first_row_offset)
                yield from self._parse_blocks(file)
            except OSError as error:
                raise unreadable_error(source.path, error) from error
            file.check()

    def _parse_blocks(self, file: InputFile) -> Iterator[tuple[FloatArray, IntArray]]:
        file_size = max(1, file.state.size)
        max_rows = max(1, BLOCK_VALUES // self._column_count)
        max_line_bytes = CHUNK_BYTES + MAX_NUMBER_BYTES * self._column_count
        line = self.source.header_line_count + 1
        data, is_last_chunk, needs_data = b"", False, True
        while True:
            if needs_data:
                chunk = file.read(CHUNK_BYTES)
                is_last_chunk = not chunk
                data += chunk
                if self.source.progress:
                    self.source.progress(file.tell() / file_size)
            rows, row_lines, consumed_count, line_count, fault_code, column, token = (
                _kernels.parse_bvh_rows(
                    data, self._column_count, max_rows, is_last_chunk
                )
            )
            if len(rows):
                yield rows, row_lines + line
            line += line_count
            data = data[consumed_count:]
            if fault_code:
                is_last_line = is_last_chunk and len(data.splitlines()) <= 1
                fault = self._row_fault(fault_code, line, column, token, is_last_line)
                raise FormatError(fault)
            if is_last_chunk and not data:
                return
            if len(data) > max_line_bytes and not consumed_count:
                message = "the line is too long for a row of numbers"
                raise FormatError(Fault("BVH013", message, self._path, (line,)))
            needs_data = len(rows) < max_rows

    def _row_fault(
        self, fault_code: int, line: int, column: int, token: bytes, is_last_line: bool
    ) -> Fault:
        path = self._path
        if fault_code == 2:
            word = token.decode("utf-8", "replace")
            is_channel = column < self._column_count
            name = self.source.channels[column] if is_channel else "another word"
            hint = "write decimals with a point" if "," in word else None
            message = f"{excerpt(word)} is not a number ({excerpt(name)})"
            return Fault("BVH011", message, path, (line,), hint)
        hint = "each frame must be one line; are these rows wrapped?"
        declared_count = self.source.declared_frame_count
        if 0 < declared_count <= self._row_count:
            frame_text = counted(declared_count, "frame")
            hint = f"the {frame_text} of the header end before this line: are these "
            hint += "rows of another take? delete them"
        elif column > self._column_count:
            hint = "does the HIERARCHY name every channel?"
        elif is_last_line:
            hint = "the file ends here: is it truncated? copy or export it again"
        message = f"the row has {counted(column, 'number')}, but the channels need "
        message += f"{self._column_count}"
        return Fault("BVH010", message, path, (line,), hint)

    def _count_rows(self, lines: IntArray) -> None:
        first_row, self._row_count = self._row_count, self._row_count + len(lines)
        declared_count = self.source.declared_frame_count
        if self._first_surplus_line is None and self._row_count > declared_count:
            self._first_surplus_line = int(lines[declared_count - first_row])

    def _record_invalid_lines(self, rows: FloatArray, lines: IntArray) -> None:
        with np.errstate(invalid="ignore"):
            is_out_of_range = np.abs(rows) > FLOAT32_MAX
        for lines_by_column, is_invalid in (
            (self._missing_lines_by_column, np.isnan(rows)),
            (self._out_of_range_lines_by_column, is_out_of_range),
        ):
            for column in np.flatnonzero(is_invalid.any(axis=0)).tolist():
                invalid_lines = lines[is_invalid[:, column]].tolist()
                lines_by_column.setdefault(column, []).extend(invalid_lines)

    def _fill_missing(self, block: FloatArray) -> None:
        """Fill NaN in place: linear interpolation, nearest value at both ends."""
        for column in np.flatnonzero(np.isnan(block).any(axis=0)):
            values = block[:, column]
            if self._last_row is not None:
                values = np.concatenate([self._last_row[column : column + 1], values])
            indices = np.flatnonzero(np.isfinite(values))
            finite_values = values[indices]
            if self.source.channels[column].endswith("rotation"):
                # Angles are unwrapped, so that 179 to -179 degrees is a step of 2, not
                # 358.
                finite_values = np.unwrap(finite_values, period=360.0)
            filled_values = np.interp(np.arange(len(values)), indices, finite_values)
            filled_values[indices] = values[indices]
            block[:, column] = filled_values[-len(block) :]

    def _check_rows(self) -> None:
        """Raise for a file without rows, or a channel with too many missing values."""
        path = self._path
        if not self._row_count:
            line = self.source.header_line_count
            message = "the MOTION block has no rows of numbers"
            raise FormatError(Fault("BVH014", message, path, (line,)))
        faults = []
        for column, lines in sorted(self._missing_lines_by_column.items()):
            missing_count = len(lines)
            max_count = max(MAX_FILLED_SAMPLES, MAX_FILLED_FRACTION * self._row_count)
            if missing_count > max_count or missing_count == self._row_count:
                name = self.source.channels[column]
                message = f"{name}: {missing_count} of {self._row_count} values are "
                message += "not finite"
                hint = "too many to interpolate"
                faults.append(Fault("BVH012", message, path, tuple(lines[:10]), hint))
        if faults:
            raise FormatError(faults[:MAX_LISTED_CHANNELS])

    def _add_notices(self) -> None:
        declared_count, row_count = self.source.declared_frame_count, self._row_count
        if declared_count != row_count:
            line = self._first_surplus_line or self.source.frames_line
            rows = counted(row_count, "row")
            message = f"Frames is {declared_count}, but the file has {rows}, all of "
            message += "which are read"
            hint = f"if they are all wanted, write Frames: {row_count}"
            if declared_count > row_count:
                hint = "is the file truncated? copy or export it again"
            self._warn("BVH101", message, [line], hint)
        self.notices += self._zero_rows.warnings(self._path)
        hint = "interpolated between neighbours"
        self._warn_channels("BVH102", self._missing_lines_by_column, "not finite", hint)
        hint = "the largest float32 is written; the reported error does not count them"
        self._warn_channels(
            "BVH104", self._out_of_range_lines_by_column, "beyond float32", hint
        )

    def _warn(self, code: str, message: str, lines: list[int], hint: str) -> None:
        fault = Fault(code, message, self._path, tuple(lines), hint, Severity.WARNING)
        self.notices.append(fault)

    def _warn_channels(
        self, code: str, lines_by_column: dict[int, list[int]], problem: str, hint: str
    ) -> None:
        for column, lines in sorted(lines_by_column.items())[:MAX_LISTED_CHANNELS]:
            count_text = "1 value is" if len(lines) == 1 else f"{len(lines)} values are"
            message = f"{self.source.channels[column]}: {count_text} {problem}, on "
            message += f"line{'s' * (len(lines) > 1)} {listed(lines, 10)}"
            self._warn(code, message, lines[:10], hint)
        if len(lines_by_column) > MAX_LISTED_CHANNELS:
            count = len(lines_by_column) - MAX_LISTED_CHANNELS
            message = f"{count} more channels have values that are {problem}"
            self._warn(code, message, [], hint)
