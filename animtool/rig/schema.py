"""The keys of a rig file, as models; ``animtool schema rig`` prints them.

The tables of ``docs/reference`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import (
    IgnoreModel,
    Name,
    Pair,
    Quaternion,
    Real,
    Vector,
    key,
)
from animtool.rig.joint_schema import (
    JOINED,
    DrivenModel,
    JointModel,
    MeshModel,
    PoseModel,
    ShapeModel,
)


class AttachModel(FileModel):
    """What a simulation moves."""

    name: Name = key("Unique among the attachments.", "cape")
    kind: Name = key(
        "`spring_chain` of joints; `cloth` of a mesh; `strands` of points "
        "that a joint carries. Another is taken as it is, with `joints`.",
        "cloth",
    )
    joints: Annotated[list[Name], Len(1)] | None = key(
        "Of a spring_chain: what swings, from the root on.",
        ["tail_1", "tail_2"],
        default=None,
    )
    mesh: Name | None = key("Of cloth: what hangs.", "cape", default=None)
    pins: str | None = key(
        "Of cloth: array (N,), whole numbers, the points that stay with "
        "the skin. Not given: none.",
        "cape.npz#pins",
        default=None,
    )
    joint: Name | None = key(
        "Of strands: what carries their roots.", "head", default=None
    )
    points: str | None = key(
        "Of strands: array (S, K, 3) in the world at bind, each strand "
        "from root to tip, in the file's length.",
        "hair.npz#points",
        default=None,
    )


class CapsuleModel(FileModel):
    """A cylinder with round ends, in the frame of its joint."""

    radius: Annotated[Real, Field(gt=0)] = key(
        "Of the cylinder and its round ends.", 0.08
    )
    length: Annotated[Real, Field(ge=0)] = key(
        "Between the centres of the round ends; 0 makes a ball.", 0.3, default=0.0
    )
    axis: Vector = key(
        "Direction of the cylinder in the joint's frame; of any length.",
        [1.0, 0.0, 0.0],
        default=[0.0, 1.0, 0.0],
    )
    offset: Vector = key(
        "Centre of the cylinder, from the joint's origin, in its frame.",
        [0.0, 0.15, 0.0],
        default=[0.0, 0.0, 0.0],
    )


class ColliderModel(FileModel):
    """What a simulation may not pass through."""

    joint: Name = key("The joint that carries it.", "head")
    capsule: CapsuleModel = key("Its form.", {"radius": 0.08, "length": 0.3})


class MassModel(FileModel):
    """What a joint weighs."""

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
    """What a control adds to a shape, a joint's coordinate or another control."""

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
        "How much: arithmetic over the values of controls.",
        "clamp(grip * 2, 0, 1)",
        default=None,
    )
    curve: Annotated[list[Pair], Len(1)] | None = key(
        "How much: points [value of this control, what is added], "
        "ascending, held at both ends.",
        [[0.0, 0.0], [1.0, 80.0]],
        default=None,
    )
    interp: Literal["linear", "smooth"] = key(
        JOINED,
        "smooth",
        default="linear",
    )


class ControlModel(FileModel):
    """What an animator holds."""

    name: Name = key(
        "Letters, digits and underscores, as expressions read it; no word "
        "of Python, no function of expressions, not `pi`.",
        "grip",
    )
    range: Pair | None = key(
        "Least and largest value that is meant; others are reported, and "
        "with `clamp` brought inside. Not given: any.",
        [0.0, 1.0],
        default=None,
    )
    default: Real = key("Its value where no key sets it.", 0.25, default=0.0)
    drives: list[DriveModel] = key(
        "What it adds to, and how much.",
        [{"joint": "elbow_l.angle", "expr": "grip * 80"}],
        default=[],
    )
    driven: DrivenModel | None = key(
        "What its value is, in place of keys. It drives shapes and other controls, "
        "and no joint.",
        {"expr": "elbow_l.angle / 150"},
        default=None,
    )


class UnitsModel(FileModel):
    """Units of the numbers in a file."""

    length: Literal["m", "cm", "mm", "in"] = key(
        "Of all lengths, points and deltas of arrays included.", "cm", default="m"
    )
    angle: Literal["deg", "rad"] = key(
        "Of limits, mimics, what drives add to angles and turns, and what drivers "
        "read and give.",
        "rad",
        default="deg",
    )


class IkModel(FileModel):
    """A chain that reaches for a goal."""

    name: Name = key("Unique among the chains.", "arm_l")
    root: Name = key("Its first joint.", "shoulder_l")
    tip: Name = key("Its last joint, which is below the root.", "wrist_l")
    goal: Literal["position", "orientation", "pose"] = key(
        "What the tip reaches for: a place, a rotation, or both.",
        "position",
        default="pose",
    )
    pole_dir: Vector | None = key(
        "Where the middle of the chain points, in the frame of the root's "
        "parent; of any length. Not given: open.",
        [0.0, 0.0, -1.0],
        default=None,
    )
    stretch: Annotated[Real, Field(ge=0)] = key(
        "Share of its length that it may grow by; 0.1 is a tenth.", 0.1, default=0.0
    )


class RigModel(FileModel):
    """A rig file."""

    rig: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    name: Name = key("What the character is called.", "hero")
    units: UnitsModel = key(
        "Units of the numbers in the file.",
        {"length": "cm", "angle": "deg"},
        default=UnitsModel(),
    )
    up: Literal["Y", "Z"] = key("The axis that points up.", "Z", default="Y")
    source: str | None = Field(
        default=None,
        alias="from",
        description="A rig file, USD file, glTF, BVH, URDF or MJCF that this file "
        "adds to.",
        examples=["hero.usda"],
    )
    joints: list[JointModel] = key(
        "In any order; at least one, here or in `from`, but for a face of "
        "shapes alone.",
        [{"name": "root", "type": "free"}],
        default=[],
    )
    bind: dict[str, PoseModel] = key(
        "By joint: the pose in which skins and strands were made, where it "
        "is not the rest pose.",
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
        "Values that an animator holds, and what they move.",
        [{"name": "grip", "range": [0.0, 1.0]}],
        default=[],
    )
    ik: list[IkModel] = key(
        "Chains that reach for goals.",
        [{"name": "arm_l", "root": "shoulder_l", "tip": "wrist_l"}],
        default=[],
    )
    attach: list[AttachModel] = key(
        "What simulations move.",
        [{"name": "tail", "kind": "spring_chain", "joints": ["tail_1"]}],
        default=[],
    )
    colliders: list[ColliderModel] = key(
        "What simulations may not pass through.",
        [{"joint": "head", "capsule": {"radius": 0.08}}],
        default=[],
    )
    masses: list[MassModel] = key(
        "What joints weigh, as bodies of a ragdoll. Not given: by the density of their "
        "colliders.",
        [{"joint": "thigh", "mass": 8.5}],
        default=[],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are known and stay.",
        [{"code": "RIG201", "why": "it is meant"}],
        default=[],
    )
