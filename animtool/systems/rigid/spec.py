"""Keys of rigid bodies in scene files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal, TypeAlias, get_args

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.core.errors import Problem
from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Integer,
    Name,
    NonNegative,
    Positive,
    Quaternion,
    Real,
    Vector,
)
from animtool.systems.framework.fields import (
    ArrayEntry,
    Forces,
    PhysicsStageModel,
    PlacedModel,
    PrototypeModel,
    ShapeEntry,
)
from animtool.systems.framework.spec import ForcedSpec

RotationMethod: TypeAlias = Literal[
    "splitting", "rk4", "symplectic_euler", "explicit_euler"
]
Angles = Annotated[list[Annotated[Real, Ge(-180), Le(180)]], Len(2, 2)]


class BodyShapeModel(FileModel):
    """A shape of a body that has several."""

    shape: ShapeEntry = key(
        "`sphere`, `capsule`, `box`, or `mesh`, as convex pieces or its hull.",
        {"box": {"size": [0.4, 0.05, 0.05]}},
    )
    at: Vector = key(
        "Position of its origin in the body [m].", [0.2, 0, 0], default=[0.0, 0.0, 0.0]
    )
    rotate: Quaternion = key(
        "Orientation in the body: a quaternion w, x, y, z.",
        [0.7071, 0, 0, 0.7071],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    density: Positive | None = key(
        "Density [kg/m³]. Default: that of the body.", 7800, default=None
    )


class PushModel(FileModel):
    """A force at a point of a body, or a torque, for a time."""

    force: Vector = key("Force [N].", [0, 0, 40], default=[0.0, 0.0, 0.0])
    at: Vector = key(
        "Point of application, in the body's frame [m].",
        [0, 0.4, 0],
        default=[0.0, 0.0, 0.0],
    )
    torque: Vector = key("Torque [N m].", [0, 2, 0], default=[0.0, 0.0, 0.0])
    local: bool = key(
        "Force and torque rotate with the body, as those of a motor do.",
        True,
        default=False,
    )
    start: Real | None = key(
        "Time at which it starts [s]. Default: the first frame.", 0.5, default=None
    )
    end: Real | None = key(
        "Time at which it ends [s]. Default: never.", 0.6, default=None
    )


class GridModel(FileModel):
    """Copies of a body in rows: a wall, a row of dominoes, a stack."""

    count: Annotated[list[Annotated[Integer, Ge(1)]], Len(3, 3)] = key(
        "Number along x, y and z of the body's frame.", [10, 8, 1]
    )
    spacing: Vector = key("Spacing [m].", [0.42, 0.2, 0])
    stagger: Real = key(
        "Fraction of the spacing along x by which every other row is shifted.",
        0.5,
        default=0.0,
    )


class BodyModel(PlacedModel):
    """A body, or copies of one."""

    name: Name = key("Name; copies are `name[0]`, `name[1]` and so on.", "brick")
    shape: ShapeEntry | None = key(
        "`sphere`, `capsule`, `box`, or `mesh`, as convex pieces or its hull.",
        {"box": {"size": [0.4, 0.2, 0.2]}},
        default=None,
    )
    shapes: list[BodyShapeModel] = key(
        "Instead of `shape`: several shapes, as one body.",
        [{"shape": {"sphere": {"radius": 0.1}}, "at": [0, 0.3, 0]}],
        default=[],
    )
    density: Positive = key("Density [kg/m³].", 500, default=1000.0)
    mass: Positive | None = key("Mass [kg], instead of density.", 12, default=None)
    inertia: Annotated[list[NonNegative], Len(3, 3)] | None = key(
        "Principal moments of inertia about x, y and z of its frame, through its "
        "centre of mass [kg m²]. Default: those of its shapes.",
        [1, 2, 3],
        default=None,
    )
    inertia_axes: Quaternion = key(
        "Orientation of the axes of `inertia` in its frame: a quaternion w, x, y, z.",
        [0.9239, 0, 0.3827, 0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    centre: Vector | None = key(
        "Centre of mass, in its frame [m]. Default: that of its shapes.",
        [0, -0.05, 0],
        default=None,
    )
    velocity: Vector = key(
        "Initial velocity of its centre of mass [m/s].",
        [0, 0, 8],
        default=[0.0, 0.0, 0.0],
    )
    spin: Vector = key(
        "Initial angular velocity, about the world axes [deg/s].",
        [0, 360, 0],
        default=[0.0, 0.0, 0.0],
    )
    restitution: Annotated[Real, Ge(0), Le(1)] = key(
        "Restitution: fraction of the normal speed that is returned; in a contact "
        "the larger of both applies.",
        0.3,
        default=0.0,
    )
    friction: NonNegative = key(
        "Coulomb friction coefficient; in a contact the larger of both applies.",
        0.6,
        default=0.5,
    )
    kinematic: bool = key(
        "Kinematic: it follows `moves`, `turns` or `prim`, and pushes other bodies; "
        "nothing pushes it.",
        True,
        default=False,
    )
    release: Real | None = key(
        "For a kinematic body: time at which it is released [s], with its velocity "
        "at that moment. Default: never.",
        1.5,
        default=None,
    )
    grid: GridModel | None = key(
        "Copies in a grid.",
        {"count": [10, 8, 1], "spacing": [0.42, 0.2, 0]},
        default=None,
    )
    points: ArrayEntry | None = key(
        "Positions of copies `(N, 3)`, in the frame of `at` and `rotate` [m].",
        "rubble.npz#points",
        default=None,
    )
    rotations: ArrayEntry | None = key(
        "Orientations of these: quaternions w, x, y, z `(N, 4)`.",
        "rubble.npz#rotations",
        default=None,
    )
    pushes: list[PushModel] = key(
        "Forces and torques on it, with points of application.",
        [{"force": [0, 0, 40], "at": [0, 0.4, 0], "end": 0.1}],
        default=[],
    )
    shows: PrototypeModel | None = key(
        "The mesh to show, in its frame. Default: its shapes.",
        {"file": "crate.usda", "prim": "/crate/body"},
        default=None,
    )


class JointDriveModel(FileModel):
    """A spring or a motor of a joint."""

    target: Real = key(
        "Target angle of a pin [deg], or position of a prismatic joint [m].",
        30,
        default=0.0,
    )
    rotation: Quaternion = key(
        "For a ball joint: target orientation of the second body relative to the "
        "first, in the frame of the joint: a quaternion w, x, y, z.",
        [0.966, 0, 0.259, 0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    stiffness: NonNegative = key("[N m/rad], or [N/m].", 200, default=0.0)
    damping: NonNegative = key("[N m s/rad], or [N s/m].", 10, default=0.0)
    speed: Real | None = key(
        "Instead of `stiffness`: the constant speed of a motor, for a pin [deg/s], "
        "or for a prismatic joint [m/s]. Rigid up to `most`, or with a force of "
        "`damping` times the speed error.",
        90,
        default=None,
    )
    most: NonNegative | None = key(
        "Largest torque [N m] or force [N]. Default: no limit.", 50, default=None
    )


class JointBreakModel(FileModel):
    """Load above which a joint breaks; drive forces are not counted."""

    force: Positive | None = key(
        "Largest force that holds its two sides together [N]. Default: no limit.",
        500,
        default=None,
    )
    torque: Positive | None = key(
        "Largest torque likewise [N m]. Default: no limit.", 40, default=None
    )


class RigidJointModel(PlacedModel):
    """A joint between two bodies, or between a body and the world.

    `at` and `rotate` place its frame; for a joint with the world, `moves`, `turns` and
    `prim` do too.
    """

    name: str = key("For messages.", "hinge", default="")
    type: Literal["pin", "ball", "prismatic", "fixed"] = key("Joint type.", "pin")
    body: Name = key("The second body.", "door")
    to: Name | None = key("The first body. Default: the world.", "frame", default=None)
    axis: Vector = key(
        "Axis of a pin, direction of a prismatic joint, or twist axis of a ball; in "
        "its frame.",
        [0, 1, 0],
        default=[1.0, 0.0, 0.0],
    )
    limits: Annotated[list[Real], Len(2, 2)] | None = key(
        "Range of a pin [deg], or of a prismatic joint [m], relative to the start.",
        [0, 110],
        default=None,
    )
    swing: Annotated[Real, Gt(0), Le(180)] | Angles | None = key(
        "For a ball joint: half angle of its cone [deg], or two of an ellipse.",
        40,
        default=None,
    )
    twist: Angles | None = key(
        "For a ball joint: range of the twist [deg].", [-30, 30], default=None
    )
    drive: JointDriveModel | None = key(
        "A spring or a motor.", {"stiffness": 200, "damping": 10}, default=None
    )
    breaks: JointBreakModel | None = key(
        "Load at which it breaks: from then on it has no effect, and its bodies "
        "collide. Default: never.",
        {"force": 500, "torque": 40},
        default=None,
    )
    contacts: bool = key(
        "Let its two bodies collide with each other, which is off by default.",
        True,
        default=False,
    )


class SleepModel(FileModel):
    """When bodies fall asleep."""

    speed: NonNegative = key(
        "Speed below which a body can sleep [m/s]; 0 is never.", 0.01, default=0.02
    )
    time: Positive = key("Time below that speed [s].", 1, default=0.5)


class RigidModel(ForcedSpec):
    """Rigid bodies of a scene, and joints; forces act at their centres of mass."""

    methods: ClassVar[Sequence[str]] = get_args(RotationMethod)
    code: ClassVar[str] = "SIM061"

    bodies: Annotated[list[BodyModel], Len(0, 100_000)] = key(
        "The bodies.",
        [{"name": "crate", "shape": {"box": {"size": [1, 1, 1]}}, "at": [0, 3, 0]}],
        default=[],
    )
    stages: list[PhysicsStageModel] = key(
        "USD stages whose rigid bodies, joints and colliders are added, as described "
        "by UsdPhysics.",
        [{"file": "yard.usda", "prim": "/Yard"}],
        default=[],
    )
    joints: list[RigidJointModel] = key(
        "Joints between bodies.",
        [{"type": "pin", "body": "door", "axis": [0, 1, 0]}],
        default=[],
    )
    forces: Forces = Field([{"gravity": None}])
    method: RotationMethod = key(
        "Integrator of free rotation: `splitting` conserves energy and momentum.",
        "rk4",
        default="splitting",
    )
    substeps: Annotated[Integer, Ge(1), Le(1000)] = key(
        "Substeps in each step; contacts are found once per step.", 16, default=8
    )
    iterations: Annotated[Integer, Ge(1), Le(10_000)] = key(
        "Largest number of velocity iterations in half a substep; with fewer than "
        "some hundred contact points up to 32 times as many.",
        32,
        default=8,
    )
    residual: Positive = key(
        "Iterations end when they change velocities by less than this [m/s, rad/s].",
        1e-5,
        default=1e-4,
    )
    prims: Literal["instancer", "xforms"] = key(
        "Prims to write: one `instancer`, or `xforms`, a prim for each body, with "
        "its name.",
        "xforms",
        default="instancer",
    )
    physics: bool = key(
        "Whether to write UsdPhysics with `prims: xforms`, for other engines.",
        True,
        default=False,
    )
    sleep: SleepModel = key(
        "When slow bodies fall asleep.", {"speed": 0}, default=SleepModel()
    )

    def problems(self) -> Iterator[Problem]:
        """Yield the problems of keys that contradict each other (SIM061)."""
        if not self.bodies and not self.stages:
            yield "there are no bodies", None, "add some, or a stage with some"
        if self.physics and self.prims != "xforms":
            message = "UsdPhysics describes prims, but copies of an instancer are not "
            message += "prims"
            yield message, "physics", "prims: xforms"
