"""Progress, prefetching and cost of work that is done block by block."""

from __future__ import annotations

import contextlib
import contextvars
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, MutableMapping
from contextlib import contextmanager
from dataclasses import field
from typing import TYPE_CHECKING, ClassVar, TypeAlias, TypeVar

from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.core.array_types import FloatArray
    from animtool.motion.motion import Motion

ItemT = TypeVar("ItemT")

# Called with the fraction done, 0 to 1; None if progress is not shown.
Progress: TypeAlias = Callable[[float], None] | None


def with_progress(
    blocks: Iterator[Motion], frame_count: int, progress: Callable[[float], None]
) -> Iterator[Motion]:
    """Yield blocks, and report the fraction of all frames that has been yielded."""
    frames_done = 0
    progress(0.0)
    for block in blocks:
        yield block
        frames_done += block.frames
        progress(min(frames_done / frame_count, 1.0))


def timed_items(
    items: Iterator[ItemT], seconds: MutableMapping[str, float], stage: str
) -> Iterator[ItemT]:
    """Yield items and add the time they take to a stage."""
    while True:
        start_time = time.perf_counter()
        item = next(items, None)
        seconds[stage] += time.perf_counter() - start_time
        if item is None:
            return
        yield item


@dataclass(frozen=True, slots=True)
class _EndOfItems:
    error: BaseException | None = None


def prefetch(items: Iterator[ItemT], max_prefetched: int = 3) -> Generator[ItemT]:
    """Yield the items of an iterator; a thread computes up to ``max_prefetched`` ahead.

    This helps if the iterator spends its time in kernels that release the GIL. An error
    is raised after the items before it. Closing the generator stops the thread.

    >>> list(prefetch(iter("abc")))
    ['a', 'b', 'c']
    """
    import queue

    item_queue: queue.Queue[ItemT | _EndOfItems] = queue.Queue(max_prefetched)
    stop_event = threading.Event()

    def put_item(item: ItemT | _EndOfItems) -> None:
        while not stop_event.is_set():
            with contextlib.suppress(queue.Full):
                item_queue.put(item, timeout=0.1)
                return

    def produce_items() -> None:
        try:
            for item in items:
                put_item(item)
                if stop_event.is_set():
                    return
            put_item(_EndOfItems())
        except BaseException as error:
            put_item(_EndOfItems(error))

    # Context variables, such as the record of inputs, apply here too.
    context = contextvars.copy_context()
    thread = threading.Thread(
        target=context.run, args=(produce_items,), name="animtool-prefetch", daemon=True
    )
    thread.start()
    try:
        while True:
            item = item_queue.get()
            if isinstance(item, _EndOfItems):
                if item.error is not None:
                    raise item.error
                return
            yield item
    finally:
        stop_event.set()
        thread.join()


def part_progress(progress: Progress, i: int, count: int) -> Progress:
    """Return the progress callback for one of several equal tasks."""
    if progress is None or count == 1:
        return progress
    progress_of_all = progress
    return lambda fraction: progress_of_all((i + fraction) / count)


class BlockProgress:
    """Progress of blocks that are read, passed through passes and consumed.

    While a pass works on a block, its progress counts from the fraction of the last
    finished block up to the fraction that the source has read.
    """

    def __init__(self, show: Callable[[float], None], pass_count: int) -> None:
        """Create progress at 0."""
        self._show, self._pass_count = show, max(pass_count, 1)
        self._finished_fraction, self._shown, self._read_fraction = 0.0, 0.0, 0.0
        show(0.0)

    def read(self, fraction: float) -> None:
        """Record the fraction of the source that has been read."""
        self._read_fraction = max(self._read_fraction, fraction)

    def of_pass(self, index: int) -> Callable[[float], None]:
        """Return the callback by which a pass reports its fraction done."""

        def report_fraction(fraction: float) -> None:
            # A source that reports no progress is read as a whole.
            begin, end = self._finished_fraction, self._read_fraction or 1.0
            pass_fraction = (index + fraction) / self._pass_count
            self._show_fraction(begin + (end - begin) * pass_fraction)

        return report_fraction

    def blocks(self, items: Iterator[ItemT]) -> Iterator[ItemT]:
        """Yield finished blocks; after the last the fraction is 1."""
        for item in items:
            yield item
            self._show_fraction(self._read_fraction)
            self._finished_fraction = self._shown
        self._show_fraction(1.0)

    def _show_fraction(self, fraction: float) -> None:
        if fraction > self._shown:
            self._shown = min(fraction, 1.0)
            self._show(self._shown)


class ProgressPhases:
    """Progress of work with an unknown number of phases.

    Each phase gets half of the remaining fraction.
    """

    def __init__(self, show: Callable[[float], None]) -> None:
        """Create progress at 0."""
        self._show, self._shown = show, 0.0

    def phase(self, *, is_last: bool = False) -> Callable[[float], None]:
        """Begin a phase; return the callback for its fraction done.

        The last phase gets all of the remaining fraction.
        """
        start_fraction = self._shown
        phase_fraction = (1.0 - start_fraction) * (1.0 if is_last else 0.5)

        def report_fraction(fraction: float) -> None:
            fraction_done = start_fraction + phase_fraction * min(fraction, 1.0)
            if fraction_done > self._shown:
                self._shown = fraction_done
                self._show(fraction_done)

        return report_fraction


