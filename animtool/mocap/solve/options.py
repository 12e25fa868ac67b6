"""How markers are solved."""

from __future__ import annotations

from dataclasses import dataclass

from animtool.options import option


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
