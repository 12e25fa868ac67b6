"""The keys of a rig file, as models; ``animtool schema rig`` prints them."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.rig.skeleton import ChannelName

__all__ = ["JointModel", "RigModel", "UnitsModel"]

Vector3 = Annotated[list[float], Len(3, 3)]
Quaternion = Annotated[list[float], Len(4, 4)]
Pair = Annotated[list[float], Len(2, 2)]
Matrix = Annotated[list[float], Len(16, 16)]
Name = Annotated[str, Field(min_length=1)]


class UnitsModel(FileModel):
    """Units of the numbers in a file."""

    length: Literal["m", "cm", "mm", "in"] = "m"
    angle: Literal["deg", "rad"] = "deg"


class BallLimitsModel(FileModel):
    """Cone half-angle, or two, and range of twist."""

    swing: float | Pair | None = None
    twist: Pair | Literal["locked"] | None = None
    twist_axis: Vector3 = [0.0, 1.0, 0.0]


class MimicModel(FileModel):
    """The joint that a pin or prismatic joint follows."""

    joint: Name
    gain: float = 1.0
    offset: float = 0.0


class _JointBase(FileModel):
    name: Name
    parent: Name | None = None
    translate: Vector3 = [0.0, 0.0, 0.0]
    rotate: Quaternion = [1.0, 0.0, 0.0, 0.0]
    mirror: Name | None = None
    tips: list[Vector3] = []
    channels: list[ChannelName] | None = None


class FreeJointModel(_JointBase):
    """Six degrees of freedom."""

    type: Literal["free"]


class FixedJointModel(_JointBase):
    """None."""

    type: Literal["fixed"]


class BallJointModel(_JointBase):
    """Three rotations, or two where the twist is locked."""

    type: Literal["ball"]
    limits: BallLimitsModel | None = None


class PinJointModel(_JointBase):
    """One rotation."""

    type: Literal["pin"]
    axis: Vector3
    limits: Pair | None = None
    mimic: MimicModel | None = None


class PrismaticJointModel(_JointBase):
    """One translation."""

    type: Literal["prismatic"]
    axis: Vector3
    limits: Pair | None = None
    mimic: MimicModel | None = None


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

    translate: Vector3 | None = None
    rotate: Quaternion | None = None


class SkinModel(FileModel):
    """How a mesh follows joints."""

    method: Literal["linear", "dual_quaternion"] = "linear"
    joints: list[Name]
    indices: str
    weights: str


class MeshModel(FileModel):
    """A surface; arrays are ``file.npz`` or ``file.npz#name``."""

    name: Name
    points: str
    faces: str
    normals: str | None = None
    geom_bind: Matrix | None = None
    skin: SkinModel | None = None
    subdivision: Literal["none", "catmull_clark", "loop", "bilinear"] | None = None


class InbetweenModel(FileModel):
    """The deltas of a shape on its way."""

    at: float
    deltas: str
    normals: str | None = None


class ShapeModel(FileModel):
    """A blend shape."""

    name: Name
    mesh: Name | None = None
    deltas: str | None = None
    normals: str | None = None
    vertices: str | None = None
    inbetweens: list[InbetweenModel] = []
    combine: list[Name] = []


class DriveModel(FileModel):
    """What a control adds to a shape, a joint's coordinate or another control."""

    shape: Name | None = None
    joint: Name | None = None
    control: Name | None = None
    expr: str | None = None
    curve: Annotated[list[Pair], Len(1)] | None = None


class ControlModel(FileModel):
    """What an animator holds."""

    name: Name
    range: Pair | None = None
    default: float = 0.0
    drives: list[DriveModel] = []


class IkModel(FileModel):
    """A chain that reaches for a goal."""

    name: Name
    root: Name
    tip: Name
    goal: Literal["position", "orientation", "pose"] = "pose"
    pole_dir: Vector3 | None = None
    stretch: Annotated[float, Field(ge=0)] = 0.0


class AttachModel(FileModel):
    """What a simulation moves."""

    name: Name
    kind: Annotated[
        Name,
        Field(
            description="spring_chain of joints; cloth of a mesh; strands of points "
            "that a joint carries."
        ),
    ]
    joints: Annotated[list[Name], Len(1)] | None = None
    mesh: Annotated[Name | None, Field(description="Of cloth: what hangs.")] = None
    pins: Annotated[
        str | None,
        Field(description="Of cloth: (N,) vertices that stay with the skin."),
    ] = None
    joint: Annotated[
        Name | None, Field(description="Of strands: what carries their roots.")
    ] = None
    points: Annotated[
        str | None,
        Field(description="Of strands: (S, K, 3) in the world, from root to tip."),
    ] = None


class CapsuleModel(FileModel):
    """A cylinder with round ends, in the frame of its joint."""

    radius: Annotated[
        float, Field(gt=0, description="Of the cylinder and its round ends.")
    ]
    length: Annotated[
        float,
        Field(
            ge=0, description="Between the centres of the round ends; 0 makes a ball."
        ),
    ] = 0.0
    axis: Annotated[
        Vector3, Field(description="Direction of the cylinder; of any length.")
    ] = [0.0, 1.0, 0.0]
    offset: Annotated[
        Vector3,
        Field(description="Centre of the cylinder, from the joint's origin."),
    ] = [0.0, 0.0, 0.0]


class ColliderModel(FileModel):
    """What a simulation may not pass through."""

    joint: Name
    capsule: CapsuleModel


class RigModel(FileModel):
    """A rig file."""

    rig: Literal["animtool/1"]
    name: Name
    units: UnitsModel = UnitsModel()
    up: Literal["Y", "Z"] = "Y"
    source: str | None = Field(default=None, alias="from")
    joints: list[JointModel] = []
    bind: dict[str, PoseModel] = {}
    meshes: list[MeshModel] = []
    shapes: list[ShapeModel] = []
    controls: list[ControlModel] = []
    ik: list[IkModel] = []
    attach: list[AttachModel] = []
    colliders: list[ColliderModel] = []
