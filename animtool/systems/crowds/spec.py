"""Schema of the crowd entries in scene files."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import Integer, Name, NonNegative, Positive, Real, Vector
from animtool.systems.framework.fields import (
    Characters,
    Colliders,
    EmitterShapeEntry,
    GaitsModel,
    PlacedModel,
    PrototypeModel,
    Seed,
    ShapeEntry,
    Shows,
    StartPoints,
    SystemSurfaceModel,
)
from animtool.systems.framework.spec import SystemSpec


class GroundModel(PlacedModel):
    """Ground that agents walk on, with y up; it does not move."""

    shape: ShapeEntry | None = key(
        "A `mesh` or a `height_field`: agents walk on its highest faces. Default: a "
        "plane.",
        {"mesh": {"points": "square.npz", "triangles": "square.npz"}},
        default=None,
    )
    mesh: PrototypeModel | None = key(
        "A mesh of a file, instead of a shape.",
        {"file": "set.usda", "prim": "/Set/ground"},
        default=None,
    )
    slope: Annotated[Real, Gt(0), Le(80)] = key(
        "Steepest slope that agents walk on [deg].", 30, default=40.0
    )


class QueueModel(FileModel):
    """A queue of waiting agents."""

    direction: Vector = key(
        "Direction from the goal to the end of the queue.", [0, 0, -1]
    )
    spacing: Positive = key("Spacing of the queue [m].", 0.9, default=0.8)


class CrowdGoalModel(FileModel):
    """A goal of agents on the ground."""

    name: Name = key("Name, for routes.", "fountain")
    at: Vector = key("Position [m].", [12, 0, 3])
    radius: Positive = key(
        "Agents within this distance have arrived [m].", 2, default=1.0
    )
    wait: NonNegative = key("Time that agents stay [s].", 5, default=0.0)
    queue: QueueModel | None = key(
        "Agents queue, and one at a time is served for `wait`. Default: all are "
        "served at once.",
        {"direction": [0, 0, -1]},
        default=None,
    )


class DoorModel(FileModel):
    """An opening that is closed at times."""

    name: Name = key("For messages.", "gate", default="door")
    begin: Vector = key("One end [m].", [-1, 0, 4])
    end: Vector = key("The other end [m].", [1, 0, 4])
    opens: list[Annotated[list[Real], Len(2, 2)]] = key(
        "Start and end of each time it is open [s].", [[2, 8]]
    )


class WalkingSpeedModel(FileModel):
    """Preferred walking speed of agents, normally distributed."""

    mean: Positive = key("Mean [m/s].", 1.2, default=1.34)
    spread: NonNegative = key(
        "Standard deviation [m/s]; limited to two deviations and at least a third of "
        "the mean.",
        0.1,
        default=0.2,
    )
    most: Positive | None = key(
        "Upper limit, even to avoid others [m/s]. Default: 1.3 times the mean, and "
        "at least the fastest preferred speed.",
        2,
        default=None,
    )


class PopulationModel(PlacedModel):
    """Agents that start in the same region and have the same route."""

    name: Name = key("Its name.", "commuters")
    count: Annotated[Integer, Ge(0), Le(10**6)] = key("How many.", 200, default=50)
    place: EmitterShapeEntry = key(
        "Start region, seen from above: `point`, `disc`, `sphere`, `box`, `mesh`.",
        {"box": {"size": [6, 0, 2]}},
        default={"disc": {"radius": 5.0}},
    )
    points: StartPoints = None
    seed: Seed = 0
    route: list[Name] = key(
        "Goals to visit in order. None: agents stand.", ["fountain", "gate"], default=[]
    )
    then: Literal["stay", "repeat", "leave"] = key(
        "At the end of the route: stay, repeat it or leave.", "repeat", default="stay"
    )
    delay: NonNegative = key(
        "Each agent starts at a random time before this [s].", 3, default=0.0
    )
    group: Annotated[Integer, Ge(1), Le(8)] = key(
        "Number of agents that walk side by side in a group.", 2, default=1
    )
    speed: WalkingSpeedModel = key(
        "Walking speed.", {"mean": 1.2}, default=WalkingSpeedModel()
    )
    radius: Positive = key("Radius of the shoulders [m].", 0.25, default=0.22)
    height: Positive = key(
        "Height [m]; obstacles above it are ignored.", 1.7, default=1.75
    )
    acceleration: Positive = key(
        "Relaxation time to the preferred velocity [s].", 0.5, default=0.4
    )
    gaits: GaitsModel | None = key(
        "A rig that walks. Default: a mesh or a point.",
        {"rig": "biped.rig.yaml", "clips": ["idle.bvh", "walk.bvh", "run.bvh"]},
        default=None,
    )
    size: Annotated[Real, Ge(0), Le(1)] = key(
        "Random variation of body size, as a fraction of the rig's.", 0.05, default=0.0
    )
    shows: Shows = None


class AgentAvoidanceModel(FileModel):
    """Rules by which agents avoid each other."""

    sight: Positive = key("Range of sight [m].", 5, default=3.0)
    nearest: Annotated[Integer, Ge(1), Le(100)] = key(
        "Number of nearest visible agents to avoid.", 16, default=10
    )
    horizon: Positive = key(
        "Time horizon for avoiding other agents [s].", 3, default=2.0
    )
    obstacles: Positive = key(
        "Time horizon for avoiding obstacles [s].", 1, default=0.5
    )
    space: NonNegative = key(
        "Preferred distance to others outside the group [m].", 0.4, default=0.2
    )
    push: NonNegative = key(
        "Speed of moving away from agents that are too close [m/s].", 0.4, default=0.3
    )
    side: Literal["right", "left", "none"] = key(
        "Side to walk on when others approach.", "left", default="right"
    )
    headway: NonNegative = key(
        "Behind agents with the same direction, speed is at most the gap over this "
        "time [s].",
        1,
        default=0.5,
    )


class ImpactModel(FileModel):
    """Reactions of agents to impacts, by impact speed [m/s]."""

    stagger: Positive = key(
        "Impact speed above which they react, if a clip does [m/s].", 0.6, default=1.0
    )
    fall: Positive = key(
        "Impact speed above which they fall as ragdolls, with their rig's colliders "
        "and limits [m/s].",
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
        "Where agents go.", [{"name": "gate", "at": [10, 0, 0]}], default=[]
    )
    doors: list[DoorModel] = key(
        "Openings that can be closed.",
        [{"begin": [-1, 0, 4], "end": [1, 0, 4], "opens": [[2, 8]]}],
        default=[],
    )
    ground: GroundModel = key("The ground.", {"at": [0, 0.1, 0]}, default=GroundModel())
    avoidance: AgentAvoidanceModel = key(
        "How agents avoid each other.", {"horizon": 3}, default=AgentAvoidanceModel()
    )
    impact: ImpactModel = key(
        "How agents react when something hits them.", {"fall": 3}, default=ImpactModel()
    )
    cell: Positive | None = key(
        "Cell size of the grid for routes around obstacles [m]. Default: the largest "
        "radius.",
        0.2,
        default=None,
    )
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: list[SystemSurfaceModel] = key(
        "Rigid bodies of the scene to avoid.", [{"system": "rocks"}], default=[]
    )

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of populations and goals, for reports."""
        return {"populations": len(self.populations), "goals": len(self.goals)}
