"""What of marker trajectories is to be repaired."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from animtool.options import option, or_more


@dataclass(frozen=True, slots=True)
class FillOptions:
    """What to repair.

    Attributes:
        keep_gaps: Whether gaps stay.
        keep_spikes: Whether spikes stay.
        keep_swaps: Whether swapped names stay.
        longest: Longest gap that is filled [s]; None fills all that can be.
    """

    keep_gaps: bool = option(
        False,
        "switch",
        "--gaps",
        choices=("fill", "keep"),
        help="Whether gaps are filled, or kept.  [default: fill]",
    )
    keep_spikes: bool = option(
        False,
        "switch",
        "--spikes",
        choices=("remove", "keep"),
        help="Whether spikes are removed, and filled as gaps, or kept.  "
        "[default: remove]",
    )
    keep_swaps: bool = option(
        False,
        "switch",
        "--swaps",
        choices=("repair", "keep"),
        help="Whether names that were exchanged are put right, or kept.  "
        "[default: repair]",
    )
    longest: Annotated[float | None, or_more(0, "MKR022", finite=True)] = option(
        None,
        "amount",
        "--longest",
        metavar="SECONDS",
        help="Leave gaps that are longer.  [default: all are filled]",
    )
