"""Resolves references to arrays in npz files and reads the arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import open_input
from animtool.documents.archive import Archive, ArrayHeader, archive_errors

# Files open at once: systems allow a few hundred.
MAX_OPEN_ARCHIVES = 16


class Archives:
    """Cache of open archives, each opened and indexed once.

    Close it as soon as the arrays are read: Windows cannot replace an open file.

    >>> with Archives() as archives:
    ...     archives.header(Path("none.npz"), "points")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    animtool.documents.archive.ArrayError: none.npz does not exist
    """

    def __init__(self) -> None:
        self._open_archives: dict[Path, Archive] = {}

    def __enter__(self) -> Archives:
        """Return the cache for use in a ``with`` block."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close all archives."""
        while self._open_archives:
            self._open_archives.popitem()[1].close()

    def header(self, path: Path, key: str) -> ArrayHeader:
        """Return the type and shape of an array without reading its values."""
        with archive_errors(path):
            return self._archive(path).header(key)

    def load_stored(self, path: Path, key: str) -> npt.NDArray[Any]:
        """Return an array with its stored type, read-only."""
        with archive_errors(path):
            return self._archive(path).values(key)

    def has(self, path: Path, key: str) -> bool:
        """Return whether a file has an array of that name."""
        with archive_errors(path):
            return self._archive(path).has(key)

    def text(self, path: Path, key: str) -> str:
        """Return a text stored as an array.

        Raises:
            ValueError: The file or text is missing.
        """
        with archive_errors(path):
            return self._archive(path).text(key)

    def texts(self, path: Path, key: str) -> list[str]:
        """Return a list of texts stored as a one-dimensional array."""
        with archive_errors(path):
            return self._archive(path).texts(key)

    def names(self, path: Path) -> list[str]:
        """Return the names of the arrays in a file, in the file's order."""
        with archive_errors(path):
            return self._archive(path).names

    def load(self, path: Path, key: str) -> FloatArray:
        """Return an array as read-only float64.

        Raises:
            ValueError: The array cannot be read, or a value is not finite.
            FormatError: The file changed while it was read (IO004).
        """
        values = np.asarray(self.load_stored(path, key), np.float64)
        if not np.isfinite(values).all():
            raise ValueError(f"{path.name}#{key} contains a value that is not finite")
        return values

    def _archive(self, path: Path) -> Archive:
        archive = self._open_archives.pop(path, None) or Archive(path)
        if len(self._open_archives) >= MAX_OPEN_ARCHIVES:
            self._open_archives.pop(next(iter(self._open_archives))).close()
        # Least recently used first.
        self._open_archives[path] = archive
        return archive


@contextmanager
def open_arrays(
    path: Path, error_from_message: Callable[[str], AnimtoolError]
) -> Iterator[Archives]:
    """Open a file of arrays; ``error_from_message`` builds errors of faulty ones."""
    # A missing or unreadable file raises the common error of all files.
    open_input(path, None).close()
    try:
        with Archives() as archives:
            yield archives
    except ValueError as error:
        raise error_from_message(
            str(error).removeprefix(path.name).lstrip("# ")
        ) from error


def load_array(path: Path, key: str) -> FloatArray:
    """Return one array as float64; see `Archives.load`."""
    with Archives() as archives:
        return archives.load(path, key)
