"""The keys of a rig file, as models; ``animtool schema rig`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import IgnoreModel, Name, Pair, Real, Vector
from animtool.rig.joint_schema import JointModel, MeshModel, PoseModel, ShapeModel


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
