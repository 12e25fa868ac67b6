"""What each stage of a scene costs: time, memory, and the error that it reports."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from animtool._types import FloatArray
from animtool.motion import Motion

# Written there, the peak of Linux begins anew at what is held.
_RESET = ("/proc/self/clear_refs", b"5")
_STATUS = "/proc/self/status"


@dataclass(slots=True)
class PeakMemory:
    """The most resident memory of this process since a moment, beyond what it held.

    On Linux the system counts the peak from any moment on. Elsewhere it knows one for
    the life of the process: a later peak that is lower than an earlier one is not seen,
    and the earlier one stands for it. Windows is not asked.
    """

    # What was held when it was begun [byte]; None where nothing says it.
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


@dataclass(slots=True)
class StageCost:
    """What a stage cost."""

    name: str  # of a source's file, or of a pass
    where: str  # its entry in the scene
    seconds: float = 0.0  # spent in it, without the stages before it [s]
    # Most memory that the process held while it ran, beyond what it held at the
    # beginning [byte], as `PeakMemory` knows it; None where it does not.
    peak: int | None = None
    # Largest distance in the world by which it missed what it was to reach [m]; None
    # where it reports none.
    error: float | None = None


@dataclass(slots=True)
class Meter:
    """Measures stages, of which one may wait for another within it.

    Blocks are read late: each stage is counted while its own code runs, and stands
    still while it waits for the stage before. Memory is looked at from `start` on.
    """

    stages: list[StageCost] = field(default_factory=list)
    _stack: list[StageCost] = field(default_factory=list)
    _since: float = 0.0
    _memory: PeakMemory = field(default_factory=PeakMemory)

    def start(self) -> None:
        """Begin to look at memory."""
        self._memory.begin()

    def stage(self, name: str, where: str) -> StageCost:
        """Return a new stage."""
        self.stages.append(StageCost(name, where))
        return self.stages[-1]

    @contextmanager
    def running(self, stage: StageCost) -> Iterator[None]:
        """Count what happens in a block for a stage."""
        self._turn()
        self._stack.append(stage)
        try:
            yield
        finally:
            self._turn()
            self._stack.pop()

    def blocks(self, stage: StageCost, blocks: Iterator[Motion]) -> Iterator[Motion]:
        """Yield blocks, and count for a stage what making them takes."""
        while True:
            with self.running(stage):
                block = next(blocks, None)
            if block is None:
                return
            yield block

    def curve(
        self, stage: StageCost, curve: Callable[[FloatArray], Motion] | None
    ) -> Callable[[FloatArray], Motion] | None:
        """Return a source that is a function of time, counted for a stage."""
        if curve is None:
            return None
        wanted = curve

        def counted(times: FloatArray) -> Motion:
            with self.running(stage):
                return wanted(times)

        return counted

    def _turn(self) -> None:
        """Count what has been since the last turn for the stage that ran."""
        now = time.perf_counter()
        peak = self._memory.taken()
        if self._stack:
            stage = self._stack[-1]
            stage.seconds += now - self._since
            if peak is not None:
                stage.peak = max(stage.peak or 0, peak)
        self._since = time.perf_counter()
