"""The keys of a crowd in a scene file, as models."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

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
    GaitsModel,
    PlacedModel,
    PlaceEntry,
    PrototypeModel,
    Seed,
    ShapeEntry,
    Shows,
    StartPoints,
    SystemSurfaceModel,
)
from animtool.systems.framework.spec import SystemSpec


class GroundModel(PlacedModel):
    """What agents walk on. Its y is up for them; it does not move."""

    shape: ShapeEntry | None = key(
        "A `mesh` or a `height_field`: agents walk on its highest faces. Not given: "
        "a plane.",
        {"mesh": {"points": "square.npz", "triangles": "square.npz"}},
        default=None,
    )
    mesh: PrototypeModel | None = key(
        "A mesh of a file, in place of a shape.",
        {"file": "set.usda", "prim": "/Set/ground"},
        default=None,
    )
    slope: Annotated[Real, Gt(0), Le(80)] = key(
        "Nobody walks where it is steeper [deg].", 30, default=40.0
    )


class QueueModel(FileModel):
    """A line of those who wait."""

    direction: Vector = key("From the goal to who comes last.", [0, 0, -1])
    spacing: Positive = key("From one to the next [m].", 0.9, default=0.8)


class CrowdGoalModel(FileModel):
    """A place on the ground that agents go to."""

    name: Name = key("Its name, for routes.", "fountain")
    at: Vector = key("Where it is [m].", [12, 0, 3])
    radius: Positive = key("Who is within is there [m].", 2, default=1.0)
    wait: NotNegative = key("How long who is there stays [s].", 5, default=0.0)
    queue: QueueModel | None = key(
        "Those who wait stand in line, and one at a time is served for `wait`. "
        "Not given: all are there at once.",
        {"direction": [0, 0, -1]},
        default=None,
    )


class DoorModel(FileModel):
    """An opening that is shut at times."""

    name: Name = key("For messages.", "gate", default="door")
    begin: Vector = key("One end of it [m].", [-1, 0, 4])
    end: Vector = key("The other end [m].", [1, 0, 4])
    opens: list[Annotated[list[Real], Len(2, 2)]] = key(
        "From when to when it is open [s].", [[2, 8]]
    )


class WalkingSpeedModel(FileModel):
    """How fast agents like to walk: normally distributed."""

    mean: Positive = key("On average [m/s].", 1.2, default=1.34)
    spread: NotNegative = key(
        "Standard deviation [m/s]; none is more than two of them off, or slower than "
        "a third of the mean.",
        0.1,
        default=0.2,
    )
    most: Positive | None = key(
        "None is faster, even to avoid others [m/s]. Not given: 1.3 times the mean, "
        "and at least as fast as the fastest likes.",
        2,
        default=None,
    )


class PopulationModel(PlacedModel):
    """Agents that begin at one place and have one route."""

    name: Name = key("Its name.", "commuters")
    count: Annotated[Whole, Ge(0), Le(10**6)] = key("How many.", 200, default=50)
    place: PlaceEntry = key(
        "Where they begin, seen from above: `point`, `disc`, `sphere`, `box`, `mesh`.",
        {"box": {"size": [6, 0, 2]}},
        default={"disc": {"radius": 5.0}},
    )
    points: StartPoints = None
    seed: Seed = 0
    route: list[Name] = key(
        "Goals that they go to, one after the other. None: they stand.",
        ["fountain", "gate"],
        default=[],
    )
    then: Literal["stay", "repeat", "leave"] = key(
        "At its end they stay there, repeat it or leave.", "repeat", default="stay"
    )
    delay: NotNegative = key(
        "Each sets out at a random time before [s].", 3, default=0.0
    )
    group: Annotated[Whole, Ge(1), Le(8)] = key(
        "So many walk together, side by side.", 2, default=1
    )
    speed: WalkingSpeedModel = key(
        "How fast they walk.", {"mean": 1.2}, default=WalkingSpeedModel()
    )
    radius: Positive = key("Of their shoulders [m].", 0.25, default=0.22)
    height: Positive = key(
        "How tall they are [m]: what is above does not concern them.", 1.7, default=1.75
    )
    acceleration: Positive = key(
        "How long they take to walk as they like [s].", 0.5, default=0.4
    )
    gaits: GaitsModel | None = key(
        "A rig that walks. Not given: a mesh or a point.",
        {"rig": "biped.rig.yaml", "clips": ["idle.bvh", "walk.bvh", "run.bvh"]},
        default=None,
    )
    size: Annotated[Real, Ge(0), Le(1)] = key(
        "By which part a body may be larger than its rig, or that smaller, at random.",
        0.05,
        default=0.0,
    )
    shows: Shows = None


class AgentAvoidanceModel(FileModel):
    """How agents keep clear of each other."""

    sight: Positive = key("How far they look [m].", 5, default=3.0)
    nearest: Annotated[Whole, Ge(1), Le(100)] = key(
        "So many of those whom they see they heed, the nearest.", 16, default=10
    )
    horizon: Positive = key("How far ahead they avoid others [s].", 3, default=2.0)
    obstacles: Positive = key("How far ahead they avoid obstacles [s].", 1, default=0.5)
    space: NotNegative = key(
        "Room that they like about them [m]; not from their own group.",
        0.4,
        default=0.2,
    )
    push: NotNegative = key(
        "How fast they leave who is close to them [m/s].", 0.4, default=0.3
    )
    side: Literal["right", "left", "none"] = key(
        "On which side they walk where others come against them.",
        "left",
        default="right",
    )
    headway: NotNegative = key(
        "Behind who goes the same way they walk no faster than the gap over this "
        "time [s].",
        1,
        default=0.5,
    )


class ImpactModel(FileModel):
    """What becomes of agents that something hits: how fast it comes [m/s]."""

    stagger: Positive = key(
        "From this on they react, if a clip does [m/s].", 0.6, default=1.0
    )
    fall: Positive = key(
        "From this on their bodies fall, as their rig's colliders and limits have it "
        "[m/s].",
        3,
        default=2.5,
    )


class CrowdsModel(SystemSpec):
    """Crowds: agents walk to goals, around obstacles and each other.

    Routes lead around colliders that do not move.
    """

    code: ClassVar[str] = "SIM145"

    populations: Annotated[list[PopulationModel], Len(1, 100)] = key(
        "Who walks.", [{"name": "commuters", "route": ["gate"]}]
    )
    goals: list[CrowdGoalModel] = key(
        "Where they go.", [{"name": "gate", "at": [10, 0, 0]}], default=[]
    )
    doors: list[DoorModel] = key(
        "Openings that are shut at times.",
        [{"begin": [-1, 0, 4], "end": [1, 0, 4], "opens": [[2, 8]]}],
        default=[],
    )
    ground: GroundModel = key(
        "What they walk on.", {"at": [0, 0.1, 0]}, default=GroundModel()
    )
    avoidance: AgentAvoidanceModel = key(
        "How they keep clear of each other.",
        {"horizon": 3},
        default=AgentAvoidanceModel(),
    )
    impact: ImpactModel = key(
        "What becomes of those whom something hits.", {"fall": 3}, default=ImpactModel()
    )
    cell: Positive | None = key(
        "Grid in which routes around obstacles are found [m]. Not given: the largest "
        "radius.",
        0.2,
        default=None,
    )
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: list[SystemSurfaceModel] = key(
        "Rigid bodies of the scene that they avoid.",
        [{"system": "rocks"}],
        default=[],
    )

    @property
    def counts(self) -> dict[str, int]:
        """What it is made of, by kind."""
        return {"populations": len(self.populations), "goals": len(self.goals)}
