"""The keys of ropes, strands, cloth and volumes in a scene file, as models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Real, Vector, Whole, key, with_fields
from animtool.errors import Fault
from animtool.options import above, or_more
from animtool.plugins import load_object
from animtool.systems.fields import (
    ArrayEntry,
    CharacterModel,
    MovingMeshModel,
    PrimMeshModel,
    PrimName,
    SystemColliderModel,
    SystemSpec,
    SystemSurfaceModel,
)
from animtool.systems.springs import SpringOptions
from animtool.systems.springs.spec_parts import (
    ClothSpringsModel,
    FaceWindField,
    FaceWindModel,
    LineSpringsModel,
    PinModel,
    SelfContactField,
    VolumeSpringsModel,
    WindModel,
)

# What systems that are joined have in common, where one of them states it.
_OPTIONS = ("solver", "step", "error", "stretch")
_SHARED = ("gravity", "radius", "speed_limit", "self_contact", "preroll", "settle")
_SAVED = ("save_at", "resume")


@with_fields(SpringOptions, *_OPTIONS)
class SolvedModel(SystemSpec):
    """What a solver takes through time."""


class SpringsModel(SolvedModel):
    """What ropes, strands, cloth and volumes have in common."""

    method_key: ClassVar[str] = "solver"
    tried: ClassVar[bool] = True

    mass: Real = key("Mass of the whole [kg].", 0.5)
    pins: list[PinModel] = key(
        "What holds it, and joins it to other systems.",
        [{"particles": ["start"]}],
        default=[],
    )
    gravity: Vector = key(
        "Acceleration of all particles [m/s²].",
        [0, -1.62, 0],
        default=[0.0, -9.81, 0.0],
    )
    drag: Annotated[Real, or_more(0, "SIM050")] = key(
        "What slows all motion, over mass and speed [1/s].", 0.5, default=0.0
    )
    radius: Annotated[Real, or_more(0, "SIM050")] = key(
        "Half its thickness: what it keeps from colliders, and of curves "
        "half their width [m].",
        0.01,
        default=0.005,
    )
    colliders: list[SystemColliderModel] = key(
        "What it runs into.", [{"shape": {"plane": None}, "friction": 0.4}], default=[]
    )
    characters: list[CharacterModel] = key(
        "Characters in motion that it runs into; none is written.",
        [{"file": "walk.clip.yaml", "friction": 0.3}],
        default=[],
    )
    systems: list[SystemSurfaceModel] = key(
        "Cloth, volumes and rigid bodies of the scene that it runs into.",
        [{"system": "crates", "two_way": True}],
        default=[],
    )
    meshes: list[MovingMeshModel] = key(
        "Meshes of USD files that it runs into, whose points may move.",
        [{"file": "beast.usdc", "prim": "/beast/body", "closed": True}],
        default=[],
    )
    speed_limit: Annotated[Real, above(0, "SIM050")] = key(
        "Pins that go faster were put elsewhere, and take along what hangs "
        "on them [m/s].",
        500,
        default=200.0,
    )
    settle: bool = key(
        "Whether it begins where it comes to rest, without the air and colliders.",
        True,
        default=False,
    )

    def made(self, parts: Mapping[str, Any]) -> tuple[Any, Sequence[Fault]]:
        """Return particles and springs, and what holds them, with all that is wrong."""
        # Loaded by name: it looks at models.
        read: Any = load_object("animtool.systems.springs.entry:read_entry")
        made: tuple[Any, Sequence[Fault]] = read(self, parts)
        return made

    def shared(self, *, meets: bool = True) -> Mapping[str, Any]:
        """Return what it states for all that it is joined to; a radius if any meets."""
        names = [*_OPTIONS, *_SHARED, *_SAVED]
        names += ["wind"] if isinstance(self._wind, FaceWindModel) else []
        stated = self.model_fields_set - (set() if meets else {"radius"})
        return {name: getattr(self, name) for name in names if name in stated}

    @property
    def _wind(self) -> WindModel | None:
        return getattr(self, "wind", None)


class RopeModel(SpringsModel):
    """A rope, written as a curve. Lengths are in metres."""

    name: PrimName = Field(default="rope", examples=["tow"])
    start: Vector = Field(
        alias="from", description="Where it begins [m].", examples=[[0, 2, 0]]
    )
    end: Vector = Field(
        alias="to", description="Where it ends [m].", examples=[[1.5, 2, 0]]
    )
    count: Whole = key("Number of particles.", 31)
    tip_mass: Real | None = key(
        "Mass of the last particle [kg]. Not given: as the others.", 2, default=None
    )
    springs: LineSpringsModel = key(
        "Its springs.", {"structural": {"stiffness": 1e4, "ratio": 0.1}}
    )
    wind: WindModel | None = key(
        "The air; `drag` takes it along.", {"velocity": [4, 0, 0]}, default=None
    )


class StrandsModel(SpringsModel):
    """Many strands, written as curves. Lengths are in metres."""

    name: PrimName = Field(default="strands", examples=["fringe"])
    points: ArrayEntry = key(
        "Array in an npz file, (strands, particles of each, 3) [m], roots first.",
        "hair.npz#points",
    )
    springs: LineSpringsModel = key(
        "Their springs.", {"structural": {"stiffness": 100}, "bend": {"stiffness": 1}}
    )
    wind: WindModel | None = key(
        "The air; `drag` takes them along.", {"velocity": [4, 0, 0]}, default=None
    )


class ClothModel(SpringsModel):
    """A sheet of cloth, written as a mesh. Lengths are in metres."""

    name: PrimName = Field(default="cloth", examples=["flag"])
    corner: Vector = key(
        "Where its first corner is, bottom left [m].",
        [0, 2, 0],
        default=[0.0, 0.0, 0.0],
    )
    across: Vector = key(
        "From there along the whole width [m].", [1.5, 0, 0], default=[1.0, 0.0, 0.0]
    )
    up: Vector = key(
        "From there along the whole height [m].", [0, 0, -1], default=[0.0, 1.0, 0.0]
    )
    resolution: Annotated[list[Whole], Len(2, 2)] = key(
        "Particles across and up.", [31, 21], default=[20, 20]
    )
    mesh: PrimMeshModel | None = key(
        "A mesh in place of a sheet; its mass is spread over its area.",
        {"file": "table.usda", "prim": "/Set/cloth"},
        default=None,
    )
    springs: ClothSpringsModel = key(
        "Its springs.", {"structural": {"stiffness": 1000}, "bend": {"stiffness": 5}}
    )
    wind: FaceWindField = None
    self_contact: SelfContactField = None


class TetrahedraModel(FileModel):
    """A volume of tetrahedra, in npz files."""

    points: ArrayEntry = key("Array of points, (particles, 3) [m].", "jelly.npz")
    cells: ArrayEntry = key(
        "Array of the four corners of each, (tetrahedra, 4).", "jelly.npz"
    )


class VolumeModel(SpringsModel):
    """A soft body, its skin written as a mesh. Lengths are in metres."""

    name: PrimName = Field(default="volume", examples=["jelly"])
    corner: Vector = key(
        "Where its corner of least x, y and z is [m].",
        [-0.5, 1, -0.5],
        default=[0.0, 0.0, 0.0],
    )
    size: Vector = key(
        "Along x, y and z [m].", [0.5, 0.5, 0.5], default=[1.0, 1.0, 1.0]
    )
    resolution: Annotated[list[Whole], Len(3, 3)] = key(
        "Particles along x, y and z.", [8, 4, 8], default=[6, 6, 6]
    )
    tetrahedra: TetrahedraModel | None = key(
        "Tetrahedra in place of a block.",
        {"points": "jelly.npz", "cells": "jelly.npz"},
        default=None,
    )
    springs: VolumeSpringsModel = key(
        "Its springs.",
        {
            "structural": {"stiffness": 2000},
            "face_diagonals": {"stiffness": 1000},
            "body_diagonals": {"stiffness": 1000},
        },
    )
    wind: FaceWindField = None
    self_contact: SelfContactField = None
