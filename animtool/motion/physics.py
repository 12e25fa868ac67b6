"""Initial states of rigid bodies, for other physics engines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3

IDENTITY_POSE: FloatArray = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def relative_pose(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """Return a pose ``(7,)`` relative to a frame ``(7,)`` in the same space."""
    inverse_rotation = so3.conjugate(frame[3:])
    position = so3.rotate(inverse_rotation, pose[:3] - frame[:3])
    return np.concatenate([position, so3.multiply(inverse_rotation, pose[3:])])


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsShape:
    """A collision shape of a body or of the world."""

    # `sphere` (radius), `capsule` (radius, length of its segment along y), `box` (three
    # sides), `plane` (none: what is below y = 0) or `mesh` (none: its triangles).
    kind: str
    size: tuple[float, ...] = ()  # [m]
    # origin [m], quaternion (7,)
    pose: FloatArray = field(default_factory=IDENTITY_POSE.copy)
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))  # (P, 3) [m]
    triangles: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    friction: float = 0.5
    restitution: float = 0.0
    name: str = ""
    hull: bool = False  # whether a mesh collides as its convex hull


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsBody:
    """A rigid body, in its local frame unless stated otherwise."""

    name: str
    pose: FloatArray  # world pose of the body's frame (7,)
    shapes: Sequence[PhysicsShape]
    density: float = 1000.0  # density of the shapes, used without a mass [kg/m³]
    mass: float | None = None  # [kg]
    centre: FloatArray | None = None  # centre of mass (3,) [m]
    inertia: FloatArray | None = None  # principal moments of inertia (3,) [kg m²]
    axes: FloatArray = field(default_factory=IDENTITY_POSE[3:].copy)  # principal (4,)
    velocity: FloatArray = field(default_factory=lambda: np.zeros(3))  # world [m/s]
    spin: FloatArray = field(default_factory=lambda: np.zeros(3))  # world [rad/s]
    kinematic: bool = False
    times: FloatArray = field(default_factory=lambda: np.zeros(1))  # (T,) [s]
    kinematic_poses: FloatArray | None = None  # at these times (T, 7)
    origin: str = ""  # file and prim of the body


@dataclass(frozen=True, slots=True, eq=False)
class JointDrive:
    """A drive of a joint: a spring and damper towards a target."""

    stiffness: float  # [N m/rad] or [N/m]
    damping: float  # [N m s/rad] or [N s/m]
    target: float = 0.0  # [rad] or [m]
    # target rotation of a ball joint (4,)
    rotation: FloatArray = field(default_factory=IDENTITY_POSE[3:].copy)
    max_force: float | None = None  # largest torque [N m] or force [N]
    speed: float = 0.0  # target velocity of the damping [rad/s] or [m/s]


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsJoint:
    """A joint between two bodies; its axis is x of the joint frame."""

    name: str
    kind: str  # `fixed`, `pin`, `ball` or `prismatic`
    bodies: tuple[int, int]  # indices of the two bodies; -1 is the world
    frames: tuple[FloatArray, FloatArray]  # joint frame in each body (7,)
    limits: tuple[float, float] | None = None  # [rad] or [m]; of a ball joint: twist
    swing: tuple[float, float] | None = None  # half-angles about y and z [rad]
    drive: JointDrive | None = None
    contacts: bool = False  # whether the two bodies collide with each other
    # Force [N] and torque [N m] at which the joint breaks.
    break_limits: tuple[float, float] = (np.inf, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Physics:
    """Bodies, joints and colliders of a physics scene."""

    bodies: Sequence[PhysicsBody]
    joints: Sequence[PhysicsJoint] = ()
    colliders: Sequence[PhysicsShape] = ()  # static, world space
    gravity: FloatArray = field(default_factory=lambda: np.zeros(3))  # [m/s²]
    notices: Sequence[Fault] = ()
