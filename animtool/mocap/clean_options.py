"""What is to be cleaned out of a capture."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.options import option


@dataclass(frozen=True, slots=True)
class CleanOptions:
    """What to remove.

    Attributes:
        spikes: Longest spike that is removed [frames]; 0 leaves them.
        keep_noise: Whether noise stays: nothing is filtered.
        cutoff: Filter every joint at this frequency [Hz]; None filters each at the
            one that its noise asks for.
    """

    spikes: int = option(
        3,
        "count",
        "--spikes",
        metavar="FRAMES",
        help="Longest spike that is removed; 0 leaves them.",
    )
    keep_noise: bool = option(
        False,
        "switch",
        "--noise",
        choices=("filter", "keep"),
        help="Whether noise is filtered, each joint at the cut-off that its noise asks "
        "for, or kept.  [default: filter]",
    )
    cutoff: float | None = option(
        None,
        "amount",
        "--cutoff",
        metavar="HZ",
        help="Filter every joint at this frequency instead.",
    )
