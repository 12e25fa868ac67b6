"""How much memory this process holds, and has held, as its system tells it."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass

# Written there, the peak of Linux begins anew at what is held.
_RESET = ("/proc/self/clear_refs", b"5")
_STATUS = "/proc/self/status"


@dataclass(slots=True)
class PeakMemory:
    """The most resident memory of this process since a moment, beyond what it held.

    On Linux the system counts the peak from any moment on. Elsewhere it knows one for
    the life of the process: a later peak that is lower than an earlier one is not seen,
    and the earlier one stands for it. Windows is not asked.

    Attributes:
        base: What was held when it was begun [byte]; None where nothing says it.
    """

    base: int | None = None

    def begin(self) -> None:
        """Count from what is held now."""
        # What was held before, and is not any more, goes with the first look.
        self._taken()
        self.base = self._taken()

    def taken(self) -> int | None:
        """Return the most since it was asked last [byte]; None where not known."""
        if self.base is None:
            return None
        most = self._taken()
        return None if most is None else max(0, most - self.base)

    @staticmethod
    def _taken() -> int | None:
        most = _status_peak()
        if most is None:
            return _life_peak()
        path, word = _RESET
        with contextlib.suppress(OSError), open(path, "wb", 0) as file:  # noqa: PTH123
            file.write(word)
        return most


def _status_peak() -> int | None:
    """Return the peak as Linux counts it [byte]; None on other systems."""
    try:
        with open(_STATUS, "rb") as file:  # noqa: PTH123
            for line in file:
                if line.startswith(b"VmHWM:"):
                    return int(line.split()[1]) * 1024
    except (OSError, IndexError, ValueError):
        return None
    return None


def _life_peak() -> int | None:
    """Return the peak of the life of this process [byte]; None where not known."""
    if sys.platform == "win32":
        return None
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Macs count bytes, other systems blocks of 1024.
    return most if sys.platform == "darwin" else most * 1024
