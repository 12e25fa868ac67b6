"""Models of the scene keys of ropes, strands, cloth and volumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Len
from pydantic import Field

from animtool.core.errors import Fault
from animtool.core.options import above, key, or_more
from animtool.core.plugins import load_object
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Integer,
    Name,
    Real,
    Vector,
    record_from_model,
    shared_key,
    with_fields,
)
from animtool.systems.framework.fields import (
    ArrayEntry,
    CarryingBodyModel,
    CarryingJointModel,
    CarryingPrimModel,
    CarryingVertexModel,
    NameEntry,
    PrimMeshModel,
    PrimName,
    TimedVector,
)
from animtool.systems.framework.spec import CollidingSpec
from animtool.systems.springs import Air, Family, SelfContact, SpringOptions

# Keys that apply to all systems of a joined group.
_SOLVER_KEYS = ("solver", "step", "error", "stretch")
_SIMULATION_KEYS = (
    "gravity",
    "radius",
    "speed_limit",
    "self_contact",
    "preroll",
    "settle",
)
_SHARED_KEYS = (*_SOLVER_KEYS, *_SIMULATION_KEYS, "save_at", "resume")


@with_fields(SelfContact, "thickness", "friction", "speed", range_check="schema")
class SelfContactModel(FileModel):
    """Self-contact of a surface, in folds and layers."""


SelfContactField = Annotated[
    SelfContactModel | None,
    shared_key("Self-contact. Default: off.", {"thickness": 0.01}),
]


@with_fields(Family, "stiffness", "damping", "ratio", "rest", "tear", "frequency")
class FamilyModel(FileModel):
    """Properties of a family of springs."""


@with_fields(Family, "axial_stiffness")
class LineFamilyModel(FamilyModel):
    """Springs along ropes and strands."""


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
        "Between neighbouring particles.",
        {"axial_stiffness": 5000, "ratio": 0.1},
        default=None,
    )
    bend: FamilyModel | None = key(
        "Between every second particle, against bending.",
        {"stiffness": 50},
        default=None,
    )


class ClothSpringsModel(FileModel):
    """The springs of cloth; each family can be left out."""

    structural: FamilyModel | None = key(
        "Between neighbours; for a mesh, along its edges.",
        {"stiffness": 1000, "ratio": 0.05},
        default=None,
    )
    diagonals: DiagonalsModel | None = key(
        "Across cells, against shear; for a mesh, across faces of four or more "
        "corners, always both.",
        {"stiffness": 300, "ways": "one"},
        default=None,
    )
    bend: FamilyModel | None = key(
        "Between every second particle, or over the edges of a mesh, against bending.",
        {"stiffness": 10},
        default=None,
    )


class VolumeSpringsModel(FileModel):
    """The springs of volumes; each family can be left out."""

    structural: FamilyModel | None = key(
        "Along the axes; for tetrahedra, along their edges.",
        {"stiffness": 2000, "ratio": 0.05},
        default=None,
    )
    face_diagonals: FamilyModel | None = key(
        "Across the faces of each cell.", {"stiffness": 1000}, default=None
    )
    body_diagonals: FamilyModel | None = key(
        "Through each cell.", {"stiffness": 1000}, default=None
    )


class JoinedModel(FileModel):
    """Particles of another system."""

    system: Name = key("Its name.", "flag")
    particles: Annotated[list[str | Integer], Len(1)] = key(
        "Its particles, one for each or one for all, written like `particles` of a "
        "pin.",
        ["top_left"],
    )


class PinModel(FileModel):
    """Particles that are pinned, pulled, or joined to others."""

    particles: Annotated[list[NameEntry], Len(1)] = Field(
        description="Particles: names of locations, numbers from 0 (-1 is the last), "
        "or an array of numbers, such as cape.npz#pins.",
        examples=[["start"], ["top_left", 40]],
    )
    moves: list[TimedVector] = key(
        "Displacement over time, from the start: rows of seconds from the first "
        "frame and three coordinates [m]. Default: none.",
        [[0, 0, 0, 0], [1, 0.5, 0, 0]],
        default=[],
    )
    joint: CarryingJointModel | None = key(
        "A joint that they follow.",
        {"file": "walk.clip.yaml", "joint": "hand_r"},
        default=None,
    )
    vertex: CarryingVertexModel | None = key(
        "A vertex of a character's mesh that they follow.",
        {"file": "walk.clip.yaml", "mesh": "body", "vertex": 12},
        default=None,
    )
    prim: CarryingPrimModel | None = key(
        "A prim of a USD file that they follow.",
        {"file": "props.usda", "prim": "/Set/hook"},
        default=None,
    )
    body: CarryingBodyModel | None = key(
        "A rigid body of the scene that they are attached to: both affect each other.",
        {"system": "crates", "body": "lamp"},
        default=None,
    )
    to: JoinedModel | None = key(
        "Particles of another system to join with: both affect each other.",
        {"system": "flag", "particles": ["top_left"]},
        default=None,
    )
    stiffness: Annotated[Real | None, or_more(0, "SIM042")] = key(
        "Pulled by springs of rest length 0 and this stiffness [N/m]. Default: held "
        "exactly.",
        200,
        default=None,
    )
    damping: Annotated[Real, or_more(0, "SIM042")] = key(
        "Damping of these springs: force per speed [N s/m].", 1, default=0.0
    )


class WindModel(FileModel):
    """The air around ropes and strands; `drag` couples to it."""

    velocity: Vector = key("Wind velocity [m/s].", [4, 0, 0], default=[0.0, 0.0, 0.0])
    gusts: list[TimedVector] = key(
        "Additional wind over time: rows of seconds from the first frame and three "
        "coordinates [m/s].",
        [[0, 0, 0, 0], [0.5, 3, 0, 1], [1, 0, 0, 0]],
        default=[],
    )


WindField = Annotated[
    WindModel | None,
    shared_key("The air; `drag` couples to it.", {"velocity": [4, 0, 0]}),
]


@with_fields(Air, "density", "drag", "lift")
class FaceWindModel(WindModel):
    """The air that acts on faces."""


FaceWindField = Annotated[
    FaceWindModel | None,
    shared_key(
        "The air that acts on its faces. Default: none.", {"velocity": [5, 0, 1]}
    ),
]


@with_fields(SpringOptions, *_SOLVER_KEYS)
class SolvedModel(CollidingSpec):
    """Keys of systems with a solver."""


class SpringsModel(SolvedModel):
    """Keys shared by ropes, strands, cloth and volumes."""

    method_key: ClassVar[str] = "solver"
    has_trial_settings: ClassVar[bool] = True

    mass: Real = key("Total mass [kg].", 0.5)
    pins: list[PinModel] = key(
        "Pins, and connections to other systems.",
        [{"particles": ["start"]}],
        default=[],
    )
    gravity: Vector = key(
        "Acceleration of all particles [m/s²].",
        [0, -1.62, 0],
        default=[0.0, -9.81, 0.0],
    )
    drag: Annotated[Real, or_more(0, "SIM050")] = key(
        "Damping of all motion, over mass and speed [1/s].", 0.5, default=0.0
    )
    radius: Annotated[Real, or_more(0, "SIM050")] = key(
        "Half its thickness: distance from colliders, and half the width of curves "
        "[m].",
        0.01,
        default=0.005,
    )
    speed_limit: Annotated[Real, above(0, "SIM050")] = key(
        "Faster pins are treated as teleports: what is attached moves along [m/s].",
        500,
        default=200.0,
    )
    settle: bool = key(
        "Start in static equilibrium, without air and colliders.", True, default=False
    )

    def build_record(
        self, entry_data: Mapping[str, Any]
    ) -> tuple[Any, Sequence[Fault]]:
        """Return particles, springs and pins, and all faults."""
        # Loaded by name, as the module imports these models.
        read_record: Any = load_object("animtool.systems.springs.entry:read_entry")
        result: tuple[Any, Sequence[Fault]] = read_record(self, entry_data)
        return result

    def shared(self, *, has_colliders: bool = True) -> Mapping[str, Any]:
        """Return the keys that apply to all joined systems."""
        wind = ("wind",) if isinstance(self.air, FaceWindModel) else ()
        unused_keys = set() if has_colliders else {"radius"}
        specified_keys = self.model_fields_set - unused_keys
        names = [name for name in (*_SHARED_KEYS, *wind) if name in specified_keys]
        return {name: getattr(self, name) for name in names}

    @property
    def options(self) -> SpringOptions:
        """Solver and steps."""
        return record_from_model(SpringOptions, self)

    @property
    def air(self) -> WindModel | None:
        """Wind on particles or faces; None without."""
        return getattr(self, "wind", None)

    @property
    def contact(self) -> SelfContact | None:
        """Settings of self-contact; None if it is off."""
        model: SelfContactModel | None = getattr(self, "self_contact", None)
        return None if model is None else record_from_model(SelfContact, model)


class RopeModel(SpringsModel):
    """A rope, written as a curve. Lengths are in metres."""

    name: PrimName = Field(default="rope", examples=["tow"])
    start: Vector = Field(
        alias="from", description="Start point [m].", examples=[[0, 2, 0]]
    )
    end: Vector = Field(
        alias="to", description="End point [m].", examples=[[1.5, 2, 0]]
    )
    count: Integer = key("Number of particles.", 31)
    tip_mass: Real | None = key(
        "Mass of the last particle [kg]. Default: like the others.", 2, default=None
    )
    springs: LineSpringsModel = key(
        "Its springs.", {"structural": {"stiffness": 1e4, "ratio": 0.1}}
    )
    wind: WindField = None


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
    wind: WindField = None


class ClothModel(SpringsModel):
    """A sheet of cloth, written as a mesh. Lengths are in metres."""

    name: PrimName = Field(default="cloth", examples=["flag"])
    corner: Vector = key(
        "Position of its first corner, bottom left [m].",
        [0, 2, 0],
        default=[0.0, 0.0, 0.0],
    )
    across: Vector = key(
        "Vector from there along the full width [m].",
        [1.5, 0, 0],
        default=[1.0, 0.0, 0.0],
    )
    up: Vector = key(
        "Vector from there along the full height [m].",
        [0, 0, -1],
        default=[0.0, 1.0, 0.0],
    )
    resolution: Annotated[list[Integer], Len(2, 2)] = key(
        "Number of particles across and up.", [31, 21], default=[20, 20]
    )
    mesh: PrimMeshModel | None = key(
        "A mesh instead of a sheet; its mass is distributed over its area.",
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
        "Position of its corner with the smallest x, y and z [m].",
        [-0.5, 1, -0.5],
        default=[0.0, 0.0, 0.0],
    )
    size: Vector = key(
        "Size along x, y and z [m].", [0.5, 0.5, 0.5], default=[1.0, 1.0, 1.0]
    )
    resolution: Annotated[list[Integer], Len(3, 3)] = key(
        "Number of particles along x, y and z.", [8, 4, 8], default=[6, 6, 6]
    )
    tetrahedra: TetrahedraModel | None = key(
        "Tetrahedra instead of a block.",
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
