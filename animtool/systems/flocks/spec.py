"""The keys of a flock in a scene file, as models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Name,
    NotNegative,
    Positive,
    Real,
    Vector,
    Whole,
    key,
)
from animtool.systems.framework.fields import (
    Characters,
    Colliders,
    Forces,
    Integrator,
    Meshes,
    PlacedModel,
    PlaceEntry,
    Seed,
    Shows,
    StartPoints,
    Surfaces,
    Tolerance,
    Velocities,
)
from animtool.systems.framework.spec import SystemSpec


class VisionModel(FileModel):
    """Whom a member sees."""

    radius: Positive = key("How far it sees [m].", 3, default=2.0)
    angle: Annotated[Real, Gt(0), Le(360)] = key(
        "Angle about its way that it sees, from edge to edge [deg].", 300, default=360.0
    )
    nearest: Annotated[Whole, Ge(1), Le(10_000)] | None = key(
        "It heeds so many, the nearest. Not given: all that it sees.", 7, default=None
    )


class PullModel(FileModel):
    """How strongly a member does something, and by those how near."""

    weight: NotNegative = key("How strongly; 0 is not.", 1.5)
    radius: Positive | None = key(
        "By those within this distance [m]. Not given: by all that it sees.",
        1.2,
        default=None,
    )


class RepulsionModel(PullModel):
    """How strongly a member keeps away from each other one."""

    softening: NotNegative = key(
        "Below this distance the push grows no more [m].", 0.05, default=0.1
    )
    least: NotNegative | None = key(
        "No two are nearer to each other [m]; of two species, the mean of both; 0 is "
        "any distance. Not given: twice the `radius` where that or `shows` is given "
        "and the weight is not 0, else any.",
        0.5,
        default=None,
    )


class OtherModel(FileModel):
    """Another species, and how members heed it."""

    species: Name = key("Its name.", "hawk")
    weight: NotNegative = key("How strongly.", 40)
    radius: Positive = key("How near it must be [m].", 6)


class SpeedModel(FileModel):
    """How fast members go."""

    cruise: Positive = key("Speed that they tend to [m/s].", 8, default=3.0)
    weight: NotNegative = key(
        "How strongly: they gain this times the lack of its square and "
        "their velocity [s/m²].",
        0.05,
        default=0.2,
    )
    least: NotNegative = key("None is slower [m/s].", 4, default=0.0)
    most: Positive | None = key(
        "None is faster [m/s]. Not given: twice the cruise.", 12, default=None
    )


class FlockGoalModel(PlacedModel):
    """Where members are drawn to; it may move, or go with a prim."""

    weight: Real = key(
        "How strongly: their acceleration over the way to it [1/s²]; "
        "below 0 it drives them away.",
        0.1,
    )
    radius: NotNegative = key("It pulls nobody within [m].", 4, default=0.0)
    limit: Positive | None = key("Most acceleration [m/s²].", 5, default=None)


class PathModel(FileModel):
    """A way that members follow, from point to point."""

    points: Annotated[list[Vector], Len(2, 10_000)] = key(
        "Its points [m].", [[0, 5, 0], [20, 5, 0]]
    )
    closed: bool = key("It goes on from its end.", True, default=False)
    weight: NotNegative = key(
        "How strongly: their acceleration over the way to where they should be [1/s²].",
        1,
        default=0.5,
    )
    ahead: Positive = key(
        "How far along it they look from where they are nearest [m].", 4, default=2.0
    )
    radius: NotNegative = key("It pulls nobody within [m].", 2, default=0.0)


class AvoidanceModel(FileModel):
    """How members keep clear of what they could run into."""

    distance: Positive = key("From how far on [m].", 3, default=1.5)
    weight: NotNegative = key(
        "Acceleration away from a surface that is touched [m/s²]; what "
        "brakes them before it comes on top.",
        30,
        default=10.0,
    )


class SpeciesModel(PlacedModel):
    """Members of one kind: where they begin, and what they do."""

    name: Name = key("Its name.", "starling")
    count: Annotated[Whole, Ge(0), Le(2 * 10**6)] = key("How many.", 500, default=100)
    place: PlaceEntry = key(
        "Where they begin: `point`, `disc`, `sphere`, `box` or `mesh`.",
        {"box": {"size": [6, 2, 6]}},
        default={"sphere": {"radius": 2.0}},
    )
    direction: Vector | None = key(
        "Middle of their directions. Not given: z.", [1, 0, 0], default=None
    )
    spread: Annotated[Real, Ge(0), Le(180)] = key(
        "Half the angle of the cone about it [deg]; 180 is all around.",
        60,
        default=20.0,
    )
    points: StartPoints = None
    velocities: Velocities = None
    seed: Seed = 0
    radius: Positive = key(
        "Their radius: how near they come to colliders [m].", 0.2, default=0.1
    )
    mass: Positive = key("Their mass, for forces [kg].", 0.08, default=0.1)
    vision: VisionModel = key("Whom they see.", {"radius": 3}, default=VisionModel())
    attraction: PullModel = key(
        "To the centre of those that they see; its weight is their "
        "acceleration over the way there [1/s²].",
        {"weight": 1},
        default=PullModel(weight=0.8),
    )
    alignment: PullModel = key(
        "To the mean velocity of those that they see; its weight is their "
        "acceleration over the lack of it [1/s].",
        {"weight": 2},
        default=PullModel(weight=1.5),
    )
    repulsion: RepulsionModel = key(
        "From each that they see; its weight is their acceleration times "
        "the distance [m²/s²].",
        {"weight": 0.5, "radius": 1},
        default=RepulsionModel(weight=0.15),
    )
    joins: list[Name] = key(
        "Other species that they heed as their own.", ["jackdaw"], default=[]
    )
    flees: list[OtherModel] = key(
        "Species that they flee: repulsion from each; its weight is their acceleration "
        "times the distance [m²/s²].",
        [{"species": "hawk", "weight": 40, "radius": 6}],
        default=[],
    )
    chases: list[OtherModel] = key(
        "Species whose nearest member they are drawn to; its weight is their "
        "acceleration over the way there [1/s²].",
        [{"species": "starling", "weight": 3, "radius": 20}],
        default=[],
    )
    speed: SpeedModel = key(
        "How fast they go.", {"cruise": 8, "most": 12}, default=SpeedModel()
    )
    turning: Positive | None = key(
        "Most that they turn [deg/s]. Not given: any.", 180, default=None
    )
    acceleration: Positive | None = key("Most acceleration [m/s²].", 30, default=None)
    avoidance: AvoidanceModel = key(
        "How they keep clear of colliders and walls.",
        {"distance": 3},
        default=AvoidanceModel(),
    )
    goals: list[FlockGoalModel] = key(
        "Where they are drawn to.", [{"at": [0, 6, 0], "weight": 0.1}], default=[]
    )
    paths: list[PathModel] = key(
        "Ways that they follow.", [{"points": [[0, 5, 0], [20, 5, 0]]}], default=[]
    )
    shows: Shows = None
    beat: NotNegative = key(
        "Cycles of what is shown a second, at the cruise; they go with the speed.",
        4,
        default=0.0,
    )
    banking: NotNegative = key(
        "How far they lean into turns: 1 is as wings must.", 0.5, default=1.0
    )


class DomainModel(FileModel):
    """A box that members stay in."""

    at: Vector = key("Its middle [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    size: Annotated[list[Positive], Len(3, 3)] = key("Its sides [m].", [40, 10, 40])
    wrap: bool = key(
        "Who leaves it comes in again at the other side. Not given: it has walls.",
        True,
        default=False,
    )


class FlocksModel(SystemSpec):
    """Flocks: members see each other, and attract, align and repel."""

    methods: ClassVar[Sequence[str]] = ("symplectic_euler", "midpoint", "heun", "rk4")
    code: ClassVar[str] = "SIM060"

    species: Annotated[list[SpeciesModel], Len(1, 100)] = key(
        "Who flies.", [{"name": "starling", "count": 200}]
    )
    forces: Forces = Field([])
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])
    domain: DomainModel | None = key(
        "A box that they stay in.", {"size": [40, 10, 40]}, default=None
    )
    method: Integrator = "midpoint"
    tolerance: Tolerance = None
