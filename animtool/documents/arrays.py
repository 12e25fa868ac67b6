"""References from a file to arrays in npz files: where they lead, what is there."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from animtool._types import FloatArray
from animtool.inputs import note_input

__all__ = [
    "Archives",
    "ArrayHeader",
    "load_array",
]

# What damaged archives, encrypted ones and damaged headers raise.
_UNREADABLE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    MemoryError,
    RuntimeError,
    tokenize.TokenError,
)

# Files held open at once: systems allow a few hundred.
MOST_OPEN = 16


@dataclass(frozen=True, slots=True)
class ArrayHeader:
    """Shape of an array, and whether it holds floats or integers."""

    shape: tuple[int, ...]
    kind: str


class Archives:
    """Archives of arrays, each opened once and its directory read once while this is.

    To be closed as soon as the arrays are read: Windows replaces no file that is open.

    >>> with Archives() as archives:
    ...     archives.header(Path("none.npz"), "points")
    Traceback (most recent call last):
    ValueError: none.npz cannot be read: No such file or directory
    """

    def __init__(self) -> None:
        self._open: dict[Path, _Archive] = {}

    def __enter__(self) -> Archives:
        """Return itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the files."""
        while self._open:
            self._open.popitem()[1].close()

    def header(self, path: Path, key: str) -> ArrayHeader:
        """Return the header of an array, without its numbers.

        Raises:
            ValueError: There is no such file or array, or it holds Python objects.
        """
        with _reading(path):
            return self._archive(path).member(key).header

    def stored(self, path: Path, key: str) -> npt.NDArray[Any]:
        """Return an array of numbers as it is stored, not to be written to.

        Raises:
            ValueError: There is no such file or array, or it holds Python objects.
        """
        with _reading(path):
            return self._archive(path).values(key)

    def load(self, path: Path, key: str) -> FloatArray:
        """Return an array as float64, not to be written to.

        Raises:
            ValueError: There is no such file or array, it holds Python objects, or a
                value is not finite.
        """
        values = np.asarray(self.stored(path, key), np.float64)
        if not np.isfinite(values).all():
            raise ValueError(f"{path.name}#{key} holds a value that is not finite")
        return values

    def _archive(self, path: Path) -> _Archive:
        found = self._open.pop(path, None) or _Archive(path)
        if len(self._open) >= MOST_OPEN:
            self._open.pop(next(iter(self._open))).close()
        # The one asked for last stands last.
        self._open[path] = found
        return found


def load_array(path: Path, key: str) -> FloatArray:
    """Return one array as float64; see `Archives.load`."""
    with Archives() as archives:
        return archives.load(path, key)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Make a ValueError of what an archive and reading it raise."""
    try:
        yield
    except _UNREADABLE as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(f"{path.name} cannot be read: {reason}") from error


def _is_bare(path: Path) -> bool:
    """Return whether a file is one array by itself (``.npy``)."""
    with path.open("rb") as file:
        return file.read(len(npy.MAGIC_PREFIX)) == npy.MAGIC_PREFIX


@dataclass(frozen=True, slots=True)
class _Member:
    """An array in an archive.

    Attributes:
        header: Shape and kind.
        dtype: Of its numbers.
        order: How they stand in the file, ``C`` or ``F``.
        begin: Where they do [bytes].
    """

    header: ArrayHeader
    dtype: np.dtype[Any]
    order: Literal["C", "F"]
    begin: int


class _Archive:
    """An open archive, and what is known of its arrays."""

    def __init__(self, path: Path) -> None:
        self._path = path
        note_input(path)
        if _is_bare(path):
            message = f"{path.name} is a single array, as numpy.save writes, not an "
            raise ValueError(f"{message}archive of named ones, as numpy.savez does")
        self._zip = zipfile.ZipFile(path)
        self._members: dict[str, _Member] = {}

    def close(self) -> None:
        self._zip.close()

    def member(self, key: str) -> _Member:
        if key not in self._members:
            self._members[key] = self._read_member(key)
        return self._members[key]

    def values(self, key: str) -> npt.NDArray[Any]:
        made = self.member(key)
        data = self._zip.read(f"{key}.npy")
        shape, count = made.header.shape, math.prod(made.header.shape)
        values = np.frombuffer(data, made.dtype, count, made.begin) if count else None
        if values is None:
            return np.zeros(shape, made.dtype)
        return np.require(values.reshape(shape, order=made.order), requirements="A")

    def _read_member(self, key: str) -> _Member:
        files = [n for n in self._zip.namelist() if n.endswith(".npy")]
        names = [name.removesuffix(".npy") for name in files]
        if key not in names:
            shown = ", ".join(names[:12]) or "nothing"
            message = f"{self._path.name} has no array {key!r}; it holds {shown}"
            raise ValueError(message)
        with self._zip.open(f"{key}.npy") as file:
            version = npy.read_magic(file)
            read = (
                npy.read_array_header_1_0
                if version == (1, 0)
                else npy.read_array_header_2_0
            )
            shape, fortran, dtype = read(file)
            begin = file.tell()
        stored = self._zip.getinfo(f"{key}.npy").file_size - begin
        where = f"{self._path.name}#{key}"
        if dtype.hasobject:
            raise ValueError(f"{where} holds pickled Python objects")
        if dtype.kind not in "fiub":
            raise ValueError(f"{where} holds {dtype}, not numbers")
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > stored:
            raise ValueError(f"{where} is shorter than its shape {shape}")
        header = ArrayHeader(tuple(shape), dtype.kind)
        return _Member(header, dtype, "F" if fortran else "C", begin)
