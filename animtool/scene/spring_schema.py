"""The keys of ropes, strands, cloth and volumes in a scene file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.scene.particle_schema import (
    CharacterModel,
    FollowedPrimModel,
    SystemColliderModel,
    Vector,
)

__all__ = [
    "CarryingJointModel",
    "CarryingPrimModel",
    "CarryingVertexModel",
    "ClothModel",
    "ClothSpringsModel",
    "DiagonalsModel",
    "FaceWindModel",
    "FamilyModel",
    "JoinedModel",
    "LineSpringsModel",
    "PinModel",
    "PrimMeshModel",
    "RopeModel",
    "SelfContactModel",
    "SpringsModel",
    "StrandsModel",
    "TetrahedraModel",
    "VolumeModel",
    "VolumeSpringsModel",
    "WindModel",
]

Name = Annotated[str, Field(min_length=1)]
Row = Annotated[list[float], Len(4, 4)]


class FamilyModel(FileModel):
    """What springs of a family have in common."""

    stiffness: float = Field(
        description="Force over lengthening [N/m].", examples=[1e4]
    )
    damping: float = Field(
        default=0.0,
        description="Along the spring: force over speed [N s/m].",
        examples=[0.5],
    )
    ratio: float = Field(
        default=0.0,
        description="More of it, as a share of what one spring on its ends is "
        "critical with.",
        examples=[0.1],
    )
    rest: float = Field(
        default=1.0,
        description="Length at rest over the distance of the ends as built; 0 draws "
        "them together.",
        examples=[0.9],
    )
    tear: float | None = Field(
        default=None,
        description="Lengthening over the length at rest beyond which a spring tears. "
        "Not given: never.",
        examples=[0.5],
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

    structural: FamilyModel | None = Field(
        default=None,
        description="From each particle to the next.",
        examples=[{"stiffness": 1e4, "ratio": 0.1}],
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
        default=None,
        description="Through each cell.",
        examples=[{"stiffness": 1000}],
    )


class WindModel(FileModel):
    """The air of ropes and strands: `drag` takes them along with it."""

    velocity: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Velocity of the air [m/s].",
        examples=[[4, 0, 0]],
    )
    gusts: list[Row] = Field(
        default=[],
        description="More of it over time: rows of seconds from the first frame on "
        "and three coordinates [m/s].",
        examples=[[[0, 0, 0, 0], [0.5, 3, 0, 1], [1, 0, 0, 0]]],
    )


class FaceWindModel(WindModel):
    """The air that faces bear."""

    density: float = Field(
        default=1.2, description="Of the air [kg/m³].", examples=[0.9]
    )
    drag: float = Field(
        default=1.0, description="Coefficient along the flow.", examples=[1.5]
    )
    lift: float = Field(default=0.5, description="Coefficient across it.", examples=[0])


class _FramedModel(FileModel):
    offset: Vector | None = Field(
        default=None,
        description="Where in its frame the particles are held [m]; the whole system "
        "is brought there before it begins. Not given: where they are at 0 s.",
        examples=[[0, 0.1, 0]],
    )


class CarryingJointModel(_FramedModel):
    """A joint of a character in motion."""

    file: Name | None = Field(
        default=None,
        description="A clip or a scene; its first frame comes at 0 s.",
        examples=["walk.clip.yaml"],
    )
    source: bool = Field(
        default=False,
        description="In place of a file: the character of this scene, behind its "
        "passes.",
        examples=[True],
    )
    joint: Name = Field(description="Name of the joint.", examples=["hand_r"])


class CarryingVertexModel(_FramedModel):
    """A vertex of a mesh of a character in motion; its frame does not turn."""

    file: Name | None = Field(
        default=None,
        description="A clip or a scene; its first frame comes at 0 s.",
        examples=["walk.clip.yaml"],
    )
    source: bool = Field(
        default=False,
        description="In place of a file: the character of this scene, behind its "
        "passes.",
        examples=[True],
    )
    mesh: Name = Field(description="Name of the rig's mesh.", examples=["body"])
    vertex: Annotated[int, Ge(0)] = Field(description="Its number.", examples=[120])


class CarryingPrimModel(FollowedPrimModel, _FramedModel):
    """A prim of a USD file, as that moves."""


class JoinedModel(FileModel):
    """Particles of another system."""

    system: Name = Field(description="Its name.", examples=["flag"])
    particles: Annotated[list[str | int], Len(1)] = Field(
        description="Particles of it, one for each or one for all, as `particles` of "
        "a pin.",
        examples=[["top_left"]],
    )


class PinModel(FileModel):
    """Particles that are held, drawn, or joined to others."""

    particles: Annotated[list[str | int], Len(1)] = Field(
        description="Which: names of places, numbers from 0 on (-1 is the last), or "
        "an array of numbers, such as cape.npz#pins.",
        examples=[["start"], ["top_left", 40]],
    )
    moves: list[Row] = Field(
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
    stiffness: float | None = Field(
        default=None,
        description="They are drawn there by springs of no length and this stiffness "
        "[N/m]. Not given: they are held.",
        examples=[200],
    )
    damping: float = Field(
        default=0.0,
        description="Of such springs: force over speed [N s/m].",
        examples=[1],
    )


class SpringsModel(FileModel):
    """What ropes, strands, cloth and volumes have in common."""

    mass: float = Field(description="Mass of the whole [kg].", examples=[0.5])
    pins: list[PinModel] = Field(
        default=[],
        description="What holds it, and joins it to other systems.",
        examples=[[{"particles": ["start"]}]],
    )
    gravity: Vector = Field(
        default=[0.0, -9.81, 0.0],
        description="Acceleration of all particles [m/s²].",
        examples=[[0, -1.62, 0]],
    )
    drag: float = Field(
        default=0.0,
        description="What slows all motion, over mass and speed [1/s].",
        examples=[0.5],
    )
    radius: float = Field(
        default=0.005,
        description="Half its thickness: what it keeps from colliders, and of curves "
        "half their width [m].",
        examples=[0.01],
    )
    colliders: list[SystemColliderModel] = Field(
        default=[],
        description="What it runs into.",
        examples=[[{"shape": {"plane": None}, "friction": 0.4}]],
    )
    characters: list[CharacterModel] = Field(
        default=[],
        description="Characters in motion that it runs into; none is written.",
        examples=[[{"file": "walk.clip.yaml", "friction": 0.3}]],
    )
    speed_limit: float = Field(
        default=200.0,
        description="Pins that go faster were put elsewhere, and take along what hangs "
        "on them [m/s].",
        examples=[500],
    )
    solver: Literal["auto", "symplectic_euler", "xpbd", "bdf2", "implicit_euler"] = (
        Field(
            default="auto",
            description="What takes it through time; `auto` takes the cheapest that is "
            "stable and near enough, and says why.",
            examples=["xpbd"],
        )
    )
    step: float | None = Field(
        default=None,
        description="The longest step [s]. Not given: what the solver needs.",
        examples=[0.002],
    )
    error: float | None = Field(
        default=None,
        description="Most error of positions [m]: steps are halved until two motions "
        "agree. Not given: it is not asked for.",
        examples=[0.001],
    )
    stretch: float = Field(
        default=0.01,
        description="Of `xpbd`: most that springs may be longer than at rest, where "
        "this is not their own give.",
        examples=[0.005],
    )
    preroll: Annotated[float, Ge(0)] = Field(
        default=0.0,
        description="Seconds before the first frame that it begins in.",
        examples=[2],
    )
    settle: bool = Field(
        default=False,
        description="Whether it begins where it comes to rest, without the air and "
        "colliders.",
        examples=[True],
    )


class RopeModel(SpringsModel):
    """A rope, written as a curve. Lengths are in metres."""

    name: str = Field(default="rope", description="Name of the prim.", examples=["tow"])
    start: Vector = Field(
        alias="from", description="Where it begins [m].", examples=[[0, 2, 0]]
    )
    end: Vector = Field(
        alias="to", description="Where it ends [m].", examples=[[1.5, 2, 0]]
    )
    count: int = Field(description="Number of particles.", examples=[31])
    tip_mass: float | None = Field(
        default=None,
        description="Mass of the last particle [kg]. Not given: as the others.",
        examples=[2],
    )
    springs: LineSpringsModel = Field(
        description="Its springs.",
        examples=[{"structural": {"stiffness": 1e4, "ratio": 0.1}}],
    )
    wind: WindModel | None = Field(
        default=None,
        description="The air; `drag` takes it along.",
        examples=[{"velocity": [4, 0, 0]}],
    )


class StrandsModel(SpringsModel):
    """Many strands, written as curves. Lengths are in metres."""

    name: str = Field(
        default="strands", description="Name of the prim.", examples=["fringe"]
    )
    points: Name = Field(
        description="Array in an npz file, (strands, particles of each, 3) [m], roots "
        "first.",
        examples=["hair.npz#points"],
    )
    springs: LineSpringsModel = Field(
        description="Their springs.",
        examples=[{"structural": {"stiffness": 100}, "bend": {"stiffness": 1}}],
    )
    wind: WindModel | None = Field(
        default=None,
        description="The air; `drag` takes them along.",
        examples=[{"velocity": [4, 0, 0]}],
    )


class PrimMeshModel(FileModel):
    """A mesh of a USD file, as at its first frame."""

    file: Name = Field(description="The USD file.", examples=["table.usda"])
    prim: Name = Field(description="Path of the prim.", examples=["/Set/cloth"])


class SelfContactModel(FileModel):
    """How a surface keeps apart from itself, in folds and layers."""

    thickness: Annotated[float, Gt(0)] = Field(
        description="Least distance of its particles from its faces [m], such as half "
        "the length of an edge.",
        examples=[0.01],
    )
    friction: Annotated[float, Ge(0)] = Field(
        default=0.2, description="Coulomb's coefficient.", examples=[0.4]
    )
    speed: Annotated[float, Gt(0)] = Field(
        default=0.2,
        description="What is nearer at the start comes apart this fast [m/s].",
        examples=[0.1],
    )


class ClothModel(SpringsModel):
    """A sheet of cloth, written as a mesh. Lengths are in metres."""

    name: str = Field(
        default="cloth", description="Name of the prim.", examples=["flag"]
    )
    corner: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Where its first corner is, bottom left [m].",
        examples=[[0, 2, 0]],
    )
    across: Vector = Field(
        default=[1.0, 0.0, 0.0],
        description="From there along the whole width [m].",
        examples=[[1.5, 0, 0]],
    )
    up: Vector = Field(
        default=[0.0, 1.0, 0.0],
        description="From there along the whole height [m].",
        examples=[[0, 0, -1]],
    )
    resolution: Annotated[list[int], Len(2, 2)] = Field(
        default=[20, 20],
        description="Particles across and up.",
        examples=[[31, 21]],
    )
    mesh: PrimMeshModel | None = Field(
        default=None,
        description="A mesh in place of a sheet; its mass is spread over its area.",
        examples=[{"file": "table.usda", "prim": "/Set/cloth"}],
    )
    springs: ClothSpringsModel = Field(
        description="Its springs.",
        examples=[{"structural": {"stiffness": 1000}, "bend": {"stiffness": 5}}],
    )
    wind: FaceWindModel | None = Field(
        default=None,
        description="The air that its faces bear. Not given: none.",
        examples=[{"velocity": [5, 0, 1]}],
    )
    self_contact: SelfContactModel | None = Field(
        default=None,
        description="How it keeps apart from itself. Not given: it goes through.",
        examples=[{"thickness": 0.01}],
    )


class TetrahedraModel(FileModel):
    """A volume of tetrahedra, in npz files."""

    points: Name = Field(
        description="Array of points, (particles, 3) [m].", examples=["jelly.npz"]
    )
    cells: Name = Field(
        description="Array of the four corners of each, (tetrahedra, 4).",
        examples=["jelly.npz"],
    )


class VolumeModel(SpringsModel):
    """A soft body, its skin written as a mesh. Lengths are in metres."""

    name: str = Field(
        default="volume", description="Name of the prim.", examples=["jelly"]
    )
    corner: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Where its corner of least x, y and z is [m].",
        examples=[[-0.5, 1, -0.5]],
    )
    size: Vector = Field(
        default=[1.0, 1.0, 1.0],
        description="Along x, y and z [m].",
        examples=[[0.5, 0.5, 0.5]],
    )
    resolution: Annotated[list[int], Len(3, 3)] = Field(
        default=[6, 6, 6],
        description="Particles along x, y and z.",
        examples=[[8, 4, 8]],
    )
    tetrahedra: TetrahedraModel | None = Field(
        default=None,
        description="Tetrahedra in place of a block.",
        examples=[{"points": "jelly.npz", "cells": "jelly.npz"}],
    )
    springs: VolumeSpringsModel = Field(
        description="Its springs.",
        examples=[
            {
                "structural": {"stiffness": 2000},
                "face_diagonals": {"stiffness": 1000},
                "body_diagonals": {"stiffness": 1000},
            }
        ],
    )
    wind: FaceWindModel | None = Field(
        default=None,
        description="The air that its faces bear. Not given: none.",
        examples=[{"velocity": [5, 0, 1]}],
    )
    self_contact: SelfContactModel | None = Field(
        default=None,
        description="How it keeps apart from itself. Not given: it goes through.",
        examples=[{"thickness": 0.01}],
    )
