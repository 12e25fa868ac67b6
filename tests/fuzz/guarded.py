"""Arrays that end or begin where memory does: to go one number beyond is a crash."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any

import numpy as np

_PAGE = mmap.PAGESIZE
# Most arrays of a call are smaller.
_ROOM = 16 * _PAGE


class Guarded:
    """Places for arrays, each between two pages that nothing may read or write."""

    def __init__(self) -> None:
        self._places: list[mmap.mmap] = []
        self._used = 0

    def clear(self) -> None:
        """Take all places back, after a call."""
        self._used = 0

    def place(self, array: np.ndarray[Any, Any], *, at_end: bool) -> Any:
        """Return a copy that ends, or begins, at such a page."""
        if array.nbytes > _ROOM:
            memory = _guarded(-(-array.nbytes // _PAGE) * _PAGE)
        else:
            if self._used == len(self._places):
                self._places.append(_guarded(_ROOM))
            memory = self._places[self._used]
            self._used += 1
        begin = len(memory) - _PAGE - array.nbytes if at_end else _PAGE
        flat = np.frombuffer(memory, array.dtype, array.size, begin)
        copy = flat.reshape(array.shape)
        copy[...] = array
        return copy


def _guarded(size: int) -> mmap.mmap:
    memory = mmap.mmap(-1, size + 2 * _PAGE)
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    protect = ctypes.CDLL(None, use_errno=True).mprotect
    protect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for page in (address, address + _PAGE + size):
        if protect(page, _PAGE, 0):
            raise OSError(ctypes.get_errno(), "mprotect")
    return memory
