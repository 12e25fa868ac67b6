"""References from a file to arrays in npz files: where they lead, what is there."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from animtool._types import FloatArray
from animtool.documents.document import Document, Location

__all__ = [
    "ArrayHeader",
    "array_header",
    "load_array",
    "reference",
    "referred",
    "split_reference",
    "stored_array",
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


@dataclass(frozen=True, slots=True)
class ArrayHeader:
    """Shape of an array, and whether it holds floats or integers."""

    shape: tuple[int, ...]
    kind: str


def split_reference(text: str, default: str) -> tuple[str, str]:
    """Return file and array name of a reference.

    >>> split_reference("face.npz#smile", "deltas"), split_reference("a.npz", "points")
    (('face.npz', 'smile'), ('a.npz', 'points'))
    """
    name, _, key = text.partition("#")
    return name, key or default


def reference(folder: Path, roots: Sequence[Path], name: str) -> Path:
    """Return the file that a name means, seen from a folder.

    Raises:
        ValueError: It leads out of the roots.
    """
    try:
        path = (folder / name).resolve()
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{name!r} leads nowhere: {error}") from error
    if not any(path.is_relative_to(root.resolve()) for root in roots):
        shown = ", ".join(str(root) for root in roots)
        raise ValueError(f"{name!r} leads out of {shown}")
    return path


def referred(
    document: Document,
    location: Location,
    name: str,
    roots: Sequence[Path],
    code: str,
) -> Path | None:
    """Return the file that a document refers to; None, and a fault, where it may not.

    Args:
        document: Whose folder names start from.
        location: Where the name stands in it.
        name: As written.
        roots: Folders that references may lead into.
        code: Of the fault.
    """
    try:
        return reference(document.path.resolve().parent, roots, name)
    except ValueError as error:
        hint = "roots in animtool.toml allows more folders"
        document.add(code, location, str(error), hint)
        return None


def array_header(path: Path, key: str) -> ArrayHeader:
    """Return the header of an array, without its numbers.

    Raises:
        ValueError: There is no such file or array, or it holds Python objects.
    """
    with _archive(path) as archive:
        return _header(archive, path, key)


def stored_array(path: Path, key: str) -> npt.NDArray[Any]:
    """Return an array of numbers as it is stored.

    Raises:
        ValueError: There is no such file or array, or it holds Python objects.
    """
    with _archive(path) as archive:
        _header(archive, path, key)
        with archive.open(f"{key}.npy") as file:
            values: npt.NDArray[Any] = npy.read_array(file, allow_pickle=False)
            return values


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive; what it and what is done with it raise becomes ValueError."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except _UNREADABLE as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(f"{path.name} cannot be read: {reason}") from error


def _header(archive: zipfile.ZipFile, path: Path, key: str) -> ArrayHeader:
    files = [n for n in archive.namelist() if n.endswith(".npy")]
    names = [name.removesuffix(".npy") for name in files]
    if key not in names:
        shown = ", ".join(names[:12]) or "nothing"
        raise ValueError(f"{path.name} has no array {key!r}; it holds {shown}")
    stored = archive.getinfo(f"{key}.npy").file_size
    with archive.open(f"{key}.npy") as file:
        version = npy.read_magic(file)
        read = (
            npy.read_array_header_1_0
            if version == (1, 0)
            else npy.read_array_header_2_0
        )
        shape, _, dtype = read(file)
        stored -= file.tell()
    if dtype.hasobject:
        raise ValueError(f"{path.name}#{key} holds pickled Python objects")
    if dtype.kind not in "fiub":
        raise ValueError(f"{path.name}#{key} holds {dtype}, not numbers")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > stored:
        raise ValueError(f"{path.name}#{key} is shorter than its shape {shape}")
    return ArrayHeader(tuple(shape), dtype.kind)


def load_array(path: Path, key: str) -> FloatArray:
    """Return an array as float64.

    Raises:
        ValueError: There is no such file or array, it holds Python objects, or a
            value is not finite.
    """
    values = np.asarray(stored_array(path, key), np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"{path.name}#{key} holds a value that is not finite")
    return values
