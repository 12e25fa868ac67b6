"""Options of the pass and the command ``retarget``, each with its default."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from animtool.core.arguments import argument
from animtool.core.options import described, option
from animtool.core.record import dataclass
from animtool.retarget.roles import MapMode


@described
@dataclass(frozen=True, slots=True)
class RetargetOptions:
    """How a take goes onto another rig.

    Attributes:
        free_feet: Whether feet may slide where they stand.
        hold_hands: Whether hands keep their contacts with each other and the ground.
    """

    map: Path | None = option(
        None,
        "file",
        help="A map file (.map.yaml): which joint follows which. Joints that it does "
        "not name stay at rest, unless it says others: auto.",
    )
    by: MapMode = option(
        "auto",
        "name",
        choices=get_args(MapMode),
        help="How joints are recognised: by their names and by where they are in the "
        "body, by one of both, or (rename) each by a joint of the same name.",
    )
    preset: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="The convention of the source's names.  [default: the nearest]",
    )
    target_preset: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="The convention of the rig's names.  [default: the nearest]",
    )
    rest: int | Literal["rig"] | None = option(
        None,
        "source_rest",
        metavar="offsets|frame:N|rig",
        help="Where the rest pose of the source comes from; rig: it rests as the rig "
        "does, whatever its offsets are.  [default: offsets]",
    )
    free_feet: bool = option(
        False,
        "switch",
        flag="feet",
        choices=("hold", "free"),
        help="Whether feet stay where they stand, or slide.  [default: hold]",
    )
    hold_hands: bool = option(
        False,
        "switch",
        flag="hands",
        choices=("free", "hold"),
        help="Whether arms turn as the source's, or hands keep their contacts with "
        "each other and the ground.  [default: free]",
    )
    force_fit: bool = option(
        False,
        "switch",
        help="Bring over what is paired, though it is less than one limb or a third of "
        "the joints that move.",
    )
    warn_above: float | None = option(
        None,
        "amount",
        metavar="TIMES",
        help="Warn where drift, soles or another score is more than so many times what "
        f"a good take has; with {argument('strict')} that fails.",
    )
