"""What becomes of one take of a bake."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.errors import Fault
from animtool.scene.options import BakeOptions
from animtool.take import TakeStream

if TYPE_CHECKING:
    from animtool.usd.target import JointMap


@dataclass(frozen=True, slots=True)
class TakePlan:
    """One take of a bake.

    Attributes:
        source: The file.
        name: Of a library's take, legal and distinct; empty where it is the only one.
        stream: The source, opened, with the joints in the order written.
        mapping: How they stand in the rig of a layer.
        options: As given; the rest pose is that of the first take.
        fps: Time codes a second of the output.
        start: Time code of the first frame.
        notices: The plan's.
    """

    source: Path
    name: str
    stream: TakeStream
    mapping: JointMap | None
    options: BakeOptions
    fps: Fraction
    start: Fraction
    notices: list[Fault]
