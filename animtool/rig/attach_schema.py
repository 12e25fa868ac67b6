"""The keys of what simulations move in a rig file, and run into, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector


class AttachModel(FileModel):
    """What a simulation moves."""

    name: Name = Field(description="Unique among the attachments.", examples=["cape"])
    kind: Name = Field(
        description="`spring_chain` of joints; `cloth` of a mesh; `strands` of points "
        "that a joint carries. Another is taken as it is, with `joints`.",
        examples=["cloth"],
    )
    joints: Annotated[list[Name], Len(1)] | None = Field(
        default=None,
        description="Of a spring_chain: what swings, from the root on.",
        examples=[["tail_1", "tail_2"]],
    )
    mesh: Name | None = Field(
        default=None, description="Of cloth: what hangs.", examples=["cape"]
    )
    pins: str | None = Field(
        default=None,
        description="Of cloth: array (N,), whole numbers, the points that stay with "
        "the skin. Not given: none.",
        examples=["cape.npz#pins"],
    )
    joint: Name | None = Field(
        default=None,
        description="Of strands: what carries their roots.",
        examples=["head"],
    )
    points: str | None = Field(
        default=None,
        description="Of strands: array (S, K, 3) in the world at bind, each strand "
        "from root to tip, in the file's length.",
        examples=["hair.npz#points"],
    )


class CapsuleModel(FileModel):
    """A cylinder with round ends, in the frame of its joint."""

    radius: Annotated[Real, Field(gt=0)] = Field(
        description="Of the cylinder and its round ends.", examples=[0.08]
    )
    length: Annotated[Real, Field(ge=0)] = Field(
        default=0.0,
        description="Between the centres of the round ends; 0 makes a ball.",
        examples=[0.3],
    )
    axis: Vector = Field(
        default=[0.0, 1.0, 0.0],
        description="Direction of the cylinder in the joint's frame; of any length.",
        examples=[[1.0, 0.0, 0.0]],
    )
    offset: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Centre of the cylinder, from the joint's origin, in its frame.",
        examples=[[0.0, 0.15, 0.0]],
    )


class ColliderModel(FileModel):
    """What a simulation may not pass through."""

    joint: Name = Field(description="The joint that carries it.", examples=["head"])
    capsule: CapsuleModel = Field(
        description="Its form.", examples=[{"radius": 0.08, "length": 0.3}]
    )
