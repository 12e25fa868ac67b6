"""Reads npz archives without trusting the sizes that they declare.

References:
    numpy, ``numpy.lib.format``, NEP 1: "A Simple File Format for NumPy Arrays".
"""

from __future__ import annotations

import math
import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np
import numpy.typing as npt

from animtool.core.config import find_config
from animtool.core.errors import FormatError
from animtool.core.files.reading import InputFile, open_input
from animtool.core.files.signatures import HEAD_BYTES, signature_of
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from zipfile import ZipFile, ZipInfo

NPY_MAGIC = b"\x93NUMPY"
ZIP_MAGIC = b"PK\x03\x04"
# The same limits as numpy.load.
MAX_HEADER_BYTES = 10_000
MAX_DIMENSIONS = 8
# Size of the header-length field by format version [byte].
_LENGTH_FIELD_SIZES = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
_HEADER_ENTRY = re.compile(
    r"""\s*(?P<quote>['"])(?P<key>descr|fortran_order|shape)(?P=quote)\s*:\s*
    (?: (?P<mark>['"])(?P<descr>[<>|=]?[A-Za-z]\d{0,6}(?:\[\w{1,9}\])?)(?P=mark)
      | (?P<fortran_order>True|False)
      | \((?P<shape>[\dL,\ ]*)\) )\s*(?:,|$)""",
    re.ASCII | re.VERBOSE,
)
# Object and structured types are refused.
_OBJECT_DTYPE = re.compile(r"""['"]descr['"]\s*:\s*['"]\|?O\d*['"]""")
_STRUCTURED_DTYPE = re.compile(r"""['"]descr['"]\s*:\s*\[""")


class ArrayError(ValueError):
    """An array or its archive cannot be read; the message explains why."""


class ArrayFile(Protocol):
    """A seekable binary file that contains arrays."""

    def read(self, size: int, /) -> bytes:
        """Return up to `size` bytes from the current position."""


@dataclass(frozen=True, slots=True)
class ArrayHeader:
    """Header of a stored array: the type, the shape, and the offset of its values."""

    shape: tuple[int, ...]  # lengths of its dimensions
    dtype: np.dtype[Any]
    order: Literal["C", "F"]  # memory order: by rows (C) or by columns (F)
    begin: int  # offset of the first value in the file [byte]

    @property
    def kind(self) -> str:
        """Kind of its numbers: ``f``, ``i``, ``u`` or ``b``."""
        return self.dtype.kind

    @property
    def count(self) -> int:
        """Number of values: the product of the lengths in its shape."""
        return math.prod(self.shape)

    @property
    def size(self) -> int:
        """Size of the values [byte]."""
        return self.count * self.dtype.itemsize


def read_header(file: ArrayFile, array_label: str) -> ArrayHeader:
    """Return the header of an array without reading its values."""
    preamble = file.read(len(NPY_MAGIC) + 2)
    version = tuple(preamble[len(NPY_MAGIC) :])
    length_size = _LENGTH_FIELD_SIZES.get(version)  # type: ignore[arg-type]
    if not preamble.startswith(NPY_MAGIC) or length_size is None:
        raise ArrayError(f"{array_label} is not an array as numpy.savez writes it")
    length = int.from_bytes(file.read(length_size), "little")
    if length > MAX_HEADER_BYTES:
        message = f"has a header of {length} bytes, which is not that of an array"
        raise ArrayError(f"{array_label} {message}")
    text = file.read(length)
    if len(text) < length:
        raise ArrayError(f"{array_label} ends in its header")
    begin = len(preamble) + length_size + length
    return _parse_header(text.decode("latin-1"), array_label, begin)


