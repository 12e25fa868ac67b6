"""How points are triangulated."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.options import option


@dataclass(frozen=True, slots=True)
class TriangulateOptions:
    """How points are triangulated.

    Attributes:
        noise: Standard deviation of a pixel's axis [px]; None measures it.
        gate: Observations farther from the point than this many standard deviations
            are left out.
        min_angle: Least angle between rays [rad]; points that only flatter ones see
            have no depth, and are left out.
        keep_moved: Whether cameras that moved or are stale take part all the same.
    """

    noise: float | None = option(
        None,
        "amount",
        "--noise",
        metavar="PIXELS",
        help="Standard deviation of observations.  [default: measured]",
    )
    gate: float = option(
        5.0,
        "amount",
        "--gate",
        metavar="SIGMAS",
        help="Leave out observations that are farther off than this many standard "
        "deviations.",
    )
    min_angle: float = option(
        0.03490658503988659,
        "angle",
        "--min-angle",
        help="Least angle between rays; points that only flatter ones see are left "
        "out.",
        written=2.0,
    )
    keep_moved: bool = option(
        False,
        "switch",
        "--moved",
        choices=("leave-out", "keep"),
        help="Whether cameras that moved after calibration are left out where they "
        "did, or kept.  [default: leave-out]",
    )
