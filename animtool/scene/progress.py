"""Saying how much of some work is done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias, TypeVar

__all__ = ["Progress", "share_of", "told"]

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
    """Yield items, and tell how many of them there were.

    Args:
        items: Made one after the other.
        count: How many there will be; 0 where nobody knows.
        progress: Told the share, 0 to 1, from before the first is made.
        size: How many one item is.
    """
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
