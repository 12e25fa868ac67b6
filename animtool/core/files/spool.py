"""A queue of arrays that spills to disk, for takes that do not fit in memory."""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Iterator, Sequence
from typing import IO

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OutputError

# Maximum kept in memory; the rest goes to a temporary file [bytes].
MAX_MEMORY_BYTES = 1 << 28


class Spool:
    """A queue of lists of arrays: up to ``max_bytes`` in memory, the others on disk."""

    def __init__(self, max_bytes: int = MAX_MEMORY_BYTES) -> None:
        self._free_memory = max_bytes
        self._buffered_lists: deque[Sequence[FloatArray]] = deque()
        self._list_lengths: deque[int] = deque()  # lengths of the lists in the file
        self._file: IO[bytes] | None = None

    def append(self, arrays: Sequence[FloatArray]) -> None:
        """Append a list of arrays: in memory up to the limit, then on disk."""
        size = sum(array.nbytes for array in arrays)
        if self._file is None and size <= self._free_memory:
            self._free_memory -= size
            self._buffered_lists.append(arrays)
            return
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115
            for array in arrays:
                np.save(self._file, array, allow_pickle=False)
            self._file.flush()
        except OSError as error:
            folder, reason = tempfile.gettempdir(), error.strerror or str(error)
            message = f"temporary data of a long take does not fit there: {reason}"
            hint = "free some space, or set TMPDIR to another folder"
            raise OutputError(Fault("OUT002", message, folder, (), hint)) from error
        self._list_lengths.append(len(arrays))

    def drain(self) -> Iterator[list[FloatArray]]:
        """Yield each list and then release it; may be called once."""
        while self._buffered_lists:
            yield list(self._buffered_lists.popleft())
        if self._file is None:
            return
        with self._file as file:
            file.seek(0)
            for length in self._list_lengths:
                yield [np.load(file, allow_pickle=False) for _ in range(length)]
