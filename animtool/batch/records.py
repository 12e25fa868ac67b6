"""Plain values and files of JSON lines, validated as untrusted input.

Each line but the first ends with a checksum, so that damaged lines are detected. Lines
of older versions have none, and come first.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NoReturn, Self

from animtool.core.errors import Fault, FormatError, OutputError, Severity, counted
from animtool.core.files.commit import output_error
from animtool.core.files.reading import open_input, read_input

# Longer than the longest path on any system.
MAX_TEXT_LENGTH = 40_000
# Limit of sizes, times and inodes.
MAX_INTEGER = 2**64


class RecordError(ValueError):
    """A plain value has the wrong type or range; the message names it."""


def _refuse_constant(name: str) -> NoReturn:
    raise RecordError(f"{name} is not a number")


def _refuse_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise RecordError("a key appears twice")
    return values


_STRICT_DECODER = json.JSONDecoder(parse_constant=_refuse_constant)
_UNIQUE_KEYS_DECODER = json.JSONDecoder(
    parse_constant=_refuse_constant, object_pairs_hook=_refuse_duplicate_keys
)


def json_object(data: bytes, *, refuses_duplicates: bool = True) -> dict[str, Any]:
    """Return the JSON object in data; raise an error for other values."""
    decoder = _UNIQUE_KEYS_DECODER if refuses_duplicates else _STRICT_DECODER
    try:
        return checked_object(decoder.decode(data.decode("utf-8")))
    except RecordError:
        raise
    except ValueError as error:
        line = f" from line {error.lineno} on" if hasattr(error, "lineno") else ""
        raise RecordError(f"is not JSON{line}") from error
    except RecursionError as error:
        raise RecordError("is nested too deeply") from error


def read_json(path: Path, max_bytes: int) -> dict[str, Any]:
    """Return the JSON object in a file of limited size."""
    try:
        data = read_input(path, max_bytes, is_recorded=False)
    except FormatError as error:
        raise RecordError(error.faults[0].message) from error
    return json_object(data)


def checked_object(value: object) -> dict[str, Any]:
    """Return a value if it is a JSON object, else raise an error."""
    if not isinstance(value, dict):
        raise RecordError("is not an object")
    return value


def text_in(
    data: Mapping[str, Any], key: str, max_length: int = MAX_TEXT_LENGTH
) -> str:
    """Return the text of a key; refuse other types, long texts and NUL."""
    return _checked_text(data.get(key), key, max_length)


def _checked_text(value: object, key: str, max_length: int = MAX_TEXT_LENGTH) -> str:
    if not isinstance(value, str):
        raise RecordError(f"{key!r} is not text")
    if len(value) > max_length:
        raise RecordError(f"{key!r} is too long")
    if "\0" in value:
        raise RecordError(f"{key!r} contains a NUL")
    return value


def texts_in(data: Mapping[str, Any], key: str) -> list[str]:
    """Return the list of texts of a key, each checked as in `text_in`."""
    return [_checked_text(value, key) for value in list_in(data, key)]


def integer_in(
    data: Mapping[str, Any], key: str, minimum: int = 0, maximum: int = MAX_INTEGER
) -> int:
    """Return the integer value of a key, checked for its range."""
    value = data.get(key)
    # A boolean is an int in Python.
    if type(value) is not int or not minimum <= value <= maximum:
        raise RecordError(f"{key!r} is not a whole number from {minimum} to {maximum}")
    return value


def number_in(data: Mapping[str, Any], key: str, minimum: float = 0.0) -> float:
    """Return the finite number of a key, checked for its minimum."""
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RecordError(f"{key!r} is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (math.isfinite(number) and number >= minimum):
        raise RecordError(f"{key!r} is not a number of at least {minimum:g}")
    return number


def list_in(data: Mapping[str, Any], key: str) -> Sequence[Any]:
    """Return the list of a key; raise an error for other types."""
    value = data.get(key)
    if not isinstance(value, list):
        raise RecordError(f"{key!r} is not a list")
    return value


JsonLine = Mapping[str, Any]

# Enough for an item of 50,000 outputs [bytes].
MAX_LINE_BYTES = 1 << 24
_CHECKSUM_KEY = ',"crc":"'
_CHECKSUM_LENGTH = len(_CHECKSUM_KEY) + len('01234567"}\n')


class LineReader:
    """Reads a file of JSON lines, and skips damaged ones.

    Attributes:
        length: Length of the complete lines read so far [bytes].
        line_number: Number of the last line read, from 1.
        damaged_lines: Unusable lines by number, with the reason.
    """

    def __init__(self, path: Path, header: JsonLine) -> None:
        """Store the path, which may be missing, and the expected first line."""
        self.path, self.header = path, header
        self.length = self.line_number = 0
        self.damaged_lines: dict[int, str] = {}
        self._has_checksums = False

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield all lines after the first; skip an incomplete last line.

        Lines that are not JSON, or fail the checksum, are in `damaged_lines`; the
        caller adds lines with invalid content.
        """
        try:
            raw_file = open_input(self.path, None, is_recorded=False)
        except FormatError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return
            raise FormatError(replace(error.faults[0], code="BAT011")) from error
        try:
            with BufferedReader(raw_file) as file:
                yield from self._lines(file)
        except OSError as error:
            message = f"cannot be read: {error.strerror or error}"
            raise FormatError(Fault("BAT011", message, str(self.path))) from error

    def _lines(self, file: IO[bytes]) -> Iterator[dict[str, Any]]:
        self._read_header(file)
        while self.line_number:
            line = file.readline(MAX_LINE_BYTES + 1)
            length = len(line)
            while length > MAX_LINE_BYTES and line and not line.endswith(b"\n"):
                line = file.readline(MAX_LINE_BYTES)
                length += len(line)
            if not line.endswith(b"\n"):
                return
            self.line_number += 1
            self.length += length
            try:
                record = self._parse_line(line, length)
            except RecordError as error:
                self.damaged_lines[self.line_number] = str(error)
            else:
                yield record

    def _read_header(self, file: IO[bytes]) -> None:
        """Read and check the first line, if the file is not empty."""
        expected_line = _line_text(self.header).encode()
        line = file.readline(MAX_LINE_BYTES)
        # The first line may be incomplete after a kill; other files are not
        # overwritten.
        if len(line) < len(expected_line) and expected_line.startswith(line):
            return
        try:
            header = json_object(line)
        except RecordError:
            header = {}
        if header != self.header or not line.endswith(b"\n"):
            raise self._foreign_error(header)
        self.length, self.line_number = len(line), 1

    def _parse_line(self, line: bytes, length: int) -> dict[str, Any]:
        """Parse a line, without its checksum."""
        if length > MAX_LINE_BYTES:
            raise RecordError(f"is longer than {MAX_LINE_BYTES} bytes")
        content, checksum_text = line[:-_CHECKSUM_LENGTH], line[-_CHECKSUM_LENGTH:]
        is_valid = checksum_text == _checksum_suffix(content)
        record = json_object(line, refuses_duplicates=not is_valid)
        self._has_checksums |= is_valid
        if not is_valid and (self._has_checksums or "crc" in record):
            raise RecordError("differs from what was written")
        record.pop("crc", None)
        return record

    def notices(self) -> list[Fault]:
        """Return one warning about all damaged lines, or none."""
        if not self.damaged_lines:
            return []
        number, reason = next(iter(self.damaged_lines.items()))
        count_text = counted(len(self.damaged_lines), "line")
        message = f"{count_text} of the record cannot be used: line {number} {reason}"
        hint = "the items in them are rebuilt"
        location = str(self.path), tuple(self.damaged_lines)[:100]
        return [Fault("BAT070", message, *location, hint, Severity.WARNING)]

    def _foreign_error(self, header: JsonLine) -> FormatError:
        (kind, version), *_ = self.header.items()
        message = f"is not a {kind} file of {version}"
        other_version = header.get(kind)
        if isinstance(other_version, str) and other_version != version:
            message = f"is of version {other_version[:40]!r}; {version} is supported"
        hint = "remove it to rebuild everything"
        return FormatError(Fault("BAT011", message, str(self.path), (1,), hint))


