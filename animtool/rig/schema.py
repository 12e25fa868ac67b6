"""The keys of a rig file, as models; ``animtool schema rig`` prints them.

The tables of ``docs/reference`` are generated from their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Direction,
    IgnoreModel,
    Name,
    NumberPair,
    Quaternion,
    Real,
    Vector,
)
from animtool.rig.joint_schema import (
    INTERPOLATION_HELP,
    DrivenModel,
    JointModel,
    MeshModel,
    PoseModel,
    ShapeModel,
)


class AttachModel(FileModel):
    """Geometry or joints that a simulation moves."""

    name: Name = key("Unique name among the attachments.", "cape")
    kind: Name = key(
        "`spring_chain` of joints; `cloth` of a mesh; `strands` of points attached "
        "to a joint. Other kinds are kept unchanged, with `joints`.",
        "cloth",
    )
    joints: Annotated[list[Name], Len(1)] | None = key(
        "The joints of a spring_chain, root first.",
        ["tail_1", "tail_2"],
        default=None,
    )
    mesh: Name | None = key("The mesh of a cloth.", "cape", default=None)
    pins: str | None = key(
        "For cloth: array (N,) of whole numbers, the points pinned to the skin. "
        "Default: none.",
        "cape.npz#pins",
        default=None,
    )
    joint: Name | None = key("The joint of strands' roots.", "head", default=None)
    points: str | None = key(
        "For strands: array (S, K, 3) in world space at bind, each strand from root "
        "to tip, in the file's length.",
        "hair.npz#points",
        default=None,
    )


class CapsuleModel(FileModel):
    """A cylinder with round ends, in the frame of its joint."""

    radius: Annotated[Real, Field(gt=0)] = key(
        "Radius of the cylinder and its round ends.", 0.08
    )
    length: Annotated[Real, Field(ge=0)] = key(
        "Distance between the centres of the round ends; 0 makes a sphere.",
        0.3,
        default=0.0,
    )
    axis: Direction = key(
        "Direction of the cylinder in the joint's frame; any length.",
        [1.0, 0.0, 0.0],
        default=[0.0, 1.0, 0.0],
    )
    offset: Vector = key(
        "Centre of the cylinder, relative to the joint, in its frame.",
        [0.0, 0.15, 0.0],
        default=[0.0, 0.0, 0.0],
    )


class ColliderModel(FileModel):
    """Colliders of simulations."""

    joint: Name = key("The joint it is attached to.", "head")
    capsule: CapsuleModel = key("Its form.", {"radius": 0.08, "length": 0.3})


class MassModel(FileModel):
    """Mass of a joint."""

    joint: Name = key("The joint, with all that moves with it and has no own.", "thigh")
    mass: Annotated[Real, Field(gt=0)] = key("Its mass [kg].", 8.5)
    centre: Vector = key(
        "Its centre of mass, from the joint's origin, in its frame and the file's "
        "length.",
        [0.0, 0.2, 0.0],
        default=[0.0, 0.0, 0.0],
    )
    inertia: Annotated[list[Annotated[Real, Field(ge=0)]], Len(3, 3)] | None = key(
        "Moments of inertia about the axes of `axes`, through the centre [kg m²]. Not "
        "given: those of the colliders.",
        [0.12, 0.02, 0.12],
        default=None,
    )
    axes: Quaternion = key(
        "How these axes are turned in the joint's frame: a quaternion [w, x, y, z].",
        [0.7071, 0.7071, 0.0, 0.0],
        default=[1.0, 0.0, 0.0, 0.0],
    )


class DriveModel(FileModel):
    """A control's drive of a shape, a joint's coordinate or another control."""

    shape: Name | None = key(
        "The shape whose weight it adds to.", "smile", default=None
    )
    joint: Name | None = key(
        "The joint and its part that it adds to, JOINT.PART.",
        "elbow_l.angle",
        default=None,
    )
    control: Name | None = key("The control that it adds to.", "wrinkle", default=None)
    expr: str | None = key(
        "The amount: arithmetic over the values of controls.",
        "clamp(grip * 2, 0, 1)",
        default=None,
    )
    curve: Annotated[list[NumberPair], Len(1)] | None = key(
        "The amount: points [value of this control, amount], ascending, constant "
        "beyond both ends.",
        [[0.0, 0.0], [1.0, 80.0]],
        default=None,
    )
    interp: Literal["linear", "smooth"] = key(
        INTERPOLATION_HELP,
        "smooth",
        default="linear",
    )


class ControlModel(FileModel):
    """A named animator value."""

    name: Name = key(
        "Letters, digits and underscores, so that expressions can read it; not a "
        "Python keyword, a function of expressions or `pi`.",
        "grip",
    )
    range: NumberPair | None = key(
        "Intended range; values outside are reported, and clamped with `clamp`. "
        "Default: no limit.",
        [0.0, 1.0],
        default=None,
    )
    default: Real = key("Value without keys.", 0.25, default=0.0)
    drives: list[DriveModel] = key(
        "The targets and amounts.",
        [{"joint": "elbow_l.angle", "expr": "grip * 80"}],
        default=[],
    )
    driven: DrivenModel | None = key(
        "Sets the value, in place of keys. It can then drive shapes and other "
        "controls, but no joint.",
        {"expr": "elbow_l.angle / 150"},
        default=None,
    )


class UnitsModel(FileModel):
    """Units of the numbers in a file."""

    length: Literal["m", "cm", "mm", "in"] = key(
        "Unit of all lengths, including points and deltas of arrays.", "cm", default="m"
    )
    angle: Literal["deg", "rad"] = key(
        "Unit of limits, mimics, drives of angles and rotations, and inputs and "
        "outputs of drivers.",
        "rad",
        default="deg",
    )


class IkModel(FileModel):
    """A chain that reaches for a goal."""

    name: Name = key("Unique name among the chains.", "arm_l")
    root: Name = key("Its first joint.", "shoulder_l")
    tip: Name = key("Its last joint, below the root.", "wrist_l")
    goal: Literal["position", "orientation", "pose"] = key(
        "Target of the tip: a position, a rotation, or both.",
        "position",
        default="pose",
    )
    pole_dir: Direction | None = key(
        "Direction of the middle of the chain, in the frame of the root's parent; "
        "any length. Default: open.",
        [0.0, 0.0, -1.0],
        default=None,
    )
    stretch: Annotated[Real, Field(ge=0)] = key(
        "Fraction of its length that it may stretch by; 0.1 is a tenth.",
        0.1,
        default=0.0,
    )


class RigModel(FileModel):
    """A rig file."""

    rig: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    name: Name = key("Name of the character.", "hero")
    units: UnitsModel = key(
        "Units of the numbers in the file.",
        {"length": "cm", "angle": "deg"},
        default=UnitsModel(),
    )
    up: Literal["Y", "Z"] = key("The axis that points up.", "Z", default="Y")
    source: str | None = Field(
        default=None,
        alias="from",
        description="A rig file, USD file, glTF, FBX, BVH, URDF or MJCF that this file "
        "adds to.",
        examples=["hero.usda"],
    )
    joints: list[JointModel] = key(
        "In any order; at least one, here or in `from`, except for a face that has "
        "only shapes.",
        [{"name": "root", "type": "free"}],
        default=[],
    )
    bind: dict[str, PoseModel] = key(
        "By joint: the pose in which skins and strands were made, if it differs from "
        "the rest pose.",
        {"hips": {"translate": [0.0, 0.9, 0.0]}},
        default={},
    )
    meshes: list[MeshModel] = key(
        "Surfaces.",
        [{"name": "body", "points": "body.npz", "faces": "body.npz"}],
        default=[],
    )
    shapes: list[ShapeModel] = key(
        "Blend shapes.",
        [{"name": "smile", "mesh": "head", "deltas": "head.npz#smile"}],
        default=[],
    )
    controls: list[ControlModel] = key(
        "Values for the animator to key, and what they drive.",
        [{"name": "grip", "range": [0.0, 1.0]}],
        default=[],
    )
    ik: list[IkModel] = key(
        "IK chains.",
        [{"name": "arm_l", "root": "shoulder_l", "tip": "wrist_l"}],
        default=[],
    )
    attach: list[AttachModel] = key(
        "Parts to simulate.",
        [{"name": "tail", "kind": "spring_chain", "joints": ["tail_1"]}],
        default=[],
    )
    colliders: list[ColliderModel] = key(
        "Shapes that simulations collide with.",
        [{"joint": "head", "capsule": {"radius": 0.08}}],
        default=[],
    )
    masses: list[MassModel] = key(
        "What joints weigh, as bodies of a ragdoll. Default: by the density of their "
        "colliders.",
        [{"joint": "thigh", "mass": 8.5}],
        default=[],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "RIG201", "why": "this is intended"}],
        default=[],
    )
