"""The keys of a flock in a scene file, as models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Name, Real, Vector, Whole
from animtool.systems.fields import (
    ArrayEntry,
    CharacterModel,
    ForceEntry,
    MovingMeshModel,
    PlacedModel,
    PlaceEntry,
    PrototypeModel,
    SystemColliderModel,
    SystemSpec,
    SystemSurfaceModel,
)

Positive = Annotated[Real, Gt(0)]
NotNegative = Annotated[Real, Ge(0)]


class VisionModel(FileModel):
    """Whom a member sees."""

    radius: Positive = Field(
        default=2.0, description="How far it sees [m].", examples=[3]
    )
    angle: Annotated[Real, Gt(0), Le(360)] = Field(
        default=360.0,
        description="Angle about its way that it sees, from edge to edge [deg].",
        examples=[300],
    )
    nearest: Annotated[Whole, Ge(1), Le(10_000)] | None = Field(
        default=None,
        description="It heeds so many, the nearest. Not given: all that it sees.",
        examples=[7],
    )


class PullModel(FileModel):
    """How strongly a member does something, and by those how near."""

    weight: NotNegative = Field(description="How strongly; 0 is not.", examples=[1.5])
    radius: Positive | None = Field(
        default=None,
        description="By those within this distance [m]. Not given: by all that it "
        "sees.",
        examples=[1.2],
    )


class RepulsionModel(PullModel):
    """How strongly a member keeps away from each other one."""

    softening: NotNegative = Field(
        default=0.1,
        description="Below this distance the push grows no more [m].",
        examples=[0.05],
    )


class OtherModel(FileModel):
    """Another species, and how members heed it."""

    species: Name = Field(description="Its name.", examples=["hawk"])
    weight: NotNegative = Field(description="How strongly.", examples=[40])
    radius: Positive = Field(description="How near it must be [m].", examples=[6])


class SpeedModel(FileModel):
    """How fast members go."""

    cruise: Positive = Field(
        default=3.0, description="Speed that they tend to [m/s].", examples=[8]
    )
    weight: NotNegative = Field(
        default=0.2,
        description="How strongly: they gain this times the lack of its square and "
        "their velocity [s/m²].",
        examples=[0.05],
    )
    least: NotNegative = Field(
        default=0.0, description="None is slower [m/s].", examples=[4]
    )
    most: Positive | None = Field(
        default=None,
        description="None is faster [m/s]. Not given: twice the cruise.",
        examples=[12],
    )


class FlockGoalModel(PlacedModel):
    """Where members are drawn to; it may move, or go with a prim."""

    weight: Real = Field(
        description="How strongly: their acceleration over the way to it [1/s²]; "
        "below 0 it drives them away.",
        examples=[0.1],
    )
    radius: NotNegative = Field(
        default=0.0, description="It pulls nobody within [m].", examples=[4]
    )
    limit: Positive | None = Field(
        default=None, description="Most acceleration [m/s²].", examples=[5]
    )


class PathModel(FileModel):
    """A way that members follow, from point to point."""

    points: Annotated[list[Vector], Len(2, 10_000)] = Field(
        description="Its points [m].", examples=[[[0, 5, 0], [20, 5, 0]]]
    )
    closed: bool = Field(
        default=False, description="It goes on from its end.", examples=[True]
    )
    weight: NotNegative = Field(
        default=0.5,
        description="How strongly: their acceleration over the way to where they "
        "should be [1/s²].",
        examples=[1],
    )
    ahead: Positive = Field(
        default=2.0,
        description="How far along it they look from where they are nearest [m].",
        examples=[4],
    )
    radius: NotNegative = Field(
        default=0.0, description="It pulls nobody within [m].", examples=[2]
    )


class AvoidanceModel(FileModel):
    """How members keep clear of what they could run into."""

    distance: Positive = Field(
        default=1.5, description="From how far on [m].", examples=[3]
    )
    weight: NotNegative = Field(
        default=10.0,
        description="Acceleration away from a surface that is touched [m/s²]; what "
        "brakes them before it comes on top.",
        examples=[30],
    )


class SpeciesModel(PlacedModel):
    """Members of one kind: where they begin, and what they do."""

    name: Name = Field(description="Its name.", examples=["starling"])
    count: Annotated[Whole, Ge(0), Le(2 * 10**6)] = Field(
        default=100, description="How many.", examples=[500]
    )
    place: PlaceEntry = Field(
        default={"sphere": {"radius": 2.0}},
        description="Where they begin: `point`, `disc`, `sphere`, `box` or `mesh`.",
        examples=[{"box": {"size": [6, 2, 6]}}],
    )
    direction: Vector | None = Field(
        default=None,
        description="Middle of their directions. Not given: z.",
        examples=[[1, 0, 0]],
    )
    spread: Annotated[Real, Ge(0), Le(180)] = Field(
        default=20.0,
        description="Half the angle of the cone about it [deg]; 180 is all around.",
        examples=[60],
    )
    points: ArrayEntry | None = Field(
        default=None,
        description="Where each begins `(N, 3)` [m], in place of `count` and `place`.",
        examples=["birds.npz#points"],
    )
    velocities: ArrayEntry | None = Field(
        default=None,
        description="Of these `(N, 3)` [m/s].",
        examples=["birds.npz#velocities"],
    )
    seed: Whole = Field(
        default=0, description="Of what is random about them.", examples=[7]
    )
    radius: Positive = Field(
        default=0.1,
        description="Their radius: how near they come to colliders [m].",
        examples=[0.2],
    )
    mass: Positive = Field(
        default=0.1, description="Their mass, for forces [kg].", examples=[0.08]
    )
    vision: VisionModel = Field(
        default=VisionModel(), description="Whom they see.", examples=[{"radius": 3}]
    )
    attraction: PullModel = Field(
        default=PullModel(weight=0.8),
        description="To the centre of those that they see; its weight is their "
        "acceleration over the way there [1/s²].",
        examples=[{"weight": 1}],
    )
    alignment: PullModel = Field(
        default=PullModel(weight=1.5),
        description="To the mean velocity of those that they see; its weight is their "
        "acceleration over the lack of it [1/s].",
        examples=[{"weight": 2}],
    )
    repulsion: RepulsionModel = Field(
        default=RepulsionModel(weight=0.15),
        description="From each that they see; its weight is their acceleration times "
        "the distance [m²/s²].",
        examples=[{"weight": 0.5, "radius": 1}],
    )
    joins: list[Name] = Field(
        default=[],
        description="Other species that they heed as their own.",
        examples=[["jackdaw"]],
    )
    flees: list[OtherModel] = Field(
        default=[],
        description="Species that they flee: repulsion from each.",
        examples=[[{"species": "hawk", "weight": 40, "radius": 6}]],
    )
    chases: list[OtherModel] = Field(
        default=[],
        description="Species whose nearest member they are drawn to.",
        examples=[[{"species": "starling", "weight": 3, "radius": 20}]],
    )
    speed: SpeedModel = Field(
        default=SpeedModel(),
        description="How fast they go.",
        examples=[{"cruise": 8, "most": 12}],
    )
    turning: Positive | None = Field(
        default=None,
        description="Most that they turn [deg/s]. Not given: any.",
        examples=[180],
    )
    acceleration: Positive | None = Field(
        default=None, description="Most acceleration [m/s²].", examples=[30]
    )
    avoidance: AvoidanceModel = Field(
        default=AvoidanceModel(),
        description="How they keep clear of colliders and walls.",
        examples=[{"distance": 3}],
    )
    goals: list[FlockGoalModel] = Field(
        default=[],
        description="Where they are drawn to.",
        examples=[[{"at": [0, 6, 0], "weight": 0.1}]],
    )
    paths: list[PathModel] = Field(
        default=[],
        description="Ways that they follow.",
        examples=[[{"points": [[0, 5, 0], [20, 5, 0]]}]],
    )
    shows: PrototypeModel | None = Field(
        default=None,
        description="A mesh that each is a copy of, headed along its way. Not given: "
        "a point.",
        examples=[{"file": "bird.usda", "prim": "/bird/body"}],
    )
    beat: NotNegative = Field(
        default=0.0,
        description="Cycles of what is shown a second, at the cruise; they go with "
        "the speed.",
        examples=[4],
    )
    banking: NotNegative = Field(
        default=1.0,
        description="How far they lean into turns: 1 is as wings must.",
        examples=[0.5],
    )


class DomainModel(FileModel):
    """A box that members stay in."""

    at: Vector = Field(
        default=[0.0, 0.0, 0.0], description="Its middle [m].", examples=[[0, 5, 0]]
    )
    size: Annotated[list[Positive], Len(3, 3)] = Field(
        description="Its sides [m].", examples=[[40, 10, 40]]
    )
    wrap: bool = Field(
        default=False,
        description="Who leaves it comes in again at the other side. Not given: it "
        "has walls.",
        examples=[True],
    )


class FlocksModel(SystemSpec):
    """Flocks: members see each other, and attract, align and repel."""

    methods: ClassVar[Sequence[str]] = ("symplectic_euler", "midpoint", "heun", "rk4")

    species: Annotated[list[SpeciesModel], Len(1, 100)] = Field(
        description="Who flies.", examples=[[{"name": "starling", "count": 200}]]
    )
    forces: list[ForceEntry] = Field(
        default=[],
        description="The forces on particles, on members too.",
        examples=[[{"wind": {"velocity": [2, 0, 0], "drag": 0.05}}]],
    )
    colliders: list[SystemColliderModel] = Field(
        default=[],
        description="What they avoid, and never enter.",
        examples=[[{"shape": {"capsule": {"radius": 1, "length": 8}}}]],
    )
    characters: list[CharacterModel] = Field(
        default=[],
        description="Characters in motion that they avoid; none is written.",
        examples=[[{"file": "walk.clip.yaml"}]],
    )
    systems: list[SystemSurfaceModel] = Field(
        default=[],
        description="Cloth and volumes of the scene that they do not enter.",
        examples=[[{"system": "flag"}]],
    )
    meshes: list[MovingMeshModel] = Field(
        default=[],
        description="Meshes of USD files that they do not enter.",
        examples=[[{"file": "set.usda", "prim": "/Set/rock"}]],
    )
    domain: DomainModel | None = Field(
        default=None,
        description="A box that they stay in.",
        examples=[{"size": [40, 10, 40]}],
    )
    method: str = Field(
        default="midpoint", description="An integrator.", examples=["rk4"]
    )
    tolerance: Real | None = Field(
        default=None,
        description="Of integrators that choose their steps: most error of each.",
        examples=[1e-4],
    )
