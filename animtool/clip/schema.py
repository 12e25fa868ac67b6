"""The keys of a clip file, as models; ``animtool schema clip`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import IgnoreModel, Name, Pair, Real, Vector

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
Handle = Annotated[list[Real | list[Real]], Len(2, 2)]
Order = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]


class ClipUnitsModel(FileModel):
    """Units of the numbers in a clip; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = Field(
        default=None,
        description="Of `translation`, `slide` and `local_translation`. Not given: the "
        "rig's.",
        examples=["cm"],
    )
    angle: Literal["deg", "rad"] | None = Field(
        default=None,
        description="Of `angle` and of Euler angles. Not given: the rig's.",
        examples=["deg"],
    )


class KeyModel(FileModel):
    """A key: time [frames], value, and how the curve leaves and meets it."""

    t: Real = Field(
        description="Frame at the file's `fps`, fractions allowed; keys ascend.",
        examples=[12.5],
    )
    v: Real | list[Real] = Field(
        description="The value: one number, three, or a quaternion [w, x, y, z], as "
        "the target has them.",
        examples=[80.0],
    )
    interp: Interp | None = Field(
        default=None,
        description="How it runs to the next key. Not given: as the channel says.",
        examples=["step"],
    )
    in_: Tangent | Handle | None = Field(
        default=None,
        alias="in",
        description="How it comes to the key: a rule, or a handle [dt, dv] from the "
        "key, dt ≤ 0 frames. Not given: the channel's `tangents`.",
        examples=[[-2.0, 5.0]],
    )
    out: Tangent | Handle | None = Field(
        default=None,
        description="How it leaves the key: likewise, dt ≥ 0.",
        examples=["flat"],
    )
    tcb: Vector | None = Field(
        default=None,
        description="Tension, continuity and bias, for `interp: tcb`. Not given: 0 "
        "each.",
        examples=[[0.5, 0.0, 0.0]],
    )


class _TargetModel(FileModel):
    target: Name = Field(
        description="What moves: control/NAME, shape/NAME or joint/NAME.PART. Each "
        "once.",
        examples=["joint/elbow_l.angle"],
    )


class JoinModel(FileModel):
    """How keys are joined up."""

    interp: Interp | None = Field(
        default=None,
        description="How keys run to the next. Not given: `bezier`, and `spline` for "
        "quaternions.",
        examples=["linear"],
    )
    tangents: Tangent = Field(
        default="auto_clamped",
        description="The rule for keys without handles.",
        examples=["flat"],
    )
    parametrization: Literal["uniform", "centripetal", "chordal"] = Field(
        default="uniform",
        description="Which Catmull-Rom curve, for `interp: catmull_rom`.",
        examples=["centripetal"],
    )
    euler: Order | None = Field(
        default=None,
        description="Makes a rotation of three angles; ZXY is Rz · Rx · Ry, and `v` is "
        "in that order: [z, x, y]. Not given: quaternions.",
        examples=["ZXY"],
    )
    pre: Extrapolated = Field(
        default="hold", description="What is before the first key.", examples=["cycle"]
    )
    post: Extrapolated = Field(
        default="hold",
        description="What is behind the last key.",
        examples=["cycle_offset"],
    )


class CurveModel(JoinModel):
    """Keys, and how they are joined up."""

    keys: Annotated[list[KeyModel], Len(1)] = Field(
        description="At least one.", examples=[[{"t": 1.0, "v": 0.0}]]
    )


class ChannelModel(CurveModel, _TargetModel):
    """The keys of one target."""


class ClipModel(FileModel):
    """A clip file."""

    clip: Literal["animtool/1"] = Field(
        description="What the file is, and the version of its format.",
        examples=["animtool/1"],
    )
    name: str | None = Field(
        default=None,
        description="What the clip is called. Not given: as the file.",
        examples=["wave"],
    )
    rig: str | None = Field(
        default=None,
        description="The rig: a rig file, USD file or BVH. Not given: `--rig` or the "
        "scene names it.",
        examples=["hero.rig.yaml"],
    )
    units: ClipUnitsModel = Field(
        default=ClipUnitsModel(),
        description="Units of the numbers in the file.",
        examples=[{"angle": "deg"}],
    )
    fps: Real | str = Field(
        description="Frames a second: a number, or a fraction as text.",
        examples=["24000/1001"],
    )
    range: Pair | None = Field(
        default=None,
        description="First and last frame. Not given: of the first and last key.",
        examples=[[1.0, 48.0]],
    )
    channels: list[ChannelModel] = Field(
        default=[],
        description="What moves. None, with a range, holds the rig at rest.",
        examples=[[{"target": "control/grip", "keys": [{"t": 1.0, "v": 0.0}]}]],
    )
    ignore: list[IgnoreModel] = Field(
        default=[],
        description="Findings of `animtool validate` that are known and stay.",
        examples=[[{"code": "CLIP201", "why": "it is meant"}]],
    )
