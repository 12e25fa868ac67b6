"""The keys of joints, poses, meshes and shapes in a rig file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Pair, Quaternion, Real, Vector, key
from animtool.rig.skeleton import ChannelName


class BallLimitsModel(FileModel):
    """Cone half-angle, or two, and range of twist."""

    swing: Real | Pair | None = key(
        "Half angle of the cone in which the twist axis may swing, or two, "
        "about the two other axes. Not given: any.",
        [30.0, 60.0],
        default=None,
    )
    twist: Pair | Literal["locked"] | None = key(
        "Least and largest turn about the twist axis; `locked` is [0, 0]. "
        "Not given: any.",
        [-20.0, 20.0],
        default=None,
    )
    twist_axis: Vector = key(
        "Direction in the joint's rest frame, as a rule along the bone; of any length.",
        [1.0, 0.0, 0.0],
        default=[0.0, 1.0, 0.0],
    )


class MimicModel(FileModel):
    """The joint that a pin or prismatic joint follows."""

    joint: Name = key("A pin or prismatic joint that follows none itself.", "crank")
    gain: Real = key(
        "How far this joint goes for one unit of the other, each in the "
        "file's own unit: cm a degree for a prismatic joint that follows a pin.",
        -0.5,
        default=1.0,
    )
    offset: Real = key("Added to it, in this joint's unit.", 10.0, default=0.0)


# Of every curve of a rig file.
JOINED = (
    "How the points of a curve are joined: by straight lines, or by a monotone "
    "cubic, which goes beyond no point and is flat at both ends."
)


class DrivenModel(FileModel):
    """A value that follows from joint coordinates and controls."""

    expr: str | None = key(
        "The value: arithmetic over coordinates of joints, JOINT.PART, and controls, "
        "in the file's units.",
        "wrist_l.twist / 2",
        default=None,
    )
    by: Name | None = key(
        "Of a curve: the coordinate or control that it reads.",
        "elbow_l.angle",
        default=None,
    )
    curve: Annotated[list[Pair], Len(1)] | None = key(
        "The value: points [what `by` reads, value], ascending, held at both ends.",
        [[0.0, 0.0], [90.0, 1.0]],
        default=None,
    )
    interp: Literal["linear", "smooth"] = key(
        JOINED,
        "smooth",
        default="linear",
    )


_TYPE = "What it can do."
# The coordinate of a pin or prismatic joint.
_Axis = Annotated[
    Vector,
    key("Direction in the joint's rest frame; of any length.", [0.0, -1.0, 0.0]),
]
_Limits = Annotated[
    Pair | None,
    key("Least and largest coordinate. Not given: any.", [0.0, 148.0]),
]
_Mimic = Annotated[
    MimicModel | None,
    key("The joint that it follows.", {"joint": "crank", "gain": -1.0}),
]
_Driven = Annotated[
    DrivenModel | None,
    key(
        "What its coordinate is, in the file's units: it has no motion of its own. "
        "Limits hold.",
        {"expr": "wrist_l.twist / 2"},
    ),
]


class _JointBase(FileModel):
    name: Name = key("Unique among the joints of the rig.", "elbow_l")
    parent: Name | None = key(
        "The joint it hangs from, anywhere in the file. Not given: a root.",
        "shoulder_l",
        default=None,
    )
    translate: Vector = key(
        "Rest place in the frame of the parent, in the file's length.",
        [0.28, 0.0, 0.0],
        default=[0.0, 0.0, 0.0],
    )
    rotate: Quaternion = key(
        "Rest rotation in the frame of the parent: a quaternion "
        "[w, x, y, z], brought to unit length.",
        [0.7071, 0.7071, 0.0, 0.0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    mirror: Name | None = key(
        "Name of the joint on the other side, which this key writes.",
        "elbow_r",
        default=None,
    )
    tips: list[Vector] = key(
        "Ends of the bone that carry no joint, in the joint's frame: the "
        "End Sites of a BVH.",
        [[0.0, 0.17, 0.0]],
        default=[],
    )
    channels: list[ChannelName] | None = key(
        "Order of the joint's channels in a BVH; nothing else uses it.",
        ["Zrotation", "Xrotation", "Yrotation"],
        default=None,
    )


class FreeJointModel(_JointBase):
    """Six degrees of freedom."""

    type: Literal["free"] = key(_TYPE, "free")


class FixedJointModel(_JointBase):
    """None."""

    type: Literal["fixed"] = key(_TYPE, "fixed")


class BallJointModel(_JointBase):
    """Three rotations, or two where the twist is locked."""

    type: Literal["ball"] = key(_TYPE, "ball")
    limits: BallLimitsModel | None = key(
        "How far it may turn. Not given: any way.",
        {"swing": 35.0, "twist": "locked"},
        default=None,
    )


class PinJointModel(_JointBase):
    """One rotation."""

    type: Literal["pin"] = key(_TYPE, "pin")
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None
    driven: _Driven = None


class PrismaticJointModel(_JointBase):
    """One translation."""

    type: Literal["prismatic"] = key(_TYPE, "prismatic")
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None
    driven: _Driven = None


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

    translate: Vector | None = key(
        "Place in the frame of the parent. Not given: that at rest.",
        [0.0, 0.9, 0.0],
        default=None,
    )
    rotate: Quaternion | None = key(
        "Rotation [w, x, y, z] in the frame of the parent. Not given: that at rest.",
        [1.0, 0.0, 0.0, 0.0],
        default=None,
    )
    stretch: Annotated[list[Real], Len(9, 9)] | None = key(
        "Scale and shear of the joint when its skin was bound, for nothing below it: 9 "
        "numbers, row by row, in the frame of the joint. Not given: none.",
        [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0],
        default=None,
    )


Matrix = Annotated[list[Real], Len(16, 16)]


class SkinModel(FileModel):
    """How a mesh follows joints."""

    method: Literal["linear", "dual_quaternion"] = key(
        "How the transforms of joints are blended.", "dual_quaternion", default="linear"
    )
    joints: list[Name] = key(
        "The joints that `indices` count, from 0.", ["hips", "spine"]
    )
    indices: str = key(
        "Array (V, I), whole numbers: which joints each point follows.",
        "body.npz#indices",
    )
    weights: str = key(
        "Array (V, I): by how much; not negative, and not all 0. They are "
        "brought to the sum 1.",
        "body.npz#weights",
    )


class MeshModel(FileModel):
    """A surface; arrays are ``file.npz`` or ``file.npz#name``."""

    name: Name = key("Unique among the meshes.", "body")
    points: str = key("Array (V, 3) in the file's length.", "body.npz#points")
    faces: str = key(
        "Array (N, K), whole numbers: the points of each face; -1 fills "
        "the last places of a face of fewer than K corners, and each has 3.",
        "body.npz#faces",
    )
    normals: str | None = key(
        "Array (V, 3). Not given: renderers find their own.",
        "body.npz#normals",
        default=None,
    )
    geom_bind: Matrix | None = key(
        "World transform of the points at bind: 16 numbers, row by row, "
        "the translation 4th, 8th and 12th. Not given: none.",
        [1, 0, 0, 0, 0, 1, 0, 0.9, 0, 0, 1, 0, 0, 0, 0, 1],
        default=None,
    )
    skin: SkinModel | None = key(
        "How it follows joints. Not given: it follows none.",
        {
            "joints": ["hips"],
            "indices": "body.npz#indices",
            "weights": "body.npz#weights",
        },
        default=None,
    )
    subdivision: Literal["none", "catmull_clark", "loop", "bilinear"] | None = key(
        "By which rule renderers refine it. Not given: `none` for a mesh "
        "with normals, else `catmull_clark`.",
        "loop",
        default=None,
    )