class TimeProgress:
    """Progress of simulations that advance in time simultaneously."""

    def __init__(self, show: Callable[[float], None], last: float) -> None:
        """Create progress at 0; ``last`` is the end of the simulation [s]."""
        self._show, self._last = show, last
        self._fractions: list[float] = []

    def clock(self, begin: float) -> Callable[[float], None]:
        """Return the callback of a simulation's time; it starts at ``begin`` [s]."""
        index, duration = len(self._fractions), self._last - begin
        self._fractions.append(0.0)

        def report_time(t: float) -> None:
            self._fractions[index] = (t - begin) / duration if duration > 0 else 1.0
            self._show(sum(self._fractions) / len(self._fractions))

        return report_time


# Writing this resets the peak that Linux counts to the current level.
_RESET_PEAK_COMMAND = ("/proc/self/clear_refs", b"5")
_STATUS_PATH = "/proc/self/status"


@dataclass(slots=True)
class PeakMemory:
    """Peak resident memory of this process above its level at the start.

    On Linux the peak can be reset at any time. Other systems report only the peak since
    the process started, so a later, lower peak is hidden. Windows is not supported.
    """

    # Level when measuring began [byte]; None if unknown.
    base_bytes: int | None = None

    def begin(self) -> None:
        """Reset the base level to the current one."""
        # The first sample discards memory that was freed before.
        self._peak_bytes()
        self.base_bytes = self._peak_bytes()

    def peak_since_last_call(self) -> int | None:
        """Return the memory peak since the last call [byte]; None if unknown."""
        if self.base_bytes is None:
            return None
        peak = self._peak_bytes()
        return None if peak is None else max(0, peak - self.base_bytes)

    @staticmethod
    def _peak_bytes() -> int | None:
        peak = _status_peak()
        if peak is None:
            return _process_peak()
        path, command = _RESET_PEAK_COMMAND
        with contextlib.suppress(OSError), open(path, "wb", 0) as file:  # noqa: PTH123
            file.write(command)
        return peak


def _status_peak() -> int | None:
    """Return the peak memory reported by Linux [byte]; None on other systems."""
    try:
        with open(_STATUS_PATH, "rb") as file:  # noqa: PTH123
            for line in file:
                if line.startswith(b"VmHWM:"):
                    return int(line.split()[1]) * 1024
    except (OSError, IndexError, ValueError):
        return None
    return None


def _process_peak() -> int | None:
    """Return the peak memory of this process so far [byte]; None if unknown."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts bytes, other systems blocks of 1024.
    return peak if sys.platform == "darwin" else peak * 1024


@dataclass(slots=True)
class StageCost:
    """Time and memory of one stage: of a source, or of a pass."""

    name: str  # name of a source's file, or of a pass
    where: str  # its entry in the scene
    seconds: float = 0.0  # time spent in it, without the stages before it [s]
    # Peak memory of the process while it ran, above the level at the beginning [byte];
    # None if `PeakMemory` does not know it.
    peak: int | None = None
    # Largest distance from its targets in the world [m]; None if it reports none.
    error: float | None = None
    json_keys: ClassVar[str] = "stage=name where seconds~ peak_bytes=peak error"


@dataclass(frozen=True, slots=True)
class OutputCost:
    """Time, memory and size of one output."""

    name: str  # the file
    seconds: float | None  # as in `StageCost`; None is unknown
    error: float | None  # largest error [m]; None is unknown
    where: ClassVar[str] = ""
    peak: ClassVar[int | None] = None
    json_keys: ClassVar[str] = "output=name seconds error"


@dataclass(frozen=True, slots=True)
class BakeStats:
    """Costs of all stages and outputs of a bake."""

    costs: list[StageCost | OutputCost]
    json_keys: ClassVar[str] = "stats=costs"


@dataclass(slots=True)
class Meter:
    """Measures the cost of stages, which may nest.

    Blocks are computed lazily: a stage is charged while its own code runs, not while it
    waits for the stage before. Memory is measured after `start`.
    """

    stages: list[StageCost] = field(default_factory=list)
    _stack: list[StageCost] = field(default_factory=list)
    _last_time: float = 0.0
    _memory: PeakMemory = field(default_factory=PeakMemory)

    def start(self) -> None:
        """Start to measure memory; before this, only time is measured."""
        self._memory.begin()

    def stage(self, name: str, where: str) -> StageCost:
        """Add a stage; return the record to which its time and memory are charged."""
        self.stages.append(StageCost(name, where))
        return self.stages[-1]

    @contextmanager
    def running(self, stage: StageCost) -> Iterator[None]:
        """Charge the time of a block to a stage."""
        self._charge()
        self._stack.append(stage)
        try:
            yield
        finally:
            self._charge()
            self._stack.pop()

    def blocks(self, stage: StageCost, blocks: Iterator[Motion]) -> Iterator[Motion]:
        """Yield blocks and charge a stage for computing them."""
        while True:
            with self.running(stage):
                block = next(blocks, None)
            if block is None:
                return
            yield block

    def curve(
        self, stage: StageCost, curve: Callable[[FloatArray], Motion] | None
    ) -> Callable[[FloatArray], Motion] | None:
        """Return a curve whose evaluations are charged to a stage."""
        if curve is None:
            return None
        source = curve

        def timed_curve(times: FloatArray) -> Motion:
            with self.running(stage):
                return source(times)

        return timed_curve

    def _charge(self) -> None:
        """Charge the time since the last call to the running stage."""
        current_time = time.perf_counter()
        peak = self._memory.peak_since_last_call()
        if self._stack:
            stage = self._stack[-1]
            stage.seconds += current_time - self._last_time
            if peak is not None:
                stage.peak = max(stage.peak or 0, peak)
        self._last_time = time.perf_counter()