def _parse_header(text: str, array_label: str, begin: int) -> ArrayHeader:
    if _OBJECT_DTYPE.search(text):
        raise ArrayError(f"{array_label} contains pickled Python objects")
    if _STRUCTURED_DTYPE.search(text):
        raise ArrayError(f"{array_label} contains structures, not numbers")
    text = text.strip()
    fields: dict[str, str] = {}
    if text.startswith("{") and text.endswith("}"):
        unparsed_text = text[1:-1].strip()
        while unparsed_text and (match := _HEADER_ENTRY.match(unparsed_text)):
            value = match[match["key"]]
            if value is None or match["key"] in fields:
                break
            fields[match["key"]] = value
            unparsed_text = unparsed_text[match.end() :].strip()
        if unparsed_text:
            fields.clear()
    if len(fields) < 3:
        raise ArrayError(f"{array_label} has a header that is not that of an array")
    try:
        dtype = np.dtype(fields["descr"])
    except (TypeError, ValueError) as error:
        message = f"{array_label} contains {fields['descr']}, not numbers"
        raise ArrayError(message) from error
    shape = _parse_shape(fields["shape"], array_label)
    order: Literal["C", "F"] = "F" if fields["fortran_order"] == "True" else "C"
    return ArrayHeader(shape, dtype, order, begin)


def _parse_shape(text: str, array_label: str) -> tuple[int, ...]:
    # Python 2 wrote integers with a trailing L.
    lengths = [length.strip().removesuffix("L") for length in text.split(",")]
    if lengths[-1] == "":
        lengths.pop()
    are_numbers = all(length.isdecimal() and len(length) < 20 for length in lengths)
    is_bare_number = len(lengths) == 1 and "," not in text
    if len(lengths) > MAX_DIMENSIONS or is_bare_number or not are_numbers:
        raise ArrayError(f"{array_label} has a shape that is not that of an array")
    return tuple(map(int, lengths))


# Default limit of the bytes read from an archive; a setting and an environment variable
# override it.
DEFAULT_ARRAY_LIMIT = 1_000_000_000
ARRAY_LIMIT_VARIABLE = "ANIMTOOL_MAX_ARRAY_MB"
# Largest compression ratio of arrays above SMALL_ARRAY_BYTES. Zeros compress a
# thousandfold, but real arrays are less than half zeros.
MAX_COMPRESSION_RATIO = 100
SMALL_ARRAY_BYTES = 64_000_000
# Limit of an archive's directory: some hundred thousand arrays.
MAX_DIRECTORY_BYTES = 8_000_000
MAX_SHOWN_NAMES = 12
_COMPRESSION_METHODS = (0, 8)  # stored and deflated
_ENCRYPTED_FLAG = 0x1
# Exceptions that `zipfile` raises for damaged archives; MemoryError is none of them.
_DAMAGE_ERRORS = (
    OSError,
    ValueError,
    LookupError,
    EOFError,
    RuntimeError,
    OverflowError,
    struct.error,
    zlib.error,
)


@contextmanager
def archive_errors(path: Path) -> Iterator[None]:
    """Convert exceptions raised in a block that reads an archive to `ArrayError`."""
    try:
        yield
    except ArrayError:
        raise
    except FormatError as error:
        if error.code == "IO004":
            raise
        raise ArrayError(f"{path.name} {error.faults[0].message}") from error
    except Exception as error:
        from zipfile import BadZipFile  # every command imports this module

        if not isinstance(error, (*_DAMAGE_ERRORS, BadZipFile)):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise ArrayError(f"{path.name} cannot be read: {reason}") from error