class InbetweenModel(FileModel):
    """The deltas of a shape on its way."""

    at: Real = key("The weight, ascending in the list; neither 0 nor 1.", 0.5)
    deltas: str = key(
        "Array, what is added at that weight; shaped as the shape's own.",
        "head.npz#blink_half",
    )
    normals: str | None = key(
        "Array, likewise for the normals. Not given: they stay.",
        "head.npz#blink_half_normals",
        default=None,
    )


class ShapeModel(FileModel):
    """A blend shape."""

    name: Name = key("Unique among the shapes.", "smile")
    mesh: Name | None = key(
        "The mesh that it shapes. Not given: none, it is a weight alone.",
        "head",
        default=None,
    )
    deltas: str | None = key(
        "Array (V, 3), or (N, 3) with `vertices`: what is added to the "
        "points at weight 1, in the file's length. Not given: nothing.",
        "head.npz#smile",
        default=None,
    )
    normals: str | None = key(
        "Array, likewise for the normals. Not given: they stay.",
        "head.npz#smile_normals",
        default=None,
    )
    vertices: str | None = key(
        "Array (N,), whole numbers: which points `deltas`, `normals` and "
        "inbetweens are for. Not given: all V, in order.",
        "head.npz#smile_vertices",
        default=None,
    )
    inbetweens: list[InbetweenModel] = key(
        "What it adds on its way to weight 1.",
        [{"at": 0.5, "deltas": "head.npz#smile_half"}],
        default=[],
    )
    combine: list[Name] = key(
        "Shapes: the product of their weights is added to its own.",
        ["smile", "jaw_open"],
        default=[],
    )
    driven: DrivenModel | None = key(
        "What its weight is, in place of keys.",
        {"by": "elbow_l.angle", "curve": [[30.0, 0.0], [120.0, 1.0]]},
        default=None,
    )
