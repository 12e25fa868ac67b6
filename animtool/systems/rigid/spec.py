"""The keys of rigid bodies in a scene file, as models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field

from animtool.core.errors import Problem
from animtool.documents.check import FileModel
from animtool.documents.fields import (
    Name,
    NotNegative,
    Positive,
    Quaternion,
    Real,
    Vector,
    Whole,
    key,
)
from animtool.systems.framework.fields import (
    ArrayEntry,
    Characters,
    Colliders,
    Forces,
    Meshes,
    PhysicsStageModel,
    PlacedModel,
    PrototypeModel,
    ShapeEntry,
    Surfaces,
)
from animtool.systems.framework.spec import SystemSpec

Angles = Annotated[list[Annotated[Real, Ge(-180), Le(180)]], Len(2, 2)]


class BodyShapeModel(FileModel):
    """A shape of a body that has several."""

    shape: ShapeEntry = key(
        "`sphere`, `capsule`, `box`, or `mesh`: convex pieces of it, or its hull.",
        {"box": {"size": [0.4, 0.05, 0.05]}},
    )
    at: Vector = key(
        "Where its origin is in the body [m].", [0.2, 0, 0], default=[0.0, 0.0, 0.0]
    )
    rotate: Quaternion = key(
        "How it is turned in the body: a quaternion w, x, y, z.",
        [0.7071, 0, 0, 0.7071],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    density: Positive | None = key(
        "Its density [kg/m³]. Not given: that of the body.", 7800, default=None
    )


class PushModel(FileModel):
    """A force at a point of a body, or a torque, for a time."""

    force: Vector = key("Force [N].", [0, 0, 40], default=[0.0, 0.0, 0.0])
    at: Vector = key(
        "Point of the body where it acts, in its frame [m].",
        [0, 0.4, 0],
        default=[0.0, 0.0, 0.0],
    )
    torque: Vector = key("Torque [N m].", [0, 2, 0], default=[0.0, 0.0, 0.0])
    local: bool = key(
        "Force and torque turn with the body, as those of a motor do.",
        True,
        default=False,
    )
    start: Real | None = key(
        "Second that it begins in. Not given: the first.", 0.5, default=None
    )
    end: Real | None = key(
        "Second that it ends in. Not given: never.", 0.6, default=None
    )


class GridModel(FileModel):
    """Copies of a body in rows: a wall, a row of dominoes, a stack."""

    count: Annotated[list[Annotated[Whole, Ge(1)]], Len(3, 3)] = key(
        "How many along x, y and z of the body's frame.", [10, 8, 1]
    )
    spacing: Vector = key("From one to the next [m].", [0.42, 0.2, 0])
    stagger: Real = key(
        "Share of the spacing along x that every other row is shifted by.",
        0.5,
        default=0.0,
    )


class BodyModel(PlacedModel):
    """A body, or copies of one."""

    name: Name = key("Its name; copies are `name[0]`, `name[1]` and so on.", "brick")
    shape: ShapeEntry | None = key(
        "`sphere`, `capsule`, `box`, or `mesh`: convex pieces of it, or its hull.",
        {"box": {"size": [0.4, 0.2, 0.2]}},
        default=None,
    )
    shapes: list[BodyShapeModel] = key(
        "In place of `shape`: several, as one body.",
        [{"shape": {"sphere": {"radius": 0.1}}, "at": [0, 0.3, 0]}],
        default=[],
    )
    density: Positive = key("Its density [kg/m³].", 500, default=1000.0)
    mass: Positive | None = key("Its mass [kg], in place of density.", 12, default=None)
    inertia: Annotated[list[NotNegative], Len(3, 3)] | None = key(
        "Its moments of inertia about x, y and z of its frame, through its centre of "
        "mass [kg m²]. Not given: those of its shapes.",
        [1, 2, 3],
        default=None,
    )
    inertia_axes: Quaternion = key(
        "How the axes of `inertia` are turned in its frame: a quaternion w, x, y, z.",
        [0.9239, 0, 0.3827, 0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    centre: Vector | None = key(
        "Its centre of mass, in its frame [m]. Not given: that of its shapes.",
        [0, -0.05, 0],
        default=None,
    )
    velocity: Vector = key(
        "Velocity of its centre of mass at the beginning [m/s].",
        [0, 0, 8],
        default=[0.0, 0.0, 0.0],
    )
    spin: Vector = key(
        "Angular velocity at the beginning, about the axes of the world [deg/s].",
        [0, 360, 0],
        default=[0.0, 0.0, 0.0],
    )
    restitution: Annotated[Real, Ge(0), Le(1)] = key(
        "Share of the speed into a surface that comes back; of two that touch the "
        "larger counts.",
        0.3,
        default=0.0,
    )
    friction: NotNegative = key(
        "Coulomb's coefficient; of two that touch the larger counts.", 0.6, default=0.5
    )
    kinematic: bool = key(
        "It goes as `moves`, `turns` or `prim` say, and pushes others; nothing pushes "
        "it.",
        True,
        default=False,
    )
    release: Real | None = key(
        "Of a kinematic body: the second from the first frame on that it is let go at, "
        "with the velocity that it has then. Not given: never.",
        1.5,
        default=None,
    )
    grid: GridModel | None = key(
        "Copies of it in rows.",
        {"count": [10, 8, 1], "spacing": [0.42, 0.2, 0]},
        default=None,
    )
    points: ArrayEntry | None = key(
        "Where copies of it are `(N, 3)`, in the frame of `at` and `rotate` [m].",
        "rubble.npz#points",
        default=None,
    )
    rotations: ArrayEntry | None = key(
        "How these are turned: quaternions w, x, y, z `(N, 4)`.",
        "rubble.npz#rotations",
        default=None,
    )
    pushes: list[PushModel] = key(
        "Forces and torques on it, at points of it.",
        [{"force": [0, 0, 40], "at": [0, 0.4, 0], "end": 0.1}],
        default=[],
    )
    shows: PrototypeModel | None = key(
        "The mesh that it is shown as, in its frame. Not given: its shapes.",
        {"file": "crate.usda", "prim": "/crate/body"},
        default=None,
    )


class JointDriveModel(FileModel):
    """A spring or a motor of a joint."""

    target: Real = key(
        "Angle of a pin [deg], or slide of a prismatic joint [m].", 30, default=0.0
    )
    rotation: Quaternion = key(
        "Of a ball: how the second body is turned against the first, in the frame of "
        "the joint: a quaternion w, x, y, z.",
        [0.966, 0, 0.259, 0],
        default=[1.0, 0.0, 0.0, 0.0],
    )
    stiffness: NotNegative = key("[N m/rad], or [N/m].", 200, default=0.0)
    damping: NotNegative = key("[N m s/rad], or [N s/m].", 10, default=0.0)
    speed: Real | None = key(
        "In place of `stiffness`: the constant speed of a motor, of a pin [deg/s], or "
        "of a prismatic joint [m/s]. Hard up to `most`, or pulls by `damping` times "
        "what the speed is off.",
        90,
        default=None,
    )
    most: NotNegative | None = key(
        "Its most torque [N m] or force [N]. Not given: any.", 50, default=None
    )


class JointBreakModel(FileModel):
    """What a joint breaks at; a drive's own force and torque do not count."""

    force: Positive | None = key(
        "Force that its two sides are held together with [N]. Not given: any.",
        500,
        default=None,
    )
    torque: Positive | None = key(
        "Torque likewise [N m]. Not given: any.", 40, default=None
    )


