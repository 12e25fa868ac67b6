"""The keys of joints, poses, meshes and shapes in a rig file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Pair, Quaternion, Real, Vector
from animtool.rig.skeleton import ChannelName


class BallLimitsModel(FileModel):
    """Cone half-angle, or two, and range of twist."""

    swing: Real | Pair | None = Field(
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
    twist_axis: Vector = Field(
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
    gain: Real = Field(
        default=1.0,
        description="How far this joint goes for one unit of the other, each in the "
        "file's own unit: cm a degree for a prismatic joint that follows a pin.",
        examples=[-0.5],
    )
    offset: Real = Field(
        default=0.0,
        description="Added to it, in this joint's unit.",
        examples=[10.0],
    )


_TYPE = "What it can do."
# The coordinate of a pin or prismatic joint.
_Axis = Annotated[
    Vector,
    Field(
        description="Direction in the joint's rest frame; of any length.",
        examples=[[0.0, -1.0, 0.0]],
    ),
]
_Limits = Annotated[
    Pair | None,
    Field(
        description="Least and largest coordinate. Not given: any.",
        examples=[[0.0, 148.0]],
    ),
]
_Mimic = Annotated[
    MimicModel | None,
    Field(
        description="The joint that it follows.",
        examples=[{"joint": "crank", "gain": -1.0}],
    ),
]


class _JointBase(FileModel):
    name: Name = Field(
        description="Unique among the joints of the rig.", examples=["elbow_l"]
    )
    parent: Name | None = Field(
        default=None,
        description="The joint it hangs from, anywhere in the file. Not given: a root.",
        examples=["shoulder_l"],
    )
    translate: Vector = Field(
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
    tips: list[Vector] = Field(
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

    type: Literal["free"] = Field(description=_TYPE, examples=["free"])


class FixedJointModel(_JointBase):
    """None."""

    type: Literal["fixed"] = Field(description=_TYPE, examples=["fixed"])


class BallJointModel(_JointBase):
    """Three rotations, or two where the twist is locked."""

    type: Literal["ball"] = Field(description=_TYPE, examples=["ball"])
    limits: BallLimitsModel | None = Field(
        default=None,
        description="How far it may turn. Not given: any way.",
        examples=[{"swing": 35.0, "twist": "locked"}],
    )


class PinJointModel(_JointBase):
    """One rotation."""

    type: Literal["pin"] = Field(description=_TYPE, examples=["pin"])
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None


class PrismaticJointModel(_JointBase):
    """One translation."""

    type: Literal["prismatic"] = Field(description=_TYPE, examples=["prismatic"])
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None


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

    translate: Vector | None = Field(
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


Matrix = Annotated[list[Real], Len(16, 16)]


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

    at: Real = Field(
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
