"""Options of the commands and passes that solve captures, each with its default."""

from __future__ import annotations

from typing import Annotated

from animtool.core.options import described, option, or_more
from animtool.core.record import dataclass


@described
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
        metavar="FRAMES",
        help="Longest spike that is removed; 0 leaves them.",
    )
    keep_noise: bool = option(
        False,
        "switch",
        flag="noise",
        choices=("filter", "keep"),
        help="Whether noise is filtered, each joint at the cut-off that its noise asks "
        "for, or kept.  [default: filter]",
    )
    cutoff: float | None = option(
        None,
        "amount",
        metavar="HZ",
        help="Filter every joint at this frequency instead.",
    )


@described
@dataclass(frozen=True, slots=True)
class TriangulateOptions:
    """How points are triangulated.

    Attributes:
        noise: Standard deviation of a pixel's axis [px]; None measures it.
        keep_moved: Whether cameras that moved or are stale take part all the same.
    """

    noise: float | None = option(
        None,
        "amount",
        metavar="PIXELS",
        help="Standard deviation of observations.  [default: measured]",
    )
    gate: float = option(
        5.0,
        "amount",
        metavar="SIGMAS",
        help="Leave out observations that are farther off than this many standard "
        "deviations.",
    )
    min_angle: float = option(
        0.03490658503988659,
        "angle",
        help="Least angle between rays; points that only flatter ones see are left "
        "out.",
        written=2.0,
    )
    keep_moved: bool = option(
        False,
        "switch",
        flag="moved",
        choices=("leave-out", "keep"),
        help="Whether cameras that moved after calibration are left out where they "
        "did, or kept.  [default: leave-out]",
    )


@described
@dataclass(frozen=True, slots=True)
class FaceOptions:
    """How landmarks become weights."""

    smooth: float = option(
        1.0,
        "amount",
        metavar="FACTOR",
        help="How much changes from frame to frame cost: 0 is nothing.",
    )
    head: str | None = option(
        None,
        "choice",
        choices=("rotation", "pose", "none"),
        help="Head motion: turn the head joint, also move the root, or leave it out.  "
        "[default: rotation, of a head-mounted camera none]",
    )
    neutral: int | None = option(
        None,
        "count",
        metavar="FRAME",
        help="Frame, from 0, in which the actor's face is neutral: proportions are "
        "then the actor's.",
    )


@described
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
        flag="gaps",
        choices=("fill", "keep"),
        help="Whether gaps are filled, or kept.  [default: fill]",
    )
    keep_spikes: bool = option(
        False,
        "switch",
        flag="spikes",
        choices=("remove", "keep"),
        help="Whether spikes are removed, and filled as gaps, or kept.  "
        "[default: remove]",
    )
    keep_swaps: bool = option(
        False,
        "switch",
        flag="swaps",
        choices=("repair", "keep"),
        help="Whether names that were exchanged are put right, or kept.  "
        "[default: repair]",
    )
    longest: Annotated[float | None, or_more(0, "CAP001", finite=True)] = option(
        None,
        "amount",
        metavar="SECONDS",
        help="Leave gaps that are longer.  [default: all are filled]",
    )


@described
@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How to solve.

    Attributes:
        acceleration: Of joints that is usual [rad/s²]; less is smoother.
    """

    noise: float = option(
        0.0005,
        "length",
        written="0.5mm",
        metavar="LENGTH",
        help="How far a marker may be off its place on the bone; skin moves. More is "
        "allowed where the capture shows more.",
    )
    acceleration: float = option(
        100.0,
        "amount",
        metavar="RAD/S²",
        help="Acceleration of joints that is usual; less is smoother.",
    )
    subject: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="Whose markers count, where names begin with those of several: Ann:LFHD.",
    )
