"""The keys of controls in a rig file, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Pair, Real


class DriveModel(FileModel):
    """What a control adds to a shape, a joint's coordinate or another control."""

    shape: Name | None = Field(
        default=None,
        description="The shape whose weight it adds to.",
        examples=["smile"],
    )
    joint: Name | None = Field(
        default=None,
        description="The joint and its part that it adds to, JOINT.PART.",
        examples=["elbow_l.angle"],
    )
    control: Name | None = Field(
        default=None, description="The control that it adds to.", examples=["wrinkle"]
    )
    expr: str | None = Field(
        default=None,
        description="How much: arithmetic over the values of controls.",
        examples=["clamp(grip * 2, 0, 1)"],
    )
    curve: Annotated[list[Pair], Len(1)] | None = Field(
        default=None,
        description="How much: points [value of this control, what is added], "
        "ascending, joined by straight lines, held at both ends.",
        examples=[[[0.0, 0.0], [1.0, 80.0]]],
    )


class ControlModel(FileModel):
    """What an animator holds."""

    name: Name = Field(
        description="Letters, digits and underscores, as expressions read it; no word "
        "of Python, no function of expressions, not `pi`.",
        examples=["grip"],
    )
    range: Pair | None = Field(
        default=None,
        description="Least and largest value that is meant; others are reported, and "
        "with `--clamp` brought inside. Not given: any.",
        examples=[[0.0, 1.0]],
    )
    default: Real = Field(
        default=0.0, description="Its value where no key sets it.", examples=[0.25]
    )
    drives: list[DriveModel] = Field(
        default=[],
        description="What it adds to, and how much.",
        examples=[[{"joint": "elbow_l.angle", "expr": "grip * 80"}]],
    )
