"""The keys of a targets file, as models; ``animtool schema targets`` prints them.

The tables of ``docs/reference`` are generated from the descriptions and examples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Len
from pydantic import Field, create_model

from animtool.clip.schema import CurveModel, JoinModel, KeyModel
from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    IgnoreModel,
    Integer,
    Name,
    NumberPair,
    Quaternion,
    Real,
    Vector,
)
from animtool.ik.goals import GOAL_KINDS, TargetValue

Weight = Annotated[Real, Field(ge=0)]


class TargetUnitsModel(FileModel):
    """Units of the numbers in a targets file; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = key(
        "Unit of points and offsets, also in arrays. Default: the rig's.",
        "cm",
        default=None,
    )
    angle: Literal["deg", "rad"] | None = key(
        "Unit of Euler angles. Default: the rig's.", "deg", default=None
    )


class ValueModel(JoinModel):
    """A value that moves, from keys or a prim of a USD stage."""

    keys: Annotated[list[KeyModel], Len(1)] | None = key(
        "Keys as in a clip: three numbers of a point, [w, x, y, z] of an "
        "orientation, or its Euler angles.",
        [{"t": 1.0, "v": [0.0, 1.0, 0.0]}],
        default=None,
    )
    prim: Name | None = key(
        "A prim whose world transform is followed; `file` names its stage.",
        "/World/prop",
        default=None,
    )
    file: Name | None = key("The USD file of `prim`.", "shot.usda", default=None)
    space: Name | None = key(
        "With `prim`: another prim of the stage that defines the rig's frame. "
        "Default: the world.",
        "/World/hero",
        default=None,
    )
    offset: Vector | None = key(
        "For a point that follows a `prim`: its position in the prim's frame, in the "
        "file's length, whatever the prim's scale. Default: the prim's origin.",
        [0.0, 0.1, 0.0],
        default=None,
    )
    rotate: Quaternion | None = key(
        "For an orientation that follows a `prim`: the rotation [w, x, y, z] "
        "relative to the prim's frame. Default: none.",
        [0.7071, 0.7071, 0.0, 0.0],
        default=None,
    )


class AimModel(FileModel):
    """An axis that points at something."""

    axis: Vector = key("Direction in the joint's frame; any length.", [0.0, 0.0, 1.0])
    at: Vector | str | ValueModel = key(
        "The point, written like a `position`.", [0.0, 1.5, 4.0]
    )


_TARGET_TYPES = {TargetValue.POINT: Vector, TargetValue.ROTATION: Quaternion}


def _with_kinds(base: type[FileModel], *, uses_weights: bool) -> type[FileModel]:
    """Return a model with a key for each kind of goal: its weight, or its target."""
    field_by_key: dict[str, Any] = {}
    for kind in GOAL_KINDS:
        target_type = (
            AimModel
            if kind.has_axis
            else _TARGET_TYPES[kind.value_type] | str | ValueModel
        )
        field_by_key[kind.name] = (
            (Weight | CurveModel if uses_weights else target_type) | None,
            key(
                kind.weight_description if uses_weights else kind.description,
                kind.weight_example if uses_weights else kind.example,
                default=None,
            ),
        )
    return create_model(base.__name__, __base__=base, **field_by_key)


if TYPE_CHECKING:
    _WeightsBase = FileModel
else:
    _WeightsBase = _with_kinds(FileModel, uses_weights=True)


class WeightsModel(_WeightsBase):
    """The weight of each part of a goal."""


class _Effector(FileModel):
    effector: Name = key("A chain of the rig's `ik`, for its tip, or a joint.", "arm_l")
    root: Name | None = key(
        "The topmost joint that may move for this goal. Default: that of the chain; "
        "for a joint, any above it.",
        "shoulder_l",
        default=None,
    )
    offset: Vector = key(
        "The point to bring to the target, in the joint's frame.",
        [0.08, 0.0, 0.0],
        default=[0.0, 0.0, 0.0],
    )


if TYPE_CHECKING:
    _GoalBase = _Effector
else:
    _GoalBase = _with_kinds(_Effector, uses_weights=False)


class GoalModel(_GoalBase):
    """The targets of one effector."""

    weight: Weight | WeightsModel = key(
        "Weight where goals conflict: one number, or one for each part.",
        {"position": 10.0},
        default=1.0,
    )
    priority: Annotated[Integer, Field(ge=0)] = key(
        "0 is hard; goals with higher numbers yield to those with lower.", 1, default=0
    )
    soft: Annotated[Real, Field(ge=0, lt=1)] = key(
        "Fraction of the limb's reach over which it eases into full extension, to "
        "avoid snapping straight. Needs a `root` that no goal moves.",
        0.05,
        default=0.0,
    )
    stretch: Weight | None = key(
        "Fraction of their length that the limb's bones may stretch to reach a "
        "target. Default: that of the chain.",
        0.1,
        default=None,
    )
    hold: list[NumberPair] = key(
        "First and last frame of spans in which it keeps its world position of the "
        "first frame.",
        [[12.0, 30.0], [48.0, 60.0]],
        default=[],
    )
    during: list[NumberPair] = key(
        "First and last frame of spans in which the goal is active; outside them and "
        "their `ease` it is as free as without the goal. Default: all frames.",
        [[20.0, 80.0]],
        default=[],
    )
    ease: Annotated[Real, Field(ge=0)] = key(
        "Frames before and after a span of `hold` or `during` in which the goal "
        "fades in and out smoothly; fewer if spans are close.",
        6.0,
        default=4.0,
    )


class TargetsModel(FileModel):
    """A targets file."""

    targets: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    units: TargetUnitsModel = key(
        "Units of the numbers in the file.",
        {"length": "cm"},
        default=TargetUnitsModel(),
    )
    fps: Real | str | None = key(
        "Frames per second of times: a number, or a fraction as text. Default: that "
        "of the start clip, or 24.",
        "24000/1001",
        default=None,
    )
    range: NumberPair | None = key(
        "First and last frame; arrays have a row for each. Default: those of the "
        "start clip, or of the keys, spans and arrays, which begin at 1.",
        [1.0, 48.0],
        default=None,
    )
    goals: Annotated[list[GoalModel], Len(1, 1000)] = key(
        "One goal or more.", [{"effector": "leg_l", "hold": [[1.0, 12.0]]}]
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "TGT101", "why": "this is intended"}],
        default=[],
    )
