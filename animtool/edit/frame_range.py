"""Which frames are wanted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Frames ``first`` to ``last``, both included, every ``step``-th [time codes]."""

    first: int
    last: int
    step: int = 1
