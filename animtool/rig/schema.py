"""The keys of a rig file, as models; ``animtool schema rig`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector
from animtool.documents.ignore import IgnoreModel
from animtool.rig.attach_schema import AttachModel, ColliderModel
from animtool.rig.control_schema import ControlModel
from animtool.rig.joint_schema import JointModel, PoseModel
from animtool.rig.surface_schema import MeshModel, ShapeModel


class UnitsModel(FileModel):
    """Units of the numbers in a file."""

    length: Literal["m", "cm", "mm", "in"] = Field(
        default="m",
        description="Of all lengths, points and deltas of arrays included.",
        examples=["cm"],
    )
    angle: Literal["deg", "rad"] = Field(
        default="deg",
        description="Of limits, mimics, and what drives add to angles and turns.",
        examples=["rad"],
    )


class IkModel(FileModel):
    """A chain that reaches for a goal."""

    name: Name = Field(description="Unique among the chains.", examples=["arm_l"])
    root: Name = Field(description="Its first joint.", examples=["shoulder_l"])
    tip: Name = Field(
        description="Its last joint, which is below the root.", examples=["wrist_l"]
    )
    goal: Literal["position", "orientation", "pose"] = Field(
        default="pose",
        description="What the tip reaches for: a place, a rotation, or both.",
        examples=["position"],
    )
    pole_dir: Vector | None = Field(
        default=None,
        description="Where the middle of the chain points, in the frame of the root's "
        "parent; of any length. Not given: open.",
        examples=[[0.0, 0.0, -1.0]],
    )
    stretch: Annotated[Real, Field(ge=0)] = Field(
        default=0.0,
        description="Share of its length that it may grow by; 0.1 is a tenth.",
        examples=[0.1],
    )


class RigModel(FileModel):
    """A rig file."""

    rig: Literal["animtool/1"] = Field(
        description="What the file is, and the version of its format.",
        examples=["animtool/1"],
    )
    name: Name = Field(description="What the character is called.", examples=["hero"])
    units: UnitsModel = Field(
        default=UnitsModel(),
        description="Units of the numbers in the file.",
        examples=[{"length": "cm", "angle": "deg"}],
    )
    up: Literal["Y", "Z"] = Field(
        default="Y", description="The axis that points up.", examples=["Z"]
    )
    source: str | None = Field(
        default=None,
        alias="from",
        description="A rig file, USD file or BVH that this file adds to.",
        examples=["hero.usda"],
    )
    joints: list[JointModel] = Field(
        default=[],
        description="In any order; at least one, here or in `from`, but for a face of "
        "shapes alone.",
        examples=[[{"name": "root", "type": "free"}]],
    )
    bind: dict[str, PoseModel] = Field(
        default={},
        description="By joint: the pose in which skins and strands were made, where it "
        "is not the rest pose.",
        examples=[{"hips": {"translate": [0.0, 0.9, 0.0]}}],
    )
    meshes: list[MeshModel] = Field(
        default=[],
        description="Surfaces.",
        examples=[
            [{"name": "body", "points": "body.npz", "faces": "body.npz"}],
        ],
    )
    shapes: list[ShapeModel] = Field(
        default=[],
        description="Blend shapes.",
        examples=[[{"name": "smile", "mesh": "head", "deltas": "head.npz#smile"}]],
    )
    controls: list[ControlModel] = Field(
        default=[],
        description="Values that an animator holds, and what they move.",
        examples=[[{"name": "grip", "range": [0.0, 1.0]}]],
    )
    ik: list[IkModel] = Field(
        default=[],
        description="Chains that reach for goals.",
        examples=[[{"name": "arm_l", "root": "shoulder_l", "tip": "wrist_l"}]],
    )
    attach: list[AttachModel] = Field(
        default=[],
        description="What simulations move.",
        examples=[[{"name": "tail", "kind": "spring_chain", "joints": ["tail_1"]}]],
    )
    colliders: list[ColliderModel] = Field(
        default=[],
        description="What simulations may not pass through.",
        examples=[[{"joint": "head", "capsule": {"radius": 0.08}}]],
    )
    ignore: list[IgnoreModel] = Field(
        default=[],
        description="Findings of `animtool validate` that are known and stay.",
        examples=[[{"code": "RIG201", "why": "it is meant"}]],
    )
