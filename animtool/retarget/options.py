"""Options of the pass and the command ``retarget``, each with its default."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from animtool.core.arguments import argument
from animtool.core.options import inherits_docs, option
from animtool.core.record import dataclass
from animtool.retarget.roles import MapMode


@inherits_docs
@dataclass(frozen=True, slots=True)
class RetargetOptions:
    """Options of retargeting.

    Attributes:
        free_feet: Whether planted feet may slide.
        hold_hands: Whether hands keep their contacts with each other and the ground.
    """

    map: Path | None = option(
        None,
        "file",
        help="A map file (.map.yaml) with the joints that follow each other. Unnamed "
        "joints stay at rest, unless it has others: auto.",
    )
    by: MapMode = option(
        "auto",
        "name",
        choices=get_args(MapMode),
        help="How joints are recognised: by name and by position in the body, by one "
        "of these, or (rename) by equal names.",
    )
    preset: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="Naming convention of the source.  [default: the nearest]",
    )
    target_preset: str | None = option(
        None,
        "text",
        metavar="NAME",
        help="Naming convention of the rig.  [default: the nearest]",
    )
    rest: int | Literal["rig"] | None = option(
        None,
        "source_rest",
        metavar="offsets|frame:N|rig",
        help="Rest pose of the source: its offsets, a frame, or (rig) the rest pose "
        "of the rig.  [default: offsets]",
    )
    free_feet: bool = option(
        False,
        "switch",
        flag="feet",
        choices=("hold", "free"),
        help="Hold planted feet in place, or let them slide.  [default: hold]",
    )
    hold_hands: bool = option(
        False,
        "switch",
        flag="hands",
        choices=("free", "hold"),
        help="Copy the rotations of the arms, or keep the contacts of hands with "
        "each other and the ground.  [default: free]",
    )
    force_fit: bool = option(
        False,
        "switch",
        help="Retarget even if less than one limb or a third of the moving joints is "
        "paired.",
    )
    warn_above: float | None = option(
        None,
        "amount",
        metavar="TIMES",
        help="Warn where drift, soles or another score exceeds this multiple of a "
        f"good take's; an error with {argument('strict')}.",
    )
