"""Single-threaded linear algebra for small matrices."""

from __future__ import annotations

import contextlib
import ctypes
import sysconfig
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

# Names of these functions in OpenBLAS, in the wheels of numpy and scipy, and elsewhere.
_SYMBOL_PATTERNS = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)
_LIBRARY_FOLDERS = ("numpy.libs", "scipy.libs", "numpy/.dylibs", "scipy/.dylibs")
_ThreadFunctions = tuple[Callable[[], int], Callable[[int], None]]


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Run linear algebra in the block in one thread, if the library allows that.

    The threads of OpenBLAS busy-wait for each other: for matrices of some hundred rows
    on a busy machine that takes much longer than a single thread, and another number of
    threads may change the last bits of results.
    """
    libraries = _libraries()
    previous_counts = [get_count() for get_count, _ in libraries]
    try:
        for _, set_count in libraries:
            set_count(1)
        yield
    finally:
        for (_, set_count), count in zip(libraries, previous_counts, strict=True):
            set_count(count)


@lru_cache(maxsize=1)
def _libraries() -> tuple[_ThreadFunctions, ...]:
    """Return functions that get and set the thread count of each loaded OpenBLAS."""
    import numpy.linalg
    import scipy.linalg  # noqa: F401  (a library is only one that is loaded)

    site_packages = Path(numpy.__file__).parent.parent
    roots = dict.fromkeys((site_packages, Path(sysconfig.get_path("platlib"))))
    libraries = []
    for folder in (root / name for root in roots for name in _LIBRARY_FOLDERS):
        for path in sorted(folder.glob("*openblas*")) if folder.is_dir() else ():
            with contextlib.suppress(OSError):
                libraries += _thread_functions(ctypes.CDLL(str(path)))
    return tuple(libraries)


def _thread_functions(library: ctypes.CDLL) -> list[_ThreadFunctions]:
    for name in _SYMBOL_PATTERNS:
        get_count = getattr(library, name.format("get"), None)
        set_count = getattr(library, name.format("set"), None)
        if get_count is not None and set_count is not None:
            return [(get_count, set_count)]
    return []
