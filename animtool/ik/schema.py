"""The keys of a targets file, as models; ``animtool schema targets`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Len
from pydantic import Field, create_model

from animtool.clip.schema import CurveModel, JoinModel, KeyModel
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    IgnoreModel,
    Name,
    Pair,
    Quaternion,
    Real,
    Vector,
    Whole,
)
from animtool.ik.goals import KINDS, TargetValue

Weight = Annotated[Real, Field(ge=0)]


class TargetUnitsModel(FileModel):
    """Units of the numbers in a targets file; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = Field(
        default=None,
        description="Of points and offsets, those in arrays included. Not given: the "
        "rig's.",
        examples=["cm"],
    )
    angle: Literal["deg", "rad"] | None = Field(
        default=None,
        description="Of Euler angles. Not given: the rig's.",
        examples=["deg"],
    )


class ValueModel(JoinModel):
    """A value that moves: keys, or a prim of a USD stage."""

    keys: Annotated[list[KeyModel], Len(1)] | None = Field(
        default=None,
        description="Keys as those of a clip: three numbers of a point, [w, x, y, z] "
        "of an orientation, or its Euler angles.",
        examples=[[{"t": 1.0, "v": [0.0, 1.0, 0.0]}]],
    )
    prim: Name | None = Field(
        default=None,
        description="A prim whose transform in the world is followed. Its `file` is "
        "named with it.",
        examples=["/World/prop"],
    )
    file: Name | None = Field(
        default=None, description="The USD file of `prim`.", examples=["shot.usda"]
    )
    space: Name | None = Field(
        default=None,
        description="Of `prim`: another prim of the stage, in whose frame the rig "
        "stands. Not given: the world.",
        examples=["/World/hero"],
    )
    offset: Vector | None = Field(
        default=None,
        description="Of a point that follows a `prim`: where it is in the prim's "
        "frame, in the file's length, whatever scale the prim has. Not given: its "
        "origin.",
        examples=[[0.0, 0.1, 0.0]],
    )
    rotate: Quaternion | None = Field(
        default=None,
        description="Of an orientation that follows a `prim`: the rotation "
        "[w, x, y, z] from the prim's frame. Not given: none.",
        examples=[[0.7071, 0.7071, 0.0, 0.0]],
    )


class AimModel(FileModel):
    """An axis that points at something."""

    axis: Vector = Field(
        description="Direction in the joint's frame; of any length.",
        examples=[[0.0, 0.0, 1.0]],
    )
    at: Vector | str | ValueModel = Field(
        description="The point, as a `position` has it.", examples=[[0.0, 1.5, 4.0]]
    )


_VALUES = {TargetValue.POINT: Vector, TargetValue.ROTATION: Quaternion}


def _with_kinds(base: type[FileModel], *, weights: bool) -> type[FileModel]:
    """Return a model with a key for each kind of goal: its weight, or its target."""
    fields: dict[str, Any] = {}
    for kind in KINDS:
        target = AimModel if kind.axis else _VALUES[kind.value] | str | ValueModel
        fields[kind.name] = (
            (Weight | CurveModel if weights else target) | None,
            Field(
                default=None,
                description=kind.weight_description if weights else kind.description,
                examples=[kind.weight_example if weights else kind.example],
            ),
        )
    return create_model(base.__name__, __base__=base, **fields)


if TYPE_CHECKING:
    _Weights = FileModel
else:
    _Weights = _with_kinds(FileModel, weights=True)


class WeightsModel(_Weights):
    """How much each part of a goal counts."""


class _Effector(FileModel):
    effector: Name = Field(
        description="A chain of the rig's `ik`, whose tip is meant, or a joint.",
        examples=["arm_l"],
    )
    root: Name | None = Field(
        default=None,
        description="The topmost joint that may move for this goal. Not given: the "
        "chain's; of a joint any above it.",
        examples=["shoulder_l"],
    )
    offset: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="The point that reaches, in the joint's frame.",
        examples=[[0.08, 0.0, 0.0]],
    )


if TYPE_CHECKING:
    _Asked = _Effector
else:
    _Asked = _with_kinds(_Effector, weights=False)


class GoalModel(_Asked):
    """What one effector is to reach."""

    weight: Weight | WeightsModel = Field(
        default=1.0,
        description="How much it counts where not all can be reached: one number, or "
        "one for each part.",
        examples=[{"position": 10.0}],
    )
    priority: Annotated[Whole, Field(ge=0)] = Field(
        default=0,
        description="0 is hard; goals of higher numbers give way to those of lower.",
        examples=[1],
    )
    soft: Annotated[Real, Field(ge=0, lt=1)] = Field(
        default=0.0,
        description="Share of the limb's reach over which its extension eases out, so "
        "that it does not snap straight. It wants a `root` that no goal moves.",
        examples=[0.05],
    )
    stretch: Weight | None = Field(
        default=None,
        description="Share of their length that the limb's bones may grow by to reach "
        "what is too far. Not given: the chain's.",
        examples=[0.1],
    )
    hold: list[Pair] = Field(
        default=[],
        description="First and last frame of spans in which it stays in the world "
        "where it is at the first.",
        examples=[[[12.0, 30.0], [48.0, 60.0]]],
    )
    during: list[Pair] = Field(
        default=[],
        description="First and last frame of spans in which it is asked for; outside "
        "of these and their `ease` it is as free as without the goal. Not given: all.",
        examples=[[[20.0, 80.0]]],
    )
    ease: Annotated[Real, Field(ge=0)] = Field(
        default=4.0,
        description="Frames before and behind a span of `hold` or `during` in which it "
        "comes to its place and leaves it, without a jump in speed; less where spans "
        "are near.",
        examples=[6.0],
    )


class TargetsModel(FileModel):
    """A targets file."""

    targets: Literal["animtool/1"] = Field(
        description="What the file is, and the version of its format.",
        examples=["animtool/1"],
    )
    units: TargetUnitsModel = Field(
        default=TargetUnitsModel(),
        description="Units of the numbers in the file.",
        examples=[{"length": "cm"}],
    )
    fps: Real | str | None = Field(
        default=None,
        description="Frames a second that times count: a number, or a fraction as "
        "text. Not given: the start clip's; 24 without one.",
        examples=["24000/1001"],
    )
    range: Pair | None = Field(
        default=None,
        description="First and last frame; arrays have a row for each. Not given: of "
        "the start clip, or of the keys, spans and arrays, which begin at 1.",
        examples=[[1.0, 48.0]],
    )
    goals: Annotated[list[GoalModel], Len(1, 1000)] = Field(
        description="At least one.",
        examples=[[{"effector": "leg_l", "hold": [[1.0, 12.0]]}]],
    )
    ignore: list[IgnoreModel] = Field(
        default=[],
        description="Findings of `animtool validate` that are known and stay.",
        examples=[[{"code": "TGT101", "why": "it is meant"}]],
    )