class Archive:
    """An open archive, with the headers of its arrays."""

    def __init__(self, path: Path) -> None:
        """Open a file and read its directory; call it within `archive_errors`."""
        self._path = path
        self._file = open_input(path, None)
        try:
            head = self._file.read(len(NPY_MAGIC))
            if head == NPY_MAGIC:
                raise ArrayError(  # noqa: TRY301
                    f"{path.name} is a single array, as numpy.save writes, not an "
                    "archive of named ones, as numpy.savez does"
                )
            head += self._file.read(HEAD_BYTES - len(head))
            limited_file = _DirectoryLimitedFile(self._file)
            self._zip = _open_zip(limited_file, head, path)
            limited_file.limit = None
            self._members, self._duplicates = self._read_directory()
        except BaseException:
            self._file.close()
            raise
        self._headers_by_key: dict[str, ArrayHeader] = {}
        self._sizes_by_key: dict[str, int] = {}
        self._total_size = 0

    def close(self) -> None:
        """Close the archive and the file below it."""
        self._zip.close()
        self._file.close()

    def has(self, key: str) -> bool:
        """Return whether the archive contains an array."""
        return key in self._members

    def header(self, key: str, kinds: str = "fiub") -> ArrayHeader:
        """Return the header of an array; raise an error if its values are truncated."""
        if key not in self._headers_by_key:
            info = self._zip_entry(key)
            array_label = f"{self._path.name}#{key}"
            with self._zip.open(info) as file:
                header = read_header(file, array_label)
            self._file.check()
            if header.dtype.kind not in kinds:
                raise ArrayError(f"{array_label} contains {header.dtype}, not numbers")
            # A dimension of 0 makes the size 0, however large the other dimensions are.
            limit = max(info.file_size, SMALL_ARRAY_BYTES)
            min_count = math.prod(max(length, 1) for length in header.shape)
            is_implausible = not header.count and min_count > limit
            if header.begin + header.size > info.file_size or is_implausible:
                message = f"{array_label} is shorter than its shape {header.shape}"
                raise ArrayError(message)
            self._headers_by_key[key] = header
        return self._headers_by_key[key]

    def values(self, key: str) -> npt.NDArray[Any]:
        """Return the numbers of an array, read-only."""
        return self._values(key, self.header(key))

    @property
    def names(self) -> list[str]:
        """Names of the arrays, in the order of the archive."""
        return list(self._members)

    def texts(self, key: str) -> list[str]:
        """Return the texts of a one-dimensional array, such as names of joints."""
        header = self.header(key, "fiubU")
        if header.dtype.kind != "U" or len(header.shape) != 1:
            raise ArrayError(f"{self._path.name}#{key} is not a list of texts")
        return [str(text) for text in self._values(key, header)]

    def text(self, key: str) -> str:
        """Return the text of a zero-dimensional array."""
        header = self.header(key, "fiubU")
        if header.dtype.kind != "U" or header.shape:
            raise ArrayError(f"{self._path.name}#{key} is not text")
        return str(self._values(key, header))

    def _values(self, key: str, header: ArrayHeader) -> npt.NDArray[Any]:
        info = self._zip_entry(key)
        # Values are converted to float64 for computation, whatever type is stored.
        self._check_size(key, info, max(info.file_size, 8 * header.count))
        with self._zip.open(info) as file:
            file.read(header.begin)
            data = file.read(info.file_size - header.begin)
        self._file.check()
        if len(data) < header.size:
            raise ArrayError(f"{self._path.name}#{key} is truncated")
        if not header.count:
            return np.zeros(header.shape, header.dtype)
        numbers = np.frombuffer(data, header.dtype, header.count)
        numbers = numbers.reshape(header.shape, order=header.order)
        return np.require(numbers, requirements="A")

    def _read_directory(self) -> tuple[dict[str, ZipInfo], set[str]]:
        """Return the zip entries of the arrays by name, and the duplicate names."""
        members: dict[str, ZipInfo] = {}
        duplicates = set()
        for info in self._zip.infolist():
            if info.filename.endswith(".npy"):
                key = info.filename.removesuffix(".npy")
                if key in members:
                    duplicates.add(key)
                members[key] = info
        return members, duplicates

    def _zip_entry(self, key: str) -> ZipInfo:
        name, info = self._path.name, self._members.get(key)
        if info is None:
            names = list(self._members)[:MAX_SHOWN_NAMES]
            names_text = ", ".join(name[:40] for name in names) or "nothing"
            message = f"has no array {key!r}; its arrays are {names_text}"
            raise ArrayError(f"{name} {message}")
        if key in self._duplicates:
            raise ArrayError(f"{name} contains {key!r} twice")
        if info.flag_bits & _ENCRYPTED_FLAG:
            raise ArrayError(f"{name}#{key} is encrypted")
        if info.compress_type not in _COMPRESSION_METHODS:
            method = f"method {info.compress_type}, but numpy.savez uses 0 and 8"
            raise ArrayError(f"{name}#{key} is compressed by {method}")
        return info

    def _check_size(self, key: str, info: ZipInfo, size: int) -> None:
        """Raise an error for an array that is larger than the memory limit."""
        total_size = self._total_size - self._sizes_by_key.get(key, 0) + size
        max_size = max(SMALL_ARRAY_BYTES, MAX_COMPRESSION_RATIO * info.compress_size)
        is_plausible = size <= max_size
        if total_size > DEFAULT_ARRAY_LIMIT or not is_plausible:
            configured_limit = _configured_limit(self._path)
            if configured_limit is None or total_size > configured_limit:
                raise self._size_error(key, total_size, configured_limit, is_plausible)
        self._sizes_by_key[key], self._total_size = size, total_size

    def _size_error(
        self, key: str, size: int, configured_limit: int | None, is_plausible: bool
    ) -> ArrayError:
        needed_mb = math.ceil(size / 1e6)
        if configured_limit is None and not is_plausible:
            reason = f", more than {MAX_COMPRESSION_RATIO} times what it takes in the "
            reason += "file"
        else:
            limit = configured_limit
            limit_mb = (DEFAULT_ARRAY_LIMIT if limit is None else limit) // 1_000_000
            reason = f" with what was read before, and {limit_mb} are allowed"
        return ArrayError(
            f"{self._path.name}#{key} takes {needed_mb} MB of memory{reason}; "
            f"max_array_mb = {needed_mb} in animtool.toml, or "
            f"{ARRAY_LIMIT_VARIABLE}={needed_mb}, allows it"
        )


