"""Saying how much of some work is done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias, TypeVar

Item = TypeVar("Item")

# Told the share done, 0 to 1; None where nobody looks.
Progress: TypeAlias = Callable[[float], None] | None


def _one(_: object) -> int:
    """Return how many an item is that stands for itself."""
    return 1


def told(
    items: Iterator[Item],
    count: int,
    progress: Progress,
    size: Callable[[Item], int] = _one,
) -> Iterator[Item]:
    """Yield items, and tell how many of them there were."""
    done = 0
    if progress is not None:
        progress(0.0)
    for item in items:
        yield item
        done += size(item)
        if progress is not None and count:
            progress(min(done / count, 1.0))


def share_of(progress: Progress, i: int, count: int) -> Progress:
    """Return what shows the progress of one of several as that of all."""
    if progress is None or count == 1:
        return progress
    shown = progress
    return lambda share: shown((i + share) / count)


class BlockProgress:
    """Progress of blocks of frames that are read, changed by passes and handed on.

    What a pass tells while it works on a block moves the share from where the last
    block was handed on towards what the source has read.
    """

    def __init__(self, show: Callable[[float], None], passes: int) -> None:
        """Begin at 0."""
        self._show, self._passes = show, max(passes, 1)
        self._begin, self._shown, self._read = 0.0, 0.0, 0.0
        show(0.0)

    def read(self, share: float) -> None:
        """Note which share of the source was read."""
        self._read = max(self._read, share)

    def of_pass(self, index: int) -> Callable[[float], None]:
        """Return what a pass tells its share of the current work."""

        def tell(share: float) -> None:
            # A source that does not tell is read whole.
            end = self._read or 1.0
            part = (index + share) / self._passes
            self._to(self._begin + (end - self._begin) * part)

        return tell

    def blocks(self, items: Iterator[Item]) -> Iterator[Item]:
        """Yield blocks that are done; after the last the share is 1."""
        for item in items:
            yield item
            self._to(self._read)
            self._begin = self._shown
        self._to(1.0)

    def _to(self, share: float) -> None:
        if share > self._shown:
            self._shown = min(share, 1.0)
            self._show(self._shown)


class Phases:
    """Progress of work in phases, of which nobody knows how many there will be.

    Each phase gets half of what is left.
    """

    def __init__(self, show: Callable[[float], None]) -> None:
        """Begin at 0."""
        self._show, self._floor, self._shown = show, 0.0, 0.0

    def phase(self) -> Callable[[float], None]:
        """Begin a phase; return what it tells its share."""
        self._floor = self._shown
        return self._telling(0.5)

    def last(self) -> Callable[[float], None]:
        """Begin the last phase, which gets all that is left."""
        self._floor = self._shown
        return self._telling(1.0)

    def _telling(self, part: float) -> Callable[[float], None]:
        floor = self._floor

        def tell(share: float) -> None:
            now = floor + (1.0 - floor) * part * min(share, 1.0)
            if now > self._shown:
                self._shown = now
                self._show(now)

        return tell


class TimeProgress:
    """Progress of simulations that go through time side by side."""

    def __init__(self, show: Callable[[float], None], last: float) -> None:
        """Begin at 0.

        last: the last time that will be asked for [s].
        """
        self._show, self._last = show, last
        self._shares: list[float] = []

    def clock(self, begin: float) -> Callable[[float], None]:
        """Return what a simulation tells the time that it reached.

        Args:
            begin: When it begins [s].
        """
        index, span = len(self._shares), self._last - begin
        self._shares.append(0.0)

        def tell(t: float) -> None:
            self._shares[index] = (t - begin) / span if span > 0 else 1.0
            self._show(sum(self._shares) / len(self._shares))

        return tell
