"""What each stage of a scene costs: time, memory, and the error that it reports."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from animtool._types import FloatArray
from animtool.take import Motion

__all__ = ["Meter", "StageCost"]


@dataclass(slots=True)
class StageCost:
    """What a stage cost.

    Attributes:
        name: Of a source's file, or of a pass.
        where: Its entry in the scene.
        seconds: Spent in it, without the stages before it [s].
        peak: Most memory of Python and of arrays that was held while it ran, beyond
            what was held at the beginning [byte].
        error: Largest distance in the world by which it missed what it was to reach
            [m]; None where it reports none.
    """

    name: str
    where: str
    seconds: float = 0.0
    peak: int = 0
    error: float | None = None


@dataclass(slots=True)
class Meter:
    """Measures stages, of which one may wait for another within it.

    Blocks are read late: each stage is counted while its own code runs, and stands
    still while it waits for the stage before. Memory is traced from `start` on, which
    makes all a little slower.

    Attributes:
        stages: In order.
    """

    stages: list[StageCost] = field(default_factory=list)
    _stack: list[StageCost] = field(default_factory=list)
    _since: float = 0.0
    _base: int = 0

    def start(self) -> None:
        """Begin to trace memory."""
        if not tracemalloc.is_tracing():
            tracemalloc.start()
        self._base, _ = tracemalloc.get_traced_memory()

    def stop(self) -> None:
        """Trace memory no more."""
        tracemalloc.stop()

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
        if tracemalloc.is_tracing():
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
        else:
            peak = self._base
        if self._stack:
            stage = self._stack[-1]
            stage.seconds += now - self._since
            stage.peak = max(stage.peak, peak - self._base)
        self._since = now