def _open_zip(file: _DirectoryLimitedFile, head: bytes, path: Path) -> ZipFile:
    """Open a zip archive; raise an error if its directory at the end is missing."""
    from zipfile import ZipFile, is_zipfile

    if is_zipfile(cast(Any, file)):
        return ZipFile(cast(Any, file))
    message = "is not an archive of arrays, as numpy.savez writes it"
    if not head:
        message = "is empty; copy or write it again"
    elif head.startswith(ZIP_MAGIC):
        message = "is incomplete: its end is missing; copy or write it again"
    elif (signature := signature_of(head)) is not None:
        message = f"is {signature.format_name}, not an archive of arrays"
        message += f"; {signature.hint}" if signature.hint else ""
    raise ArrayError(f"{path.name} {message}")


def _configured_limit(path: Path) -> int | None:
    """Return the configured size limit of archives [byte]; None for no limit."""
    text = os.environ.get(ARRAY_LIMIT_VARIABLE)
    if text:
        if not (text.isascii() and text.isdecimal() and len(text) < 10):
            message = f"{ARRAY_LIMIT_VARIABLE} is {text[:40]!r}, not a number of MB"
            raise ArrayError(message)
        return int(text) * 1_000_000
    limit_mb = find_config(path).max_array_mb
    return None if limit_mb is None else limit_mb * 1_000_000


class _DirectoryLimitedFile:
    """A file that limits the size of reads while the archive directory is read."""

    def __init__(self, file: InputFile) -> None:
        self.file = file
        self.limit: int | None = MAX_DIRECTORY_BYTES
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        if self.limit is not None and size > self.limit:
            message = f"its list of arrays takes {size} bytes, and {self.limit} are "
            from zipfile import BadZipFile

            raise BadZipFile(f"{message}read")
        return self.file.read(size)
