"""Options of the commands and passes that solve captures, each with its default."""

from __future__ import annotations

from typing import Annotated

from animtool.core.options import inherits_docs, option, or_more
from animtool.core.record import dataclass


@inherits_docs
@dataclass(frozen=True, slots=True)
class CleanOptions:
    """Options for removing spikes and filtering noise.

    Attributes:
        spikes: Longest spike that is removed [frames]; 0 leaves them.
        keep_noise: Whether to skip filtering.
        cutoff: Filter every joint at this frequency [Hz]; None chooses a frequency for
            each from its noise.
    """

    spikes: int = option(
        3,
        "count",
        metavar="FRAMES",
        help="Longest spike that is removed; 0 keeps them all.",
    )
    keep_noise: bool = option(
        False,
        "switch",
        flag="noise",
        choices=("filter", "keep"),
        help="Filter noise at a cut-off that each joint's noise suggests, or keep "
        "it.  [default: filter]",
    )
    cutoff: float | None = option(
        None, "amount", metavar="HZ", help="Cut-off frequency for every joint instead."
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class TriangulateOptions:
    """Options for triangulation.

    Attributes:
        noise: Standard deviation of a pixel coordinate [px]; None measures it.
        keep_moved: Whether to use cameras even if they moved or are stale.
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
        help="Exclude observations farther off than this many standard deviations.",
    )
    min_angle: float = option(
        0.03490658503988659,
        "angle",
        help="Smallest angle between rays; points seen only under smaller angles are "
        "excluded.",
        text_default=2.0,
    )
    keep_moved: bool = option(
        False,
        "switch",
        flag="moved",
        choices=("leave-out", "keep"),
        help="Exclude cameras that moved after calibration in the frames where they "
        "did, or keep them.  [default: leave-out]",
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class FaceOptions:
    """Options of a face solve."""

    smooth: float = option(
        1.0,
        "amount",
        metavar="FACTOR",
        help="Penalty for change from frame to frame: 0 is none.",
    )
    head: str | None = option(
        None,
        "choice",
        choices=("rotation", "pose", "none"),
        help="Head motion: rotate the head joint, also move the root, or ignore it.  "
        "[default: rotation; none with a head-mounted camera]",
    )
    neutral: int | None = option(
        None,
        "count",
        metavar="FRAME",
        help="Frame, from 0, with a neutral face: proportions are then taken from "
        "the actor.",
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class FillOptions:
    """Which defects of marker tracks to repair: gaps, spikes, swapped names.

    Attributes:
        keep_gaps: Whether gaps stay.
        keep_spikes: Whether spikes stay.
        keep_swaps: Whether swapped names stay.
        longest: Longest gap that is filled [s]; None sets no limit.
    """

    keep_gaps: bool = option(
        False,
        "switch",
        flag="gaps",
        choices=("fill", "keep"),
        help="Fill gaps, or keep them.  [default: fill]",
    )
    keep_spikes: bool = option(
        False,
        "switch",
        flag="spikes",
        choices=("remove", "keep"),
        help="Remove spikes and fill them as gaps, or keep them.  [default: remove]",
    )
    keep_swaps: bool = option(
        False,
        "switch",
        flag="swaps",
        choices=("repair", "keep"),
        help="Repair swapped names, or keep them.  [default: repair]",
    )
    longest: Annotated[float | None, or_more(0, "CAP001", finite=True)] = option(
        None,
        "amount",
        metavar="SECONDS",
        help="Longest gap to fill.  [default: no limit]",
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class SolveOptions:
    """Options of a marker solve.

    Attributes:
        acceleration: Typical acceleration of joints [rad/s²]; less is smoother.
    """

    noise: float = option(
        0.0005,
        "length",
        text_default="0.5mm",
        metavar="LENGTH",
        help="Expected shift of a marker on its bone, as skin moves. Larger where "
        "the capture shows more.",
    )
    acceleration: float = option(
        100.0,
        "amount",
        metavar="RAD/S²",
        help="Typical acceleration of joints; lower is smoother.",
    )
    subject: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="Subject whose markers to read, where names have a prefix: Ann:LFHD.",
    )
