"""Options of the commands and passes of captures, each with its default."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

from animtool.core.options import option, or_more
from animtool.retarget.roles import MapMode


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


@dataclass(frozen=True, slots=True)
class FaceOptions:
    """How landmarks become weights.

    Attributes:
        smooth: How much changes from frame to frame cost: 1 is as noise and a lively
            face ask for, 0 nothing.
        head: What becomes of the head's motion: ``rotation`` turns the head joint,
            ``pose`` also moves the root, ``none`` leaves it out.
        neutral: Frame, from 0, in which the face of the capture is neutral: its
            proportions then are those of the actor. None takes those of the rig.
    """

    smooth: float = option(
        1.0,
        "amount",
        "--smooth",
        metavar="FACTOR",
        help="How much changes from frame to frame cost: 0 is nothing.",
    )
    head: str | None = option(
        None,
        "choice",
        "--head",
        choices=("rotation", "pose", "none"),
        help="Head motion: turn the head joint, also move the root, or leave it out.  "
        "[default: rotation, of a head-mounted camera none]",
    )
    neutral: int | None = option(
        None,
        "count",
        "--neutral",
        metavar="FRAME",
        help="Frame, from 0, in which the actor's face is neutral: proportions are "
        "then the actor's.",
    )


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
    longest: Annotated[float | None, or_more(0, "CAP001", finite=True)] = option(
        None,
        "amount",
        "--longest",
        metavar="SECONDS",
        help="Leave gaps that are longer.  [default: all are filled]",
    )


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How to solve.

    Attributes:
        noise: How far a marker may be off its place on the bone [m]; more where the
            capture shows more.
        acceleration: Of joints that is usual [rad/s²]; less is smoother.
        subject: Prefix of the markers that count; None takes the only one.
    """

    noise: float = option(
        0.0005,
        "length",
        "--noise",
        written="0.5mm",
        metavar="LENGTH",
        help="How far a marker may be off its place on the bone; skin moves. More is "
        "allowed where the capture shows more.",
    )
    acceleration: float = option(
        100.0,
        "amount",
        "--acceleration",
        metavar="RAD/S²",
        help="Acceleration of joints that is usual; less is smoother.",
    )
    subject: str | None = option(
        None,
        "text",
        "--subject",
        metavar="NAME",
        help="Whose markers count, where names begin with those of several: Ann:LFHD.",
    )


@dataclass(frozen=True, slots=True)
class RetargetOptions:
    """How a take goes onto another rig.

    Attributes:
        map: A map file; None finds which joint follows which.
        by: What joints are told by.
        preset: The convention of the source's names; None finds it.
        target_preset: That of the target's names.
        rest: Frame of the source, counted from 1, whose pose is its rest pose; ``rig``
            where it rests as the target does, whatever its offsets are; None is that of
            its skeleton.
        free_feet: Whether feet may slide where they stand.
        hold_hands: Whether hands keep their contacts with each other and the ground.
        force_fit: Whether a take goes onto a rig with which it shares less than a limb
            or a third of the joints that move (MAP010); a map file is enough, too.
        warn_above: Warn of scores that are more than so many times what a good take
            has (MAP107), 0 or more; None warns of none.
    """

    map: Path | None = option(
        None,
        "file",
        "--map",
        help="A map file (.map.yaml): which joint follows which. Joints that it does "
        "not name stay at rest, unless it says others: auto.",
    )
    by: MapMode = option(
        "auto",
        "name",
        "--by",
        choices=get_args(MapMode),
        help="How joints are recognised: by their names and by where they are in the "
        "body, by one of both, or (rename) each by a joint of the same name.",
    )
    preset: str | None = option(
        None,
        "text",
        "--preset",
        metavar="NAME",
        help="The convention of the source's names.  [default: the nearest]",
    )
    target_preset: str | None = option(
        None,
        "text",
        "--target-preset",
        metavar="NAME",
        help="The convention of the rig's names.  [default: the nearest]",
    )
    rest: int | Literal["rig"] | None = option(
        None,
        "source_rest",
        "--rest",
        metavar="offsets|frame:N|rig",
        help="Where the rest pose of the source comes from; rig: it rests as the rig "
        "does, whatever its offsets are.  [default: offsets]",
    )
    free_feet: bool = option(
        False,
        "switch",
        "--feet",
        choices=("hold", "free"),
        help="Whether feet stay where they stand, or slide.  [default: hold]",
    )
    hold_hands: bool = option(
        False,
        "switch",
        "--hands",
        choices=("free", "hold"),
        help="Whether arms turn as the source's, or hands keep their contacts with "
        "each other and the ground.  [default: free]",
    )
    force_fit: bool = option(
        False,
        "switch",
        "--force-fit",
        help="Bring over what is paired, though it is less than one limb or a third of "
        "the joints that move.",
    )
    warn_above: float | None = option(
        None,
        "amount",
        "--warn-above",
        metavar="TIMES",
        help="Warn where drift, soles or another score is more than so many times what "
        "a good take has; with --strict that fails.",
    )
