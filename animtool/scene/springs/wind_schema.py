"""The keys of the air around springs, as models."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Real, Vector
from animtool.scene.systems.fields import TimedVector


class WindModel(FileModel):
    """The air of ropes and strands: `drag` takes them along with it."""

    velocity: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Velocity of the air [m/s].",
        examples=[[4, 0, 0]],
    )
    gusts: list[TimedVector] = Field(
        default=[],
        description="More of it over time: rows of seconds from the first frame on "
        "and three coordinates [m/s].",
        examples=[[[0, 0, 0, 0], [0.5, 3, 0, 1], [1, 0, 0, 0]]],
    )


class FaceWindModel(WindModel):
    """The air that faces bear."""

    density: Real = Field(
        default=1.2, description="Of the air [kg/m³].", examples=[0.9]
    )
    drag: Real = Field(
        default=1.0, description="Coefficient along the flow.", examples=[1.5]
    )
    lift: Real = Field(default=0.5, description="Coefficient across it.", examples=[0])


FaceWindField = Annotated[
    FaceWindModel | None,
    Field(
        description="The air that its faces bear. Not given: none.",
        examples=[{"velocity": [5, 0, 1]}],
    ),
]
