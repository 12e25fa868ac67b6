"""The keys of particles in a scene file, as models."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Gt, Le, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Pair, Real, Vector, Whole
from animtool.systems.fields import (
    CharacterModel,
    ForceEntry,
    MovingMeshModel,
    PlacedModel,
    PlaceEntry,
    Preroll,
    PrimName,
    SystemColliderModel,
    SystemSurfaceModel,
)


class EmitterModel(PlacedModel):
    """What makes particles."""

    name: str = Field(default="", description="For messages.", examples=["embers"])
    place: PlaceEntry = Field(
        default={"point": None},
        description="Where they are born: `point`, `disc`, `sphere`, `box` or `mesh`.",
        examples=[{"disc": {"radius": 0.2}}],
    )
    rate: Annotated[Real, Le(1e9)] = Field(
        default=0.0, description="Particles a second.", examples=[200]
    )
    bursts: list[Pair] = Field(
        default=[],
        description="Seconds from the first frame on, and how many at once.",
        examples=[[[0, 50], [1.5, 50]]],
    )
    start: Real | None = Field(
        default=None,
        description="Second that the rate begins in. Not given: the first.",
        examples=[0.5],
    )
    end: Real | None = Field(
        default=None,
        description="Second that the rate ends in. Not given: never.",
        examples=[2.5],
    )
    direction: Vector | None = Field(
        default=None,
        description="Middle of their directions. Not given: y, and from surfaces "
        "outwards.",
        examples=[[1, 1, 0]],
    )
    spread: Real = Field(
        default=0.0,
        description="Half the angle of the cone about it [deg]; 180 is all around.",
        examples=[20],
    )
    speed: Real = Field(default=0.0, description="Speed [m/s].", examples=[3])
    speed_spread: Real = Field(
        default=0.0, description="Most that it differs by [m/s].", examples=[0.5]
    )
    inherit: Real = Field(
        default=1.0,
        description="Share of the emitter's velocity that they have too.",
        examples=[0.5],
    )
    lifetime: Real | None = Field(
        default=None,
        description="How long they live [s]. Not given: for ever.",
        examples=[2.5],
    )
    lifetime_spread: Real = Field(
        default=0.0, description="Most that it differs by [s].", examples=[0.5]
    )
    radius: Real = Field(
        default=0.005, description="Their radius [m].", examples=[0.01]
    )
    radius_spread: Real = Field(
        default=0.0, description="Most that it differs by [m].", examples=[0.005]
    )
    mass: Real = Field(default=0.001, description="Their mass [kg].", examples=[0.1])
    charge: Real = Field(default=0.0, description="Their charge [C].", examples=[1e-6])
    seed: Whole = Field(
        default=0, description="Of what is random about them.", examples=[7]
    )


class VelocityModel(FileModel):
    """A velocity field: expressions of x, y, z, t and age."""

    x: str = Field(default="0", description="Along x [m/s].", examples=["-z"])
    y: str = Field(default="0", description="Along y [m/s].", examples=["0.2"])
    z: str = Field(default="0", description="Along z [m/s].", examples=["x"])


class ParticlesModel(FileModel):
    """Particles: born, moved, stopped and removed. Lengths are in metres."""

    name: PrimName = Field(default="particles", examples=["embers"])
    emitters: Annotated[list[EmitterModel], Len(1)] = Field(
        description="What makes them.",
        examples=[[{"rate": 100, "speed": 2, "lifetime": 1}]],
    )
    forces: list[ForceEntry] = Field(
        default=[],
        description="What moves them: the name of a force, and its options.",
        examples=[[{"gravity": None}, {"drag": {"linear": 0.001}}]],
    )
    velocity: VelocityModel | None = Field(
        default=None,
        description="A field that they go with, in place of forces.",
        examples=[{"x": "-z", "z": "x"}],
    )
    colliders: list[SystemColliderModel] = Field(
        default=[],
        description="What they run into.",
        examples=[[{"shape": {"plane": None}, "restitution": 0.4}]],
    )
    characters: list[CharacterModel] = Field(
        default=[],
        description="Characters in motion that they run into; none is written.",
        examples=[[{"file": "walk.clip.yaml", "friction": 0.3}]],
    )
    systems: list[SystemSurfaceModel] = Field(
        default=[],
        description="Cloth and volumes of the scene that they run into, as thick as "
        "their `radius`.",
        examples=[[{"system": "flag", "friction": 0.3}]],
    )
    meshes: list[MovingMeshModel] = Field(
        default=[],
        description="Meshes of USD files that they run into, whose points may move.",
        examples=[[{"file": "beast.usdc", "prim": "/beast/body", "closed": True}]],
    )
    kill: list[SystemColliderModel] = Field(
        default=[],
        description="Where they are removed.",
        examples=[[{"shape": {"plane": {"offset": -1}}}]],
    )
    method: str = Field(
        default="midpoint", description="An integrator.", examples=["rk4"]
    )
    step: Real = Field(
        default=0.01,
        description="Step of the simulation [s], whatever the frame rate is.",
        examples=[0.005],
    )
    tolerance: Real | None = Field(
        default=None,
        description="Of integrators that choose their steps: most error of each.",
        examples=[1e-5],
    )
    preroll: Preroll = 0.0
    max_particles: Annotated[Whole, Gt(0), Le(10**7)] = Field(
        default=1_000_000, description="Particles at once.", examples=[5000]
    )
