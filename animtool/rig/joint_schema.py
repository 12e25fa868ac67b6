"""The keys of joints, poses, meshes and shapes in a rig file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Direction,
    Name,
    NumberPair,
    Quaternion,
    Real,
    Vector,
    shared_key,
)
from animtool.rig.skeleton import ChannelName


class BallLimitsModel(FileModel):
    """Cone half-angle, or two, and range of twist."""

    swing: Real | NumberPair | None = key(
        "Half angle of the cone within which the twist axis may swing, or two angles "
        "about the other axes. Default: no limit.",
        [30.0, 60.0],
        default=None,
    )
    twist: NumberPair | Literal["locked"] | None = key(
        "Range of the rotation about the twist axis; `locked` is [0, 0]. Default: no "
        "limit.",
        [-20.0, 20.0],
        default=None,
    )
    twist_axis: Direction = key(
        "Direction in the joint's rest frame, usually along the bone; any length.",
        [1.0, 0.0, 0.0],
        default=[0.0, 1.0, 0.0],
    )


class MimicModel(FileModel):
    """Coupling of a pin or prismatic joint to another joint."""

    joint: Name = key("A pin or prismatic joint that is not a mimic itself.", "crank")
    gain: Real = key(
        "Motion of this joint per unit of the other, each in the file's own unit: cm "
        "per degree for a prismatic joint that follows a pin.",
        -0.5,
        default=1.0,
    )
    offset: Real = key("Added to it, in this joint's unit.", 10.0, default=0.0)


# Shared by all curves of a rig file.
INTERPOLATION_HELP = (
    "Interpolation between the points of a curve: linear, or a monotone cubic, which "
    "overshoots no point and is flat at both ends."
)


class DrivenModel(FileModel):
    """A value computed from joint coordinates and controls."""

    expr: str | None = key(
        "The value: arithmetic over coordinates of joints, JOINT.PART, and controls, "
        "in the file's units.",
        "wrist_l.twist / 2",
        default=None,
    )
    by: Name | None = key(
        "The coordinate or control that a curve reads.",
        "elbow_l.angle",
        default=None,
    )
    curve: Annotated[list[NumberPair], Len(1)] | None = key(
        "The value: points [input, value], ascending, constant beyond both ends.",
        [[0.0, 0.0], [90.0, 1.0]],
        default=None,
    )
    interp: Literal["linear", "smooth"] = key(
        INTERPOLATION_HELP,
        "smooth",
        default="linear",
    )


_TYPE_HELP = "Degrees of freedom."
# The coordinate of a pin or prismatic joint.
_Axis = Annotated[
    Direction,
    shared_key(
        "Direction in the joint's rest frame, of any length, or X, Y, Z, -X, -Y, -Z.",
        [0.0, -1.0, 0.0],
    ),
]
_Limits = Annotated[
    NumberPair | None,
    shared_key("Range of the coordinate. Default: no limit.", [0.0, 148.0]),
]
_Mimic = Annotated[
    MimicModel | None,
    shared_key("The joint to follow.", {"joint": "crank", "gain": -1.0}),
]
_DriverEntry = Annotated[
    DrivenModel | None,
    shared_key(
        "Sets the coordinate, in the file's units, in place of keys. Limits apply.",
        {"expr": "wrist_l.twist / 2"},
    ),
]


class _JointBase(FileModel):
    name: Name = key("Unique name among the joints of the rig.", "elbow_l")
    parent: Name | None = key(
        "The parent joint, anywhere in the file. Default: none, for a root.",
        "shoulder_l",
        default=None,
    )
    translate: Vector = key(
        "Rest position in the parent's frame, in the file's length.",
        [0.28, 0.0, 0.0],
        default=[0.0, 0.0, 0.0],
    )
    rotate: Quaternion = key(
        "Rest rotation in the parent's frame: a quaternion [w, x, y, z], which is "
        "normalised.",
        [0.7071, 0.7071, 0.0, 0.0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    mirror: Name | None = key(
        "Name of the joint on the other side, which this key creates.",
        "elbow_r",
        default=None,
    )
    tips: list[Vector] = key(
        "End points of the bone that have no joint, in the joint's frame: the End "
        "Sites of a BVH.",
        [[0.0, 0.17, 0.0]],
        default=[],
    )
    channels: list[ChannelName] | None = key(
        "Order of the joint's channels in a BVH; used nowhere else.",
        ["Zrotation", "Xrotation", "Yrotation"],
        default=None,
    )


class FreeJointModel(_JointBase):
    """Six degrees of freedom."""

    type: Literal["free"] = key(_TYPE_HELP, "free")


class FixedJointModel(_JointBase):
    """No degrees of freedom."""

    type: Literal["fixed"] = key(_TYPE_HELP, "fixed")


class BallJointModel(_JointBase):
    """Three rotations, or two if the twist is locked."""

    type: Literal["ball"] = key(_TYPE_HELP, "ball")
    limits: BallLimitsModel | None = key(
        "Limits of the rotation. Default: none.",
        {"swing": 35.0, "twist": "locked"},
        default=None,
    )


class PinJointModel(_JointBase):
    """One rotation."""

    type: Literal["pin"] = key(_TYPE_HELP, "pin")
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None
    driven: _DriverEntry = None


class PrismaticJointModel(_JointBase):
    """One translation."""

    type: Literal["prismatic"] = key(_TYPE_HELP, "prismatic")
    axis: _Axis
    limits: _Limits = None
    mimic: _Mimic = None
    driven: _DriverEntry = None


JointModel = Annotated[
    FreeJointModel
    | FixedJointModel
    | BallJointModel
    | PinJointModel
    | PrismaticJointModel,
    Field(discriminator="type"),
]


class PoseModel(FileModel):
    """A local transform; defaults are those of rest."""

    translate: Vector | None = key(
        "Position in the parent's frame. Default: the rest position.",
        [0.0, 0.9, 0.0],
        default=None,
    )
    rotate: Quaternion | None = key(
        "Rotation [w, x, y, z] in the parent's frame. Default: the rest rotation.",
        [1.0, 0.0, 0.0, 0.0],
        default=None,
    )
    stretch: Annotated[list[Real], Len(9, 9)] | None = key(
        "Scale and shear of the joint in the bind pose, not inherited: 9 numbers, "
        "row by row, in the joint's frame. Default: none.",
        [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0],
        default=None,
    )


Matrix = Annotated[list[Real], Len(16, 16)]


class SkinModel(FileModel):
    """Skin binding of a mesh."""

    method: Literal["linear", "dual_quaternion"] = key(
        "How the transforms of joints are blended.", "dual_quaternion", default="linear"
    )
    joints: list[Name] = key(
        "The joints that `indices` refer to, from 0.", ["hips", "spine"]
    )
    indices: str = key(
        "Array (V, I) of whole numbers: the joints that each point follows.",
        "body.npz#indices",
    )
    weights: str = key(
        "Array (V, I) of weights, not negative and not all 0. They are normalised to "
        "the sum 1.",
        "body.npz#weights",
    )


class MeshModel(FileModel):
    """A surface; arrays are ``file.npz`` or ``file.npz#name``."""

    name: Name = key("Unique name among the meshes.", "body")
    points: str = key("Array (V, 3) in the file's length.", "body.npz#points")
    faces: str = key(
        "Array (N, K) of whole numbers: the points of each face; -1 pads faces with "
        "fewer than K corners; 3 is the minimum.",
        "body.npz#faces",
    )
    normals: str | None = key(
        "Array (V, 3). Default: renderers compute normals.",
        "body.npz#normals",
        default=None,
    )
    geom_bind: Matrix | None = key(
        "World transform of the points at bind: 16 numbers, row by row, translation "
        "at 4, 8 and 12. Default: identity.",
        [1, 0, 0, 0, 0, 1, 0, 0.9, 0, 0, 1, 0, 0, 0, 0, 1],
        default=None,
    )
    skin: SkinModel | None = key(
        "How it follows joints. Default: it does not.",
        {
            "joints": ["hips"],
            "indices": "body.npz#indices",
            "weights": "body.npz#weights",
        },
        default=None,
    )
    subdivision: Literal["none", "catmull_clark", "loop", "bilinear"] | None = key(
        "Subdivision scheme of renderers. Default: `none` for a mesh with normals, "
        "else `catmull_clark`.",
        "loop",
        default=None,
    )


