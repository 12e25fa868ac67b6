"""The keys of ropes, strands, cloth and volumes in a scene file, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector, Whole, with_fields
from animtool.options import above, or_more
from animtool.systems.fields import (
    CharacterModel,
    MovingMeshModel,
    Preroll,
    PrimName,
    PrimPath,
    SystemColliderModel,
    UsdFile,
)
from animtool.systems.springs import SpringOptions
from animtool.systems.springs.spec_parts import (
    ClothSpringsModel,
    FaceWindField,
    LineSpringsModel,
    PinModel,
    SelfContactField,
    VolumeSpringsModel,
    WindModel,
)


@with_fields(SpringOptions, "solver", "step", "error", "stretch", before="preroll")
class SpringsModel(FileModel):
    """What ropes, strands, cloth and volumes have in common."""

    mass: Real = Field(description="Mass of the whole [kg].", examples=[0.5])
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
    drag: Annotated[Real, or_more(0, "SIM050")] = Field(
        default=0.0,
        description="What slows all motion, over mass and speed [1/s].",
        examples=[0.5],
    )
    radius: Annotated[Real, or_more(0, "SIM050")] = Field(
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
    meshes: list[MovingMeshModel] = Field(
        default=[],
        description="Meshes of USD files that it runs into, whose points may move.",
        examples=[[{"file": "beast.usdc", "prim": "/beast/body", "closed": True}]],
    )
    speed_limit: Annotated[Real, above(0, "SIM050")] = Field(
        default=200.0,
        description="Pins that go faster were put elsewhere, and take along what hangs "
        "on them [m/s].",
        examples=[500],
    )
    preroll: Preroll = 0.0
    settle: bool = Field(
        default=False,
        description="Whether it begins where it comes to rest, without the air and "
        "colliders.",
        examples=[True],
    )


class RopeModel(SpringsModel):
    """A rope, written as a curve. Lengths are in metres."""

    name: PrimName = Field(default="rope", examples=["tow"])
    start: Vector = Field(
        alias="from", description="Where it begins [m].", examples=[[0, 2, 0]]
    )
    end: Vector = Field(
        alias="to", description="Where it ends [m].", examples=[[1.5, 2, 0]]
    )
    count: Whole = Field(description="Number of particles.", examples=[31])
    tip_mass: Real | None = Field(
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

    name: PrimName = Field(default="strands", examples=["fringe"])
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

    file: UsdFile = Field(examples=["table.usda"])
    prim: PrimPath = Field(examples=["/Set/cloth"])


class ClothModel(SpringsModel):
    """A sheet of cloth, written as a mesh. Lengths are in metres."""

    name: PrimName = Field(default="cloth", examples=["flag"])
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
    resolution: Annotated[list[Whole], Len(2, 2)] = Field(
        default=[20, 20], description="Particles across and up.", examples=[[31, 21]]
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
    wind: FaceWindField = None
    self_contact: SelfContactField = None


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

    name: PrimName = Field(default="volume", examples=["jelly"])
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
    resolution: Annotated[list[Whole], Len(3, 3)] = Field(
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
    wind: FaceWindField = None
    self_contact: SelfContactField = None