class RigidJointModel(PlacedModel):
    """A joint between two bodies, or of one with the world.

    `at`, `rotate` and, of one with the world, `moves`, `turns` and `prim` place its
    frame.
    """

    name: str = key("For messages.", "hinge", default="")
    type: Literal["pin", "ball", "prismatic", "fixed"] = key(
        "What it lets move.", "pin"
    )
    body: Name = key("The body that hangs on it.", "door")
    to: Name | None = key(
        "The body that it hangs on. Not given: the world.", "frame", default=None
    )
    axis: Vector = key(
        "Axis of a pin, direction of travel of a prismatic joint, what a ball twists "
        "about; in its frame.",
        [0, 1, 0],
        default=[1.0, 0.0, 0.0],
    )
    limits: Annotated[list[Real], Len(2, 2)] | None = key(
        "Least and most angle of a pin [deg], or slide of a prismatic joint [m], from "
        "where it begins.",
        [0, 110],
        default=None,
    )
    swing: Annotated[Real, Gt(0), Le(180)] | Angles | None = key(
        "Of a ball: half-angle of its cone [deg], or two of an ellipse.",
        40,
        default=None,
    )
    twist: Angles | None = key(
        "Of a ball: least and most twist [deg].", [-30, 30], default=None
    )
    drive: JointDriveModel | None = key(
        "A spring or a motor.", {"stiffness": 200, "damping": 10}, default=None
    )
    breaks: JointBreakModel | None = key(
        "What it breaks at: from then on it holds nothing, and its bodies collide. Not "
        "given: never.",
        {"force": 500, "torque": 40},
        default=None,
    )
    contacts: bool = key(
        "Its two bodies collide with each other, which other joints switch off.",
        True,
        default=False,
    )