class InbetweenModel(FileModel):
    """Deltas of a shape at a weight between 0 and 1."""

    at: Real = key("The weight, ascending in the list; neither 0 nor 1.", 0.5)
    deltas: str = key(
        "Array of the deltas at that weight, with the shape of the main deltas.",
        "head.npz#blink_half",
    )
    normals: str | None = key(
        "Array, likewise for the normals. Default: unchanged.",
        "head.npz#blink_half_normals",
        default=None,
    )


class ShapeModel(FileModel):
    """A blend shape."""

    name: Name = key("Unique name among the shapes.", "smile")
    mesh: Name | None = key(
        "The mesh of the shape. Default: none; the shape is only a weight.",
        "head",
        default=None,
    )
    deltas: str | None = key(
        "Array (V, 3), or (N, 3) with `vertices`: offsets of the points at weight 1, "
        "in the file's length. Default: none.",
        "head.npz#smile",
        default=None,
    )
    normals: str | None = key(
        "Array, likewise for the normals. Default: unchanged.",
        "head.npz#smile_normals",
        default=None,
    )
    vertices: str | None = key(
        "Array (N,) of whole numbers: the points of `deltas`, `normals` and "
        "inbetweens. Default: all V, in order.",
        "head.npz#smile_vertices",
        default=None,
    )
    inbetweens: list[InbetweenModel] = key(
        "Deltas at weights between 0 and 1.",
        [{"at": 0.5, "deltas": "head.npz#smile_half"}],
        default=[],
    )
    combine: list[Name] = key(
        "Shapes whose weights are multiplied and added to its own.",
        ["smile", "jaw_open"],
        default=[],
    )
    driven: DrivenModel | None = key(
        "Sets the weight, in place of keys.",
        {"by": "elbow_l.angle", "curve": [[30.0, 0.0], [120.0, 1.0]]},
        default=None,
    )