def _checksum_suffix(body: bytes) -> bytes:
    return f'{_CHECKSUM_KEY}{zlib.crc32(body):08x}"}}\n'.encode()


def _line_text(line: JsonLine) -> str:
    return json.dumps(line, separators=(",", ":"), allow_nan=False) + "\n"


def _with_checksum(line: JsonLine) -> bytes:
    body = _line_text(line).encode()[:-2]
    return body + _checksum_suffix(body)


class LineWriter:
    """Appends lines to a file; the lines of one call are written atomically.

    Attributes:
        path: The file.
        length: Length of the file [bytes].
    """

    def __init__(self, path: Path, header: JsonLine, length: int = 0) -> None:
        """Open a file of ``length`` [bytes], creating it if missing."""
        self.path, self.length = path, length
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
            flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
            self._handle = os.open(path, flags, 0o666)
            os.ftruncate(self._handle, length)
        except OSError as error:
            raise self._write_error(error) from error
        if not length:
            self._write(_line_text(header).encode())

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        os.close(self._handle)

    def write(self, lines: Iterable[JsonLine]) -> None:
        """Append lines, each with its checksum, in one write."""
        self._write(b"".join(map(_with_checksum, lines)))

    def _write(self, data: bytes) -> None:
        try:
            written_count = os.write(self._handle, data)
        except OSError as error:
            raise self._write_error(error) from error
        if written_count < len(data):
            os.ftruncate(self._handle, self.length)
            raise self._write_error("the disk is full")
        self.length += written_count

    def _write_error(self, error: OSError | str) -> OutputError:
        fault = output_error(self.path, error).faults[0]
        hint = fault.hint or "finished items are recorded"
        return OutputError(Fault("BAT012", fault.message, fault.path, (), hint))
