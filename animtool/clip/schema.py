"""The keys of a clip file, as models; ``animtool schema clip`` prints them."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel

__all__ = ["ChannelModel", "ClipModel", "KeyModel"]

Tangent = Literal["flat", "linear", "auto", "auto_clamped"]
Interp = Literal[
    "step",
    "linear",
    "bezier",
    "catmull_rom",
    "tcb",
    "hermite",
    "slerp",
    "squad",
    "spline",
]
Extrapolated = Literal["hold", "linear", "cycle", "cycle_offset", "oscillate"]
Handle = Annotated[list[float | list[float]], Len(2, 2)]
Order = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]


class ClipUnitsModel(FileModel):
    """Units of the numbers in a clip; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = None
    angle: Literal["deg", "rad"] | None = None


class KeyModel(FileModel):
    """A key: time [frames], value, and how the curve leaves and meets it."""

    t: float
    v: float | list[float]
    interp: Interp | None = None
    in_: Tangent | Handle | None = Field(default=None, alias="in")
    out: Tangent | Handle | None = None
    tcb: Annotated[list[float], Len(3, 3)] | None = None


class ChannelModel(FileModel):
    """The keys of one target."""

    target: Annotated[str, Field(min_length=1)]
    interp: Interp | None = None
    tangents: Tangent = "auto_clamped"
    parametrization: Literal["uniform", "centripetal", "chordal"] = "uniform"
    euler: Order | None = None
    pre: Extrapolated = "hold"
    post: Extrapolated = "hold"
    keys: Annotated[list[KeyModel], Len(1)]


class ClipModel(FileModel):
    """A clip file."""

    clip: Literal["animtool/1"]
    name: str | None = None
    rig: str | None = None
    units: ClipUnitsModel = ClipUnitsModel()
    fps: float | str
    range: Annotated[list[float], Len(2, 2)] | None = None
    channels: list[ChannelModel] = []
