"""The keys of what stands somewhere in a scene, or moves, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Frame, Quaternion, Real, Vector
from animtool.scene.systems.fields import PrimPath, TimedVector, UsdFile


class FollowedPrimModel(FileModel):
    """A prim of a USD file, as that moves and turns."""

    file: UsdFile = Field(examples=["props.usda"])
    prim: PrimPath = Field(examples=["/Set/hook"])
    frame: Frame | None = Field(
        default=None,
        description="Time code of its file that comes at 0 s. Not given: the first.",
        examples=[101],
    )


class PlacedModel(FileModel):
    """What stands somewhere, or moves."""

    at: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Where it is [m].",
        examples=[[0, 1.5, 0]],
    )
    rotate: Quaternion = Field(
        default=[1.0, 0.0, 0.0, 0.0],
        description="How it is turned: a quaternion w, x, y, z.",
        examples=[[0.7071, 0, 0.7071, 0]],
    )
    moves: list[TimedVector] = Field(
        default=[],
        description="Where it is over time, from `at`: rows of seconds from the first "
        "frame on and three coordinates [m]. Not given: it stays.",
        examples=[[[0, 0, 0, 0], [2, 4, 0, 0]]],
    )
    turns: list[Annotated[list[Real], Len(5, 5)]] = Field(
        default=[],
        description="How it is turned over time, after `rotate`: rows of seconds from "
        "the first frame on and a quaternion w, x, y, z; it turns the short way from "
        "row to row. Not given: it does not turn.",
        examples=[[[0, 1, 0, 0, 0], [1, 0.7071, 0, 0, 0.7071]]],
    )
    prim: FollowedPrimModel | None = Field(
        default=None,
        description="A prim that it goes and turns with, in place of `moves` and "
        "`turns`; `at` and `rotate` are in the frame of the prim then.",
        examples=[{"file": "props.usda", "prim": "/Set/mill"}],
    )
