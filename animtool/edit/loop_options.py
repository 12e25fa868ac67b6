"""Options of loops."""

from __future__ import annotations

from animtool.core.options import inherits_docs, option
from animtool.core.record import dataclass


@inherits_docs
@dataclass(frozen=True, slots=True)
class LoopOptions:
    """The cycle of a loop, and the number of its repetitions.

    Attributes:
        find: Whether to search for the best cycle between ``first`` and ``last``.
        shortest: Minimum length of the cycle [s].
        longest: Maximum length of the cycle [s].
    """

    first: float | None = option(None, "frame", help="The first frame of the cycle.")
    last: float | None = option(
        None, "frame", help="The frame where the first pose recurs."
    )
    find: bool = False
    shortest: float = option(
        0.25, "amount", metavar="SECONDS", help="Shortest cycle to search for."
    )
    longest: float = option(
        10.0, "amount", metavar="SECONDS", help="Longest cycle to search for."
    )
    repeats: int = option(1, "count", help="Number of repeats.", min_count=1)
    blend: int = option(
        10,
        "count",
        metavar="FRAMES",
        help="Frames before the seam over which the poses are blended.",
    )
