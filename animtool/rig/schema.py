"""The keys of a rig file, as models; ``animtool schema rig`` prints them.

The tables of ``docs/formats.md`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.ignore import IgnoreModel
from animtool.rig.skeleton import ChannelName

__all__ = ["JointModel", "RigModel", "UnitsModel"]

Vector3 = Annotated[list[float], Len(3, 3)]
Quaternion = Annotated[list[float], Len(4, 4)]
Pair = Annotated[list[float], Len(2, 2)]
Matrix = Annotated[list[float], Len(16, 16)]
Name = Annotated[str, Field(min_length=1)]


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


class BallLimitsModel(FileModel):
    """Cone half-angle, or two, and range of twist."""

    swing: float | Pair | None = Field(
        default=None,
        description="Half angle of the cone in which the twist axis may swing, or two, "
        "about the two other axes. Not given: any.",
        examples=[[30.0, 60.0]],
    )
    twist: Pair | Literal["locked"] | None = Field(
        default=None,
        description="Least and largest turn about the twist axis; `locked` is [0, 0]. "
        "Not given: any.",
        examples=[[-20.0, 20.0]],
    )
    twist_axis: Vector3 = Field(
        default=[0.0, 1.0, 0.0],
        description="Direction in the joint's rest frame, as a rule along the bone; of "
        "any length.",
        examples=[[1.0, 0.0, 0.0]],
    )


class MimicModel(FileModel):
    """The joint that a pin or prismatic joint follows."""

    joint: Name = Field(
        description="A pin or prismatic joint that follows none itself.",
        examples=["crank"],
    )
    gain: float = Field(
        default=1.0,
        description="How far this joint goes for one unit of the other, each in the "
        "file's own unit: cm a degree for a prismatic joint that follows a pin.",
        examples=[-0.5],
    )
    offset: float = Field(
        default=0.0,
        description="Added to it, in this joint's unit.",
        examples=[10.0],
    )


_AXIS = "Direction in the joint's rest frame; of any length."
_LIMITS = "Least and largest coordinate. Not given: any."


class _JointBase(FileModel):
    name: Name = Field(
        description="Unique among the joints of the rig.", examples=["elbow_l"]
    )
    parent: Name | None = Field(
        default=None,
        description="The joint it hangs from, anywhere in the file. Not given: a root.",
        examples=["shoulder_l"],
    )
    translate: Vector3 = Field(
        default=[0.0, 0.0, 0.0],
        description="Rest place in the frame of the parent, in the file's length.",
        examples=[[0.28, 0.0, 0.0]],
    )
    rotate: Quaternion = Field(
        default=[1.0, 0.0, 0.0, 0.0],
        description="Rest rotation in the frame of the parent: a quaternion "
        "[w, x, y, z], brought to unit length.",
        examples=[[0.7071, 0.7071, 0.0, 0.0]],
    )
    mirror: Name | None = Field(
        default=None,
        description="Name of the joint on the other side, which this key writes.",
        examples=["elbow_r"],
    )
    tips: list[Vector3] = Field(
        default=[],
        description="Ends of the bone that carry no joint, in the joint's frame: the "
        "End Sites of a BVH.",
        examples=[[[0.0, 0.17, 0.0]]],
    )
    channels: list[ChannelName] | None = Field(
        default=None,
        description="Order of the joint's channels in a BVH; nothing else uses it.",
        examples=[["Zrotation", "Xrotation", "Yrotation"]],
    )


class FreeJointModel(_JointBase):
    """Six degrees of freedom."""

    type: Literal["free"] = Field(description="What it can do.", examples=["free"])


class FixedJointModel(_JointBase):
    """None."""

    type: Literal["fixed"] = Field(description="What it can do.", examples=["fixed"])


class BallJointModel(_JointBase):
    """Three rotations, or two where the twist is locked."""

    type: Literal["ball"] = Field(description="What it can do.", examples=["ball"])
    limits: BallLimitsModel | None = Field(
        default=None,
        description="How far it may turn. Not given: any way.",
        examples=[{"swing": 35.0, "twist": "locked"}],
    )


class PinJointModel(_JointBase):
    """One rotation."""

    type: Literal["pin"] = Field(description="What it can do.", examples=["pin"])
    axis: Vector3 = Field(description=_AXIS, examples=[[0.0, -1.0, 0.0]])
    limits: Pair | None = Field(
        default=None, description=_LIMITS, examples=[[0.0, 148.0]]
    )
    mimic: MimicModel | None = Field(
        default=None,
        description="The joint that it follows.",
        examples=[{"joint": "crank", "gain": -1.0}],
    )


class PrismaticJointModel(_JointBase):
    """One translation."""

    type: Literal["prismatic"] = Field(
        description="What it can do.", examples=["prismatic"]
    )
    axis: Vector3 = Field(description=_AXIS, examples=[[0.0, -1.0, 0.0]])
    limits: Pair | None = Field(
        default=None, description=_LIMITS, examples=[[0.0, 148.0]]
    )
    mimic: MimicModel | None = Field(
        default=None,
        description="The joint that it follows.",
        examples=[{"joint": "crank", "gain": -1.0}],
    )


JointModel = Annotated[
    FreeJointModel
    | FixedJointModel
    | BallJointModel
    | PinJointModel
    | PrismaticJointModel,
    Field(discriminator="type"),
]


class PoseModel(FileModel):
    """A local transform; what is left out is the rest's."""

    translate: Vector3 | None = Field(
        default=None,
        description="Place in the frame of the parent. Not given: that at rest.",
        examples=[[0.0, 0.9, 0.0]],
    )
    rotate: Quaternion | None = Field(
        default=None,
        description="Rotation [w, x, y, z] in the frame of the parent. Not given: that "
        "at rest.",
        examples=[[1.0, 0.0, 0.0, 0.0]],
    )


