"""The keys of particles in a scene file, and of what they run into, as models."""

from __future__ import annotations

from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.documents.check import FileModel

__all__ = [
    "CharacterModel",
    "EmitterModel",
    "FollowedPrimModel",
    "MovingMeshModel",
    "ParticlesModel",
    "SystemColliderModel",
    "SystemSurfaceModel",
    "Vector",
    "VelocityModel",
]

Vector = Annotated[list[float], Len(3, 3)]
# One name of a table, and its options.
Named = Annotated[dict[str, dict[str, Any] | None], Len(1, 1)]


class FollowedPrimModel(FileModel):
    """A prim of a USD file, as that moves and turns."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="The USD file.", examples=["props.usda"]
    )
    prim: Annotated[str, Field(min_length=1)] = Field(
        description="Path of the prim.", examples=["/Set/hook"]
    )
    frame: float | None = Field(
        default=None,
        description="Time code of its file that comes at 0 s. Not given: the first.",
        examples=[101],
    )


class _PlacedModel(FileModel):
    at: Vector = Field(
        default=[0.0, 0.0, 0.0],
        description="Where it is [m].",
        examples=[[0, 1.5, 0]],
    )
    rotate: Annotated[list[float], Len(4, 4)] = Field(
        default=[1.0, 0.0, 0.0, 0.0],
        description="How it is turned: a quaternion w, x, y, z.",
        examples=[[0.7071, 0, 0.7071, 0]],
    )
    moves: list[Annotated[list[float], Len(4, 4)]] = Field(
        default=[],
        description="Where it is over time, from `at`: rows of seconds from the first "
        "frame on and three coordinates [m]. Not given: it stays.",
        examples=[[[0, 0, 0, 0], [2, 4, 0, 0]]],
    )
    turns: list[Annotated[list[float], Len(5, 5)]] = Field(
        default=[],
        description="How it is turned over time, after `rotate`: rows of seconds from "
        "the first frame on and a quaternion w, x, y, z; it turns the short way from "
        "row to row. Not given: it does not turn.",
        examples=[[[0, 1, 0, 0, 0], [1, 0.7071, 0, 0, 0.7071]]],
    )
    prim: FollowedPrimModel | None = Field(
        default=None,
        description="A prim that it goes and turns with, in place of `moves` and "
        "`turns`; `at` and `rotate` are in the frame of the prim then.",
        examples=[{"file": "props.usda", "prim": "/Set/mill"}],
    )


class EmitterModel(_PlacedModel):
    """What makes particles."""

    name: str = Field(default="", description="For messages.", examples=["embers"])
    place: Named = Field(
        default={"point": None},
        description="Where they are born: `point`, `disc`, `sphere`, `box` or `mesh`.",
        examples=[{"disc": {"radius": 0.2}}],
    )
    rate: float = Field(default=0.0, description="Particles a second.", examples=[200])
    bursts: list[Annotated[list[float], Len(2, 2)]] = Field(
        default=[],
        description="Seconds from the first frame on, and how many at once.",
        examples=[[[0, 50], [1.5, 50]]],
    )
    start: float | None = Field(
        default=None,
        description="Second that the rate begins in. Not given: the first.",
        examples=[0.5],
    )
    end: float | None = Field(
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
    spread: float = Field(
        default=0.0,
        description="Half the angle of the cone about it [deg]; 180 is all around.",
        examples=[20],
    )
    speed: float = Field(default=0.0, description="Speed [m/s].", examples=[3])
    speed_spread: float = Field(
        default=0.0, description="Most that it differs by [m/s].", examples=[0.5]
    )
    inherit: float = Field(
        default=1.0,
        description="Share of the emitter's velocity that they have too.",
        examples=[0.5],
    )
    lifetime: float | None = Field(
        default=None,
        description="How long they live [s]. Not given: for ever.",
        examples=[2.5],
    )
    lifetime_spread: float = Field(
        default=0.0, description="Most that it differs by [s].", examples=[0.5]
    )
    radius: float = Field(
        default=0.005, description="Their radius [m].", examples=[0.01]
    )
    radius_spread: float = Field(
        default=0.0, description="Most that it differs by [m].", examples=[0.005]
    )
    mass: float = Field(default=0.001, description="Their mass [kg].", examples=[0.1])
    charge: float = Field(default=0.0, description="Their charge [C].", examples=[1e-6])
    seed: int = Field(
        default=0, description="Of what is random about them.", examples=[7]
    )


class _MaterialModel(FileModel):
    restitution: float = Field(
        default=0.0,
        description="Share of the speed into the surface that comes back, 0 to 1.",
        examples=[0.4],
    )
    friction: float = Field(
        default=0.0, description="Coulomb's coefficient.", examples=[0.3]
    )


class SystemColliderModel(_PlacedModel, _MaterialModel):
    """What particles run into, or where they are removed."""

    name: str = Field(default="", description="For messages.", examples=["step_1"])
    shape: Named = Field(
        description="`plane`, `sphere`, `capsule`, `box` or `mesh`.",
        examples=[{"box": {"size": [2, 0.2, 1]}}],
    )
    container: bool = Field(
        default=False,
        description="Particles are to stay inside; of `kill`, those outside go.",
        examples=[True],
    )
    margin: float = Field(
        default=0.0, description="Distance that they keep [m].", examples=[0.01]
    )
    depenetration: float = Field(
        default=1.0,
        description="How fast those that begin inside are moved out [m/s].",
        examples=[0.5],
    )
    speed_limit: float = Field(
        default=200.0,
        description="What moves faster was put elsewhere, and hits nothing [m/s].",
        examples=[500],
    )


class CharacterModel(_MaterialModel):
    """A character in motion that particles run into: the capsules of its rig."""

    file: Annotated[str, Field(min_length=1)] | None = Field(
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
    margin: float = Field(
        default=0.0, description="Distance that they keep [m].", examples=[0.01]
    )


class SystemSurfaceModel(_MaterialModel):
    """Cloth or a volume of the same scene that particles run into."""

    system: Annotated[str, Field(min_length=1)] = Field(
        description="Its name; it does not feel them.", examples=["flag"]
    )


class MovingMeshModel(FollowedPrimModel, _MaterialModel):
    """A mesh of a USD file that particles run into, as it moves and changes shape."""

    radius: float = Field(
        default=0.005, description="Half its thickness [m].", examples=[0.01]
    )
    closed: bool = Field(
        default=False,
        description="It is the skin of a body: met from outside alone.",
        examples=[True],
    )


class VelocityModel(FileModel):
    """A velocity field: expressions of x, y, z, t and age."""

    x: str = Field(default="0", description="Along x [m/s].", examples=["-z"])
    y: str = Field(default="0", description="Along y [m/s].", examples=["0.2"])
    z: str = Field(default="0", description="Along z [m/s].", examples=["x"])


class ParticlesModel(FileModel):
    """Particles: born, moved, stopped and removed. Lengths are in metres."""

    name: str = Field(
        default="particles", description="Name of the prim.", examples=["embers"]
    )
    emitters: Annotated[list[EmitterModel], Len(1)] = Field(
        description="What makes them.",
        examples=[[{"rate": 100, "speed": 2, "lifetime": 1}]],
    )
    forces: list[Named] = Field(
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
    step: float = Field(
        default=0.01,
        description="Step of the simulation [s], whatever the frame rate is.",
        examples=[0.005],
    )
    tolerance: float | None = Field(
        default=None,
        description="Of integrators that choose their steps: most error of each.",
        examples=[1e-5],
    )
    preroll: Annotated[float, Ge(0)] = Field(
        default=0.0,
        description="Seconds before the first frame that it begins in.",
        examples=[2],
    )
    most: Annotated[int, Gt(0), Le(10**8)] = Field(
        default=1_000_000, description="Particles at once.", examples=[5000]
    )
