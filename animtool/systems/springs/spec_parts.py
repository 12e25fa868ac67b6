"""The keys of pins, families of springs, contacts and wind, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector, Whole, with_fields
from animtool.options import or_more
from animtool.systems.fields import (
    CharacterFile,
    FollowedPrimModel,
    OwnCharacter,
    TimedVector,
)
from animtool.systems.springs import Air, Family, SelfContact


@with_fields(SelfContact, "thickness", "friction", "speed", bounds=True)
class SelfContactModel(FileModel):
    """How a surface keeps apart from itself, in folds and layers."""


SelfContactField = Annotated[
    SelfContactModel | None,
    Field(
        description="How it keeps apart from itself. Not given: it goes through.",
        examples=[{"thickness": 0.01}],
    ),
]


@with_fields(Family, "stiffness", "damping", "ratio", "rest", "tear")
class FamilyModel(FileModel):
    """What springs of a family have in common."""


@with_fields(Family, "axial_stiffness")
class LineFamilyModel(FamilyModel):
    """Springs along ropes and strands."""

    stiffness: Real | None = Field(
        default=None,
        description="Force over lengthening of each spring [N/m]. Not given: "
        "`axial_stiffness` is.",
        examples=[1e4],
    )


class DiagonalsModel(FamilyModel):
    """Springs across the cells of cloth."""

    ways: Literal["one", "both"] = Field(
        default="both",
        description="Along one diagonal of each cell, from its first corner, or along "
        "both.",
        examples=["one"],
    )


class LineSpringsModel(FileModel):
    """The springs of ropes and strands; each family can be left out."""

    structural: LineFamilyModel | None = Field(
        default=None,
        description="From each particle to the next.",
        examples=[{"axial_stiffness": 5000, "ratio": 0.1}],
    )
    bend: FamilyModel | None = Field(
        default=None,
        description="From each to the next but one, against bending.",
        examples=[{"stiffness": 50}],
    )


class ClothSpringsModel(FileModel):
    """The springs of cloth; each family can be left out."""

    structural: FamilyModel | None = Field(
        default=None,
        description="Between neighbours; of a mesh, along its edges.",
        examples=[{"stiffness": 1000, "ratio": 0.05}],
    )
    diagonals: DiagonalsModel | None = Field(
        default=None,
        description="Across cells, against shearing; of a mesh, across faces of four "
        "corners or more, always both.",
        examples=[{"stiffness": 300, "ways": "one"}],
    )
    bend: FamilyModel | None = Field(
        default=None,
        description="From each to the next but one, or over the edges of a mesh, "
        "against bending.",
        examples=[{"stiffness": 10}],
    )


class VolumeSpringsModel(FileModel):
    """The springs of volumes; each family can be left out."""

    structural: FamilyModel | None = Field(
        default=None,
        description="Along the axes; of tetrahedra, along their edges.",
        examples=[{"stiffness": 2000, "ratio": 0.05}],
    )
    face_diagonals: FamilyModel | None = Field(
        default=None,
        description="Across the sides of each cell.",
        examples=[{"stiffness": 1000}],
    )
    body_diagonals: FamilyModel | None = Field(
        default=None, description="Through each cell.", examples=[{"stiffness": 1000}]
    )


class _FramedModel(FileModel):
    offset: Vector | None = Field(
        default=None,
        description="Where in its frame the particles are held [m]; the whole system "
        "is brought there before it begins. Not given: where they are at 0 s.",
        examples=[[0, 0.1, 0]],
    )


class CarryingJointModel(_FramedModel):
    """A joint of a character in motion."""

    file: CharacterFile = None
    source: OwnCharacter = False
    joint: Name = Field(description="Name of the joint.", examples=["hand_r"])


class CarryingVertexModel(_FramedModel):
    """A vertex of a mesh of a character in motion; its frame does not turn."""

    file: CharacterFile = None
    source: OwnCharacter = False
    mesh: Name = Field(description="Name of the rig's mesh.", examples=["body"])
    vertex: Annotated[Whole, Ge(0)] = Field(description="Its number.", examples=[120])


class CarryingPrimModel(FollowedPrimModel, _FramedModel):
    """A prim of a USD file, as that moves."""


class JoinedModel(FileModel):
    """Particles of another system."""

    system: Name = Field(description="Its name.", examples=["flag"])
    particles: Annotated[list[str | Whole], Len(1)] = Field(
        description="Particles of it, one for each or one for all, as `particles` of "
        "a pin.",
        examples=[["top_left"]],
    )


class PinModel(FileModel):
    """Particles that are held, drawn, or joined to others."""

    particles: Annotated[list[str | Whole], Len(1)] = Field(
        description="Which: names of places, numbers from 0 on (-1 is the last), or "
        "an array of numbers, such as cape.npz#pins.",
        examples=[["start"], ["top_left", 40]],
    )
    moves: list[TimedVector] = Field(
        default=[],
        description="Where they are over time, from where they begin: rows of seconds "
        "from the first frame on and three coordinates [m]. Not given: they stay.",
        examples=[[[0, 0, 0, 0], [1, 0.5, 0, 0]]],
    )
    joint: CarryingJointModel | None = Field(
        default=None,
        description="A joint that carries them.",
        examples=[{"file": "walk.clip.yaml", "joint": "hand_r"}],
    )
    vertex: CarryingVertexModel | None = Field(
        default=None,
        description="A vertex of a character's mesh that carries them.",
        examples=[{"file": "walk.clip.yaml", "mesh": "body", "vertex": 12}],
    )
    prim: CarryingPrimModel | None = Field(
        default=None,
        description="A prim of a USD file that carries them.",
        examples=[{"file": "props.usda", "prim": "/Set/hook"}],
    )
    to: JoinedModel | None = Field(
        default=None,
        description="Particles of another system that they become one with: both "
        "move each other.",
        examples=[{"system": "flag", "particles": ["top_left"]}],
    )
    stiffness: Annotated[Real | None, or_more(0, "SIM042")] = Field(
        default=None,
        description="They are drawn there by springs of no length and this stiffness "
        "[N/m]. Not given: they are held.",
        examples=[200],
    )
    damping: Annotated[Real, or_more(0, "SIM042")] = Field(
        default=0.0,
        description="Of such springs: force over speed [N s/m].",
        examples=[1],
    )


class WindModel(FileModel):
    """The air of ropes and strands: `drag` takes them along with it."""

    velocity: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Velocity of the air [m/s].",
        examples=[[4, 0, 0]],
    )
    gusts: list[TimedVector] = Field(
        default=[],
        description="More of it over time: rows of seconds from the first frame on "
        "and three coordinates [m/s].",
        examples=[[[0, 0, 0, 0], [0.5, 3, 0, 1], [1, 0, 0, 0]]],
    )


@with_fields(Air, "density", "drag", "lift")
class FaceWindModel(WindModel):
    """The air that faces bear."""


FaceWindField = Annotated[
    FaceWindModel | None,
    Field(
        description="The air that its faces bear. Not given: none.",
        examples=[{"velocity": [5, 0, 1]}],
    ),
]
