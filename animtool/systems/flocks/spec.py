"""Scene keys of flocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le, Len

from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import Integer, Name, NonNegative, Positive, Real, Vector
from animtool.systems.framework.fields import (
    EmitterShapeEntry,
    Integrator,
    PlacedModel,
    Seed,
    Shows,
    StartPoints,
    Tolerance,
    Velocities,
)
from animtool.systems.framework.spec import ForcedSpec


class VisionModel(FileModel):
    """Perception of members."""

    radius: Positive = key("Range of sight [m].", 3, default=2.0)
    angle: Annotated[Real, Gt(0), Le(360)] = key(
        "Field of view about the direction of motion, from edge to edge [deg].",
        300,
        default=360.0,
    )
    nearest: Annotated[Integer, Ge(1), Le(10_000)] | None = key(
        "Number of nearest neighbours to follow. Default: all that are visible.",
        7,
        default=None,
    )


class PullModel(FileModel):
    """Strength and range of an interaction with neighbours."""

    weight: NonNegative = key("Weight; 0 switches it off.", 1.5)
    radius: Positive | None = key(
        "From neighbours within this distance [m]. Default: from all visible "
        "neighbours.",
        1.2,
        default=None,
    )


class RepulsionModel(PullModel):
    """Strength of the repulsion between members."""

    softening: NonNegative = key(
        "Distance below which the push stops growing [m].", 0.05, default=0.1
    )
    least: NonNegative | None = key(
        "Minimum distance between two members [m]; for two species, the mean of "
        "both; 0 is none. Default: twice the `radius` if that or `shows` is set and "
        "the weight is not 0, else none.",
        0.5,
        default=None,
    )


class OtherModel(FileModel):
    """Reaction to another species."""

    species: Name = key("Its name.", "hawk")
    weight: NonNegative = key("How strongly.", 40)
    radius: Positive = key("Capture distance [m].", 6)


class SpeedModel(FileModel):
    """Speeds of members."""

    cruise: Positive = key("Preferred speed [m/s].", 8, default=3.0)
    weight: NonNegative = key(
        "Weight: acceleration over the deficit of squared speed and the velocity "
        "[s/m²].",
        0.05,
        default=0.2,
    )
    least: NonNegative = key("Minimum speed [m/s].", 4, default=0.0)
    most: Positive | None = key(
        "Maximum speed [m/s]. Default: twice the cruise.", 12, default=None
    )


class FlockGoalModel(PlacedModel):
    """A goal that attracts members; it may move or follow a prim."""

    weight: Real = key(
        "Weight: acceleration over the distance to it [1/s²]; below 0 it repels.", 0.1
    )
    radius: NonNegative = key("No pull within this distance [m].", 4, default=0.0)
    limit: Positive | None = key("Maximum acceleration [m/s²].", 5, default=None)


class PathModel(FileModel):
    """A path through points that members follow."""

    points: Annotated[list[Vector], Len(2, 10_000)] = key(
        "Its points [m].", [[0, 5, 0], [20, 5, 0]]
    )
    closed: bool = key("Whether it is closed.", True, default=False)
    weight: NonNegative = key(
        "Weight: acceleration over the distance to the target on the path [1/s²].",
        1,
        default=0.5,
    )
    ahead: Positive = key(
        "How far ahead of the nearest point the target is [m].", 4, default=2.0
    )
    radius: NonNegative = key("No pull within this distance [m].", 2, default=0.0)


class AvoidanceModel(FileModel):
    """How members avoid colliders."""

    distance: Positive = key("Distance at which it starts [m].", 3, default=1.5)
    weight: NonNegative = key(
        "Acceleration away from a surface on contact [m/s²]; braking before contact "
        "is added.",
        30,
        default=10.0,
    )


class SpeciesModel(PlacedModel):
    """Members of one species: their start and behaviour."""

    name: Name = key("Its name.", "starling")
    count: Annotated[Integer, Ge(0), Le(2 * 10**6)] = key("How many.", 500, default=100)
    place: EmitterShapeEntry = key(
        "Start region: `point`, `disc`, `sphere`, `box` or `mesh`.",
        {"box": {"size": [6, 2, 6]}},
        default={"sphere": {"radius": 2.0}},
    )
    direction: Vector | None = key(
        "Mean direction. Default: z.", [1, 0, 0], default=None
    )
    spread: Annotated[Real, Ge(0), Le(180)] = key(
        "Half angle of the cone about it [deg]; 180 is every direction.",
        60,
        default=20.0,
    )
    points: StartPoints = None
    velocities: Velocities = None
    seed: Seed = 0
    radius: Positive = key("Radius for collisions [m].", 0.2, default=0.1)
    mass: Positive = key("Mass, for forces [kg].", 0.08, default=0.1)
    vision: VisionModel = key("Perception.", {"radius": 3}, default=VisionModel())
    attraction: PullModel = key(
        "Towards the centre of visible neighbours; the weight is acceleration over "
        "distance [1/s²].",
        {"weight": 1},
        default=PullModel(weight=0.8),
    )
    alignment: PullModel = key(
        "Towards the mean velocity of visible neighbours; the weight is acceleration "
        "over the velocity difference [1/s].",
        {"weight": 2},
        default=PullModel(weight=1.5),
    )
    repulsion: RepulsionModel = key(
        "Away from each visible neighbour; the weight is acceleration times distance "
        "[m²/s²].",
        {"weight": 0.5, "radius": 1},
        default=RepulsionModel(weight=0.15),
    )
    joins: list[Name] = key(
        "Other species to treat as its own.", ["jackdaw"], default=[]
    )
    flees: list[OtherModel] = key(
        "Species to flee from: repulsion from each; the weight is acceleration times "
        "distance [m²/s²].",
        [{"species": "hawk", "weight": 40, "radius": 6}],
        default=[],
    )
    chases: list[OtherModel] = key(
        "Species to chase: attraction to the nearest member; the weight is "
        "acceleration over distance [1/s²].",
        [{"species": "starling", "weight": 3, "radius": 20}],
        default=[],
    )
    speed: SpeedModel = key("Speed.", {"cruise": 8, "most": 12}, default=SpeedModel())
    turning: Positive | None = key(
        "Maximum turn rate [deg/s]. Default: no limit.", 180, default=None
    )
    acceleration: Positive | None = key(
        "Maximum acceleration [m/s²].", 30, default=None
    )
    avoidance: AvoidanceModel = key(
        "Avoidance of colliders and walls.", {"distance": 3}, default=AvoidanceModel()
    )
    goals: list[FlockGoalModel] = key(
        "Points of attraction.", [{"at": [0, 6, 0], "weight": 0.1}], default=[]
    )
    paths: list[PathModel] = key(
        "Paths to follow.", [{"points": [[0, 5, 0], [20, 5, 0]]}], default=[]
    )
    shows: Shows = None
    beat: NonNegative = key(
        "Animation cycles per second at the cruise speed; proportional to speed.",
        4,
        default=0.0,
    )
    banking: NonNegative = key(
        "Banking in turns: 1 is the angle of coordinated flight.", 0.5, default=1.0
    )


class DomainModel(FileModel):
    """A box that bounds the flock."""

    at: Vector = key("Centre [m].", [0, 5, 0], default=[0.0, 0.0, 0.0])
    size: Annotated[list[Positive], Len(3, 3)] = key("Side lengths [m].", [40, 10, 40])
    wrap: bool = key(
        "Periodic: members that leave enter on the other side. Default: it has walls.",
        True,
        default=False,
    )


class FlocksModel(ForcedSpec):
    """Flocks: members see each other, and attract, align and repel."""

    methods: ClassVar[Sequence[str]] = ("symplectic_euler", "midpoint", "heun", "rk4")
    code: ClassVar[str] = "SIM060"

    species: Annotated[list[SpeciesModel], Len(1, 100)] = key(
        "Who flies.", [{"name": "starling", "count": 200}]
    )
    domain: DomainModel | None = key(
        "Bounding box of the flock.", {"size": [40, 10, 40]}, default=None
    )
    method: Integrator = "midpoint"
    tolerance: Tolerance = None
