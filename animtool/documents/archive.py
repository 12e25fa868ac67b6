"""npz archives, read without trusting the sizes that they declare.

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
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from zipfile import ZipInfo

MAGIC = b"\x93NUMPY"
# The same limits as numpy.load.
MAX_HEAD_BYTES = 10_000
MAX_DIMENSIONS = 8
# Size of the header-length field by format version [byte].
_WIDTHS = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
_ENTRY = re.compile(
    r"""\s*(?P<quote>['"])(?P<key>descr|fortran_order|shape)(?P=quote)\s*:\s*
    (?: (?P<mark>['"])(?P<descr>[<>|=]?[A-Za-z]\d{0,6}(?:\[\w{1,9}\])?)(?P=mark)
      | (?P<fortran_order>True|False)
      | \((?P<shape>[\dL,\ ]*)\) )\s*(?:,|$)""",
    re.ASCII | re.VERBOSE,
)
# Object and structured types are refused.
_OBJECTS = re.compile(r"""['"]descr['"]\s*:\s*['"]\|?O\d*['"]""")
_STRUCTURE = re.compile(r"""['"]descr['"]\s*:\s*\[""")


class ArrayError(ValueError):
    """An array or its archive cannot be read; the text says why."""


class ArrayFile(Protocol):
    """A seekable binary file that arrays are read from."""

    def read(self, size: int, /) -> bytes:
        """Return the next bytes."""


@dataclass(frozen=True, slots=True)
class StoredArray:
    """Location, type and shape of an array in a file."""

    shape: tuple[int, ...]  # of it
    dtype: np.dtype[Any]  # of its values
    order: Literal["C", "F"]  # how they follow each other, ``C`` or ``F``
    begin: int  # where they do [bytes]

    @property
    def count(self) -> int:
        """How many values there are."""
        return math.prod(self.shape)

    @property
    def size(self) -> int:
        """Bytes that the values take."""
        return self.count * self.dtype.itemsize


def read_head(file: ArrayFile, where: str) -> StoredArray:
    """Return the header of an array without reading its values."""
    start = file.read(len(MAGIC) + 2)
    version = tuple(start[len(MAGIC) :])
    width = _WIDTHS.get(version)  # type: ignore[arg-type]
    if not start.startswith(MAGIC) or width is None:
        raise ArrayError(f"{where} is not an array as numpy.savez writes it")
    length = int.from_bytes(file.read(width), "little")
    if length > MAX_HEAD_BYTES:
        raise ArrayError(
            f"{where} has a header of {length} bytes, which is not that of an array"
        )
    text = file.read(length)
    if len(text) < length:
        raise ArrayError(f"{where} ends in its header")
    return _parsed(text.decode("latin-1"), where, len(start) + width + length)


def _parsed(text: str, where: str, begin: int) -> StoredArray:
    if _OBJECTS.search(text):
        raise ArrayError(f"{where} contains pickled Python objects")
    if _STRUCTURE.search(text):
        raise ArrayError(f"{where} contains structures, not numbers")
    text = text.strip()
    fields: dict[str, str] = {}
    if text.startswith("{") and text.endswith("}"):
        rest = text[1:-1].strip()
        while rest and (match := _ENTRY.match(rest)):
            value = match[match["key"]]
            if value is None or match["key"] in fields:
                break
            fields[match["key"]] = value
            rest = rest[match.end() :].strip()
        if rest:
            fields.clear()
    if len(fields) < 3:
        raise ArrayError(f"{where} has a header that is not that of an array")
    try:
        dtype = np.dtype(fields["descr"])
    except (TypeError, ValueError) as error:
        raise ArrayError(f"{where} contains {fields['descr']}, not numbers") from error
    shape = _shape(fields["shape"], where)
    order: Literal["C", "F"] = "F" if fields["fortran_order"] == "True" else "C"
    return StoredArray(shape, dtype, order, begin)


def _shape(text: str, where: str) -> tuple[int, ...]:
    # Python 2 wrote integers with a trailing L.
    parts = [part.strip().removesuffix("L") for part in text.split(",")]
    if parts[-1] == "":
        parts.pop()
    wrong = len(parts) > MAX_DIMENSIONS or (len(parts) == 1 and "," not in text)
    if wrong or not all(part.isdecimal() and len(part) < 20 for part in parts):
        raise ArrayError(f"{where} has a shape that is not that of an array")
    return tuple(map(int, parts))


# The most that is read of an archive; a setting and a variable of the environment
# say otherwise.
MAX_BYTES = 1_000_000_000
ARRAY_LIMIT = "ANIMTOOL_MAX_ARRAY_MB"
# Zeros shrink a thousandfold; arrays that are worked with are less than half zeros.
# What stays small may be all zeros.
MAX_RATIO = 100
SMALL_BYTES = 64_000_000
# Limit of an archive's directory: some hundred thousand arrays.
MAX_LIST_BYTES = 8_000_000
MAX_SHOWN = 12
_METHODS = (0, 8)  # stored and deflated
_ENCRYPTED = 0x1
# What Python's reader of archives raises about damaged ones. That there is no memory
# left is none of it.
_DAMAGE = (
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
def reading(path: Path) -> Iterator[None]:
    """Turn exceptions of reading an archive into `ArrayError`.

    Raises:
        FormatError: The file changed while it was read (IO004).
    """
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

        if not isinstance(error, (*_DAMAGE, BadZipFile)):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise ArrayError(f"{path.name} cannot be read: {reason}") from error


class Archive:
    """An open archive and the headers of its arrays."""

    def __init__(self, path: Path) -> None:
        """Open a file and read its directory; call it within `reading`."""
        self._path = path
        self._file = open_input(path, None)
        try:
            if self._file.read(len(MAGIC)) == MAGIC:
                message = f"{path.name} is a single array, as numpy.save writes, not "
                message += "an archive of named ones, as numpy.savez does"
                raise ArrayError(message)  # noqa: TRY301
            bounded = _Bounded(self._file)
            from zipfile import ZipFile

            self._zip = ZipFile(cast(Any, bounded))
            bounded.limit = None
            self._members, self._twice = self._listed()
        except BaseException:
            self._file.close()
            raise
        self._heads: dict[str, StoredArray] = {}
        self._read: dict[str, int] = {}
        self._total = 0

    def close(self) -> None:
        """Close the file."""
        self._zip.close()
        self._file.close()

    def has(self, key: str) -> bool:
        """Return whether an array exists."""
        return key in self._members

    def head(self, key: str, kinds: str = "fiub") -> StoredArray:
        """Return an array's header, its length checked."""
        if key not in self._heads:
            info = self._member(key)
            where = f"{self._path.name}#{key}"
            with self._zip.open(info) as file:
                head = read_head(file, where)
            self._file.check()
            if head.dtype.kind not in kinds:
                raise ArrayError(f"{where} contains {head.dtype}, not numbers")
            # A dimension of 0 hides impossible other ones.
            most = max(info.file_size, SMALL_BYTES)
            empty = not head.count and math.prod(max(n, 1) for n in head.shape) > most
            if head.begin + head.size > info.file_size or empty:
                raise ArrayError(f"{where} is shorter than its shape {head.shape}")
            self._heads[key] = head
        return self._heads[key]

    def values(self, key: str) -> npt.NDArray[Any]:
        """Return a read-only array of numbers."""
        return self._values(key, self.head(key))

    @property
    def names(self) -> list[str]:
        """Names of the arrays, in the order of the archive."""
        return list(self._members)

    def texts(self, key: str) -> list[str]:
        """Return the texts of a one-dimensional array."""
        head = self.head(key, "fiubU")
        if head.dtype.kind != "U" or len(head.shape) != 1:
            raise ArrayError(f"{self._path.name}#{key} is not a list of texts")
        return [str(text) for text in self._values(key, head)]

    def text(self, key: str) -> str:
        """Return the text of a zero-dimensional array."""
        head = self.head(key, "fiubU")
        if head.dtype.kind != "U" or head.shape:
            raise ArrayError(f"{self._path.name}#{key} is not text")
        return str(self._values(key, head))

    def _values(self, key: str, head: StoredArray) -> npt.NDArray[Any]:
        info = self._member(key)
        # Computation is in float64, whatever is stored.
        self._check_size(key, info, max(info.file_size, 8 * head.count))
        with self._zip.open(info) as file:
            file.read(head.begin)
            data = file.read(info.file_size - head.begin)
        self._file.check()
        if len(data) < head.size:
            raise ArrayError(f"{self._path.name}#{key} is truncated")
        if not head.count:
            return np.zeros(head.shape, head.dtype)
        flat = np.frombuffer(data, head.dtype, head.count)
        return np.require(flat.reshape(head.shape, order=head.order), requirements="A")

    def _listed(self) -> tuple[dict[str, ZipInfo], set[str]]:
        """Return the arrays by name, and duplicate names."""
        members: dict[str, ZipInfo] = {}
        twice = set()
        for info in self._zip.infolist():
            if info.filename.endswith(".npy"):
                key = info.filename.removesuffix(".npy")
                if key in members:
                    twice.add(key)
                members[key] = info
        return members, twice

    def _member(self, key: str) -> ZipInfo:
        name, info = self._path.name, self._members.get(key)
        if info is None:
            names = [known[:40] for known in list(self._members)[:MAX_SHOWN]]
            shown = ", ".join(names) or "nothing"
            raise ArrayError(f"{name} has no array {key!r}; its arrays are {shown}")
        if key in self._twice:
            raise ArrayError(f"{name} contains {key!r} twice")
        if info.flag_bits & _ENCRYPTED:
            raise ArrayError(f"{name}#{key} is encrypted")
        if info.compress_type not in _METHODS:
            message = f"{name}#{key} is compressed by method {info.compress_type}, "
            raise ArrayError(f"{message}but numpy.savez uses 0 and 8")
        return info

    def _check_size(self, key: str, info: ZipInfo, size: int) -> None:
        """Refuse an array larger than the memory limit."""
        others = self._total - self._read.get(key, 0)
        dense = size <= max(SMALL_BYTES, MAX_RATIO * info.compress_size)
        if others + size > MAX_BYTES or not dense:
            stated = _stated_limit(self._path)
            if stated is None or others + size > stated:
                raise self._too_large(key, others + size, stated, dense)
        self._read[key], self._total = size, others + size

    def _too_large(
        self, key: str, size: int, stated: int | None, dense: bool
    ) -> ArrayError:
        needed = math.ceil(size / 1e6)
        message = f"{self._path.name}#{key} takes {needed} MB of memory"
        if stated is None and not dense:
            message += f", more than {MAX_RATIO} times what it takes in the file"
        else:
            limit = MAX_BYTES if stated is None else stated
            message += f" with what was read before, and {limit // 1_000_000} are "
            message += "allowed"
        return ArrayError(
            f"{message}; max_array_mb = {needed} in animtool.toml, or "
            f"{ARRAY_LIMIT}={needed}, allows it"
        )


def _stated_limit(path: Path) -> int | None:
    """Return the configured size limit of archives [byte]; None for no limit.

    Raises:
        ArrayError: The environment variable is not a number.
    """
    text = os.environ.get(ARRAY_LIMIT)
    if text:
        if not (text.isascii() and text.isdecimal() and len(text) < 10):
            raise ArrayError(f"{ARRAY_LIMIT} is {text[:40]!r}, not a number of MB")
        return int(text) * 1_000_000
    stated = find_config(path).max_array_mb
    return None if stated is None else stated * 1_000_000


class _Bounded:
    """A file whose reads of the archive's directory are limited in size."""

    def __init__(self, file: InputFile) -> None:
        self.file = file
        self.limit: int | None = MAX_LIST_BYTES
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        if self.limit is not None and size > self.limit:
            message = f"its list of arrays takes {size} bytes, and {self.limit} are "
            from zipfile import BadZipFile

            raise BadZipFile(f"{message}read")
        return self.file.read(size)
