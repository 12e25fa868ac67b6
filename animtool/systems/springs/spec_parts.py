"""The keys of pins, families of springs, contacts and wind, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector, Whole, key, with_fields
from animtool.options import or_more
from animtool.systems.fields import (
    CarryingJointModel,
    CarryingPrimModel,
    CarryingVertexModel,
    NameEntry,
    TimedVector,
)
from animtool.systems.springs import Air, Family, SelfContact


@with_fields(SelfContact, "thickness", "friction", "speed", bounds=True)
class SelfContactModel(FileModel):
    """How a surface keeps apart from itself, in folds and layers."""


SelfContactField = Annotated[
    SelfContactModel | None,
    key(
        "How it keeps apart from itself. Not given: it goes through.",
        {"thickness": 0.01},
    ),
]


@with_fields(Family, "stiffness", "damping", "ratio", "rest", "tear")
class FamilyModel(FileModel):
    """What springs of a family have in common."""


@with_fields(Family, "axial_stiffness")
class LineFamilyModel(FamilyModel):
    """Springs along ropes and strands."""

    stiffness: Real | None = key(
        "Force over lengthening of each spring [N/m]. Not given: `axial_stiffness` is.",
        1e4,
        default=None,
    )


class DiagonalsModel(FamilyModel):
    """Springs across the cells of cloth."""

    ways: Literal["one", "both"] = key(
        "Along one diagonal of each cell, from its first corner, or along both.",
        "one",
        default="both",
    )


class LineSpringsModel(FileModel):
    """The springs of ropes and strands; each family can be left out."""

    structural: LineFamilyModel | None = key(
        "From each particle to the next.",
        {"axial_stiffness": 5000, "ratio": 0.1},
        default=None,
    )
    bend: FamilyModel | None = key(
        "From each to the next but one, against bending.",
        {"stiffness": 50},
        default=None,
    )


class ClothSpringsModel(FileModel):
    """The springs of cloth; each family can be left out."""

    structural: FamilyModel | None = key(
        "Between neighbours; of a mesh, along its edges.",
        {"stiffness": 1000, "ratio": 0.05},
        default=None,
    )
    diagonals: DiagonalsModel | None = key(
        "Across cells, against shearing; of a mesh, across faces of four "
        "corners or more, always both.",
        {"stiffness": 300, "ways": "one"},
        default=None,
    )
    bend: FamilyModel | None = key(
        "From each to the next but one, or over the edges of a mesh, against bending.",
        {"stiffness": 10},
        default=None,
    )


class VolumeSpringsModel(FileModel):
    """The springs of volumes; each family can be left out."""

    structural: FamilyModel | None = key(
        "Along the axes; of tetrahedra, along their edges.",
        {"stiffness": 2000, "ratio": 0.05},
        default=None,
    )
    face_diagonals: FamilyModel | None = key(
        "Across the sides of each cell.", {"stiffness": 1000}, default=None
    )
    body_diagonals: FamilyModel | None = key(
        "Through each cell.", {"stiffness": 1000}, default=None
    )


class JoinedModel(FileModel):
    """Particles of another system."""

    system: Name = key("Its name.", "flag")
    particles: Annotated[list[str | Whole], Len(1)] = key(
        "Particles of it, one for each or one for all, as `particles` of a pin.",
        ["top_left"],
    )


class PinModel(FileModel):
    """Particles that are held, drawn, or joined to others."""

    particles: Annotated[list[NameEntry], Len(1)] = Field(
        description="Which: names of places, numbers from 0 on (-1 is the last), or "
        "an array of numbers, such as cape.npz#pins.",
        examples=[["start"], ["top_left", 40]],
    )
    moves: list[TimedVector] = key(
        "Where they are over time, from where they begin: rows of seconds "
        "from the first frame on and three coordinates [m]. Not given: they stay.",
        [[0, 0, 0, 0], [1, 0.5, 0, 0]],
        default=[],
    )
    joint: CarryingJointModel | None = key(
        "A joint that carries them.",
        {"file": "walk.clip.yaml", "joint": "hand_r"},
        default=None,
    )
    vertex: CarryingVertexModel | None = key(
        "A vertex of a character's mesh that carries them.",
        {"file": "walk.clip.yaml", "mesh": "body", "vertex": 12},
        default=None,
    )
    prim: CarryingPrimModel | None = key(
        "A prim of a USD file that carries them.",
        {"file": "props.usda", "prim": "/Set/hook"},
        default=None,
    )
    to: JoinedModel | None = key(
        "Particles of another system that they become one with: both move each other.",
        {"system": "flag", "particles": ["top_left"]},
        default=None,
    )
    stiffness: Annotated[Real | None, or_more(0, "SIM042")] = key(
        "They are drawn there by springs of no length and this stiffness "
        "[N/m]. Not given: they are held.",
        200,
        default=None,
    )
    damping: Annotated[Real, or_more(0, "SIM042")] = key(
        "Of such springs: force over speed [N s/m].", 1, default=0.0
    )


class WindModel(FileModel):
    """The air of ropes and strands: `drag` takes them along with it."""

    velocity: Vector = key(
        "Velocity of the air [m/s].", [4, 0, 0], default=[0.0, 0.0, 0.0]
    )
    gusts: list[TimedVector] = key(
        "More of it over time: rows of seconds from the first frame on "
        "and three coordinates [m/s].",
        [[0, 0, 0, 0], [0.5, 3, 0, 1], [1, 0, 0, 0]],
        default=[],
    )


@with_fields(Air, "density", "drag", "lift")
class FaceWindModel(WindModel):
    """The air that faces bear."""


FaceWindField = Annotated[
    FaceWindModel | None,
    key("The air that its faces bear. Not given: none.", {"velocity": [5, 0, 1]}),
]