class SleepModel(FileModel):
    """Who sleeps."""

    speed: NotNegative = key("Slower than this [m/s]; 0 is never.", 0.01, default=0.02)
    time: Positive = key("For so long [s].", 1, default=0.5)


class RigidModel(SystemSpec):
    """Rigid bodies of a scene, and joints; forces act at their centres of mass."""

    methods: ClassVar[Sequence[str]] = (
        "splitting",
        "rk4",
        "symplectic_euler",
        "explicit_euler",
    )
    code: ClassVar[str] = "SIM061"

    bodies: Annotated[list[BodyModel], Len(0, 100_000)] = key(
        "The bodies.",
        [{"name": "crate", "shape": {"box": {"size": [1, 1, 1]}}, "at": [0, 3, 0]}],
        default=[],
    )
    stages: list[PhysicsStageModel] = key(
        "USD stages whose rigid bodies, joints and colliders are among them, as "
        "UsdPhysics says.",
        [{"file": "yard.usda", "prim": "/Yard"}],
        default=[],
    )
    joints: list[RigidJointModel] = key(
        "What holds them together.",
        [{"type": "pin", "body": "door", "axis": [0, 1, 0]}],
        default=[],
    )
    forces: Forces = Field([{"gravity": None}])
    colliders: Colliders = Field([])
    characters: Characters = Field([])
    systems: Surfaces = Field([])
    meshes: Meshes = Field([])
    method: Literal["splitting", "rk4", "symplectic_euler", "explicit_euler"] = key(
        "How bodies turn that nothing twists: `splitting` keeps energy and momentum.",
        "rk4",
        default="splitting",
    )
    substeps: Annotated[Whole, Ge(1), Le(1000)] = key(
        "Small steps in each step; contacts are looked for once a step.",
        16,
        default=8,
    )
    iterations: Annotated[Whole, Ge(1), Le(10_000)] = key(
        "Most corrections of the velocities in half a small step; fewer than some "
        "hundred points of contact get up to 32 times as many.",
        32,
        default=8,
    )
    residual: Positive = key(
        "Corrections end when they change velocities by less [m/s, rad/s].",
        1e-5,
        default=1e-4,
    )
    prims: Literal["instancer", "xforms"] = key(
        "What they are written as: one `instancer`, or `xforms`, a prim for each body, "
        "named as it.",
        "xforms",
        default="instancer",
    )
    physics: bool = key(
        "Whether UsdPhysics is written with `prims: xforms`, for other engines.",
        True,
        default=False,
    )
    sleep: SleepModel = key(
        "When bodies that hardly move are left alone.",
        {"speed": 0},
        default=SleepModel(),
    )

    def problems(self) -> Iterator[Problem]:
        """Yield which keys make no sense together (SIM061)."""
        if not self.bodies and not self.stages:
            yield "there are no bodies", None, "name some, or a stage that has some"
        if self.physics and self.prims != "xforms":
            message = "UsdPhysics is said of prims, and copies of an instancer are none"
            yield message, "physics", "prims: xforms"
