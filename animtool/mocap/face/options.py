"""How landmarks become weights."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.options import option


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