class SkinModel(FileModel):
    """How a mesh follows joints."""

    method: Literal["linear", "dual_quaternion"] = Field(
        default="linear",
        description="How the transforms of joints are blended.",
        examples=["dual_quaternion"],
    )
    joints: list[Name] = Field(
        description="The joints that `indices` count, from 0.",
        examples=[["hips", "spine"]],
    )
    indices: str = Field(
        description="Array (V, I), whole numbers: which joints each point follows.",
        examples=["body.npz#indices"],
    )
    weights: str = Field(
        description="Array (V, I): by how much; not negative, and not all 0. They are "
        "brought to the sum 1.",
        examples=["body.npz#weights"],
    )


class MeshModel(FileModel):
    """A surface; arrays are ``file.npz`` or ``file.npz#name``."""

    name: Name = Field(description="Unique among the meshes.", examples=["body"])
    points: str = Field(
        description="Array (V, 3) in the file's length.", examples=["body.npz#points"]
    )
    faces: str = Field(
        description="Array (N, K), whole numbers: the points of each face; -1 fills "
        "the last places of a face of fewer than K corners, and each has 3.",
        examples=["body.npz#faces"],
    )
    normals: str | None = Field(
        default=None,
        description="Array (V, 3). Not given: renderers find their own.",
        examples=["body.npz#normals"],
    )
    geom_bind: Matrix | None = Field(
        default=None,
        description="World transform of the points at bind: 16 numbers, row by row, "
        "the translation 4th, 8th and 12th. Not given: none.",
        examples=[[1, 0, 0, 0, 0, 1, 0, 0.9, 0, 0, 1, 0, 0, 0, 0, 1]],
    )
    skin: SkinModel | None = Field(
        default=None,
        description="How it follows joints. Not given: it follows none.",
        examples=[
            {
                "joints": ["hips"],
                "indices": "body.npz#indices",
                "weights": "body.npz#weights",
            }
        ],
    )
    subdivision: Literal["none", "catmull_clark", "loop", "bilinear"] | None = Field(
        default=None,
        description="By which rule renderers refine it. Not given: `none` for a mesh "
        "with normals, else `catmull_clark`.",
        examples=["loop"],
    )


class InbetweenModel(FileModel):
    """The deltas of a shape on its way."""

    at: float = Field(
        description="The weight, ascending in the list; neither 0 nor 1.",
        examples=[0.5],
    )
    deltas: str = Field(
        description="Array, what is added at that weight; shaped as the shape's own.",
        examples=["head.npz#blink_half"],
    )
    normals: str | None = Field(
        default=None,
        description="Array, likewise for the normals. Not given: they stay.",
        examples=["head.npz#blink_half_normals"],
    )


class ShapeModel(FileModel):
    """A blend shape."""

    name: Name = Field(description="Unique among the shapes.", examples=["smile"])
    mesh: Name | None = Field(
        default=None,
        description="The mesh that it shapes. Not given: none, it is a weight alone.",
        examples=["head"],
    )
    deltas: str | None = Field(
        default=None,
        description="Array (V, 3), or (N, 3) with `vertices`: what is added to the "
        "points at weight 1, in the file's length. Not given: nothing.",
        examples=["head.npz#smile"],
    )
    normals: str | None = Field(
        default=None,
        description="Array, likewise for the normals. Not given: they stay.",
        examples=["head.npz#smile_normals"],
    )
    vertices: str | None = Field(
        default=None,
        description="Array (N,), whole numbers: which points `deltas`, `normals` and "
        "inbetweens are for. Not given: all V, in order.",
        examples=["head.npz#smile_vertices"],
    )
    inbetweens: list[InbetweenModel] = Field(
        default=[],
        description="What it adds on its way to weight 1.",
        examples=[[{"at": 0.5, "deltas": "head.npz#smile_half"}]],
    )
    combine: list[Name] = Field(
        default=[],
        description="Shapes: the product of their weights is added to its own.",
        examples=[["smile", "jaw_open"]],
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
    default: float = Field(
        default=0.0, description="Its value where no key sets it.", examples=[0.25]
    )
    drives: list[DriveModel] = Field(
        default=[],
        description="What it adds to, and how much.",
        examples=[[{"joint": "elbow_l.angle", "expr": "grip * 80"}]],
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
    pole_dir: Vector3 | None = Field(
        default=None,
        description="Where the middle of the chain points, in the frame of the root's "
        "parent; of any length. Not given: open.",
        examples=[[0.0, 0.0, -1.0]],
    )
    stretch: Annotated[float, Field(ge=0)] = Field(
        default=0.0,
        description="Share of its length that it may grow by; 0.1 is a tenth.",
        examples=[0.1],
    )


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

    radius: Annotated[float, Field(gt=0)] = Field(
        description="Of the cylinder and its round ends.", examples=[0.08]
    )
    length: Annotated[float, Field(ge=0)] = Field(
        default=0.0,
        description="Between the centres of the round ends; 0 makes a ball.",
        examples=[0.3],
    )
    axis: Vector3 = Field(
        default=[0.0, 1.0, 0.0],
        description="Direction of the cylinder in the joint's frame; of any length.",
        examples=[[1.0, 0.0, 0.0]],
    )
    offset: Vector3 = Field(
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
        description="In any order; at least one, here or in `from`.",
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
