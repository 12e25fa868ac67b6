"""Records of a robot, common to URDF and MJCF: a tree of links and joints."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.rig.drivers import Driver
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import JointType, Mimic, Quaternion

ORIGIN: Vector = (0.0, 0.0, 0.0)
IDENTITY_ROTATION: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """A joint of the rig, which represents all or part of a joint of the file."""

    name: str  # name of the joint in the file; empty if it has none
    type: JointType  # joint type
    translation: Vector = ORIGIN  # position in the frame of the previous joint [m]
    # Rotation in the frame of the previous joint.
    rotation: Quaternion = IDENTITY_ROTATION
    axis: Vector = (0.0, 0.0, 1.0)  # unit axis of a pin or prismatic joint
    limits: RangeLimit | None = None  # limits of the coordinate; None is unlimited
    mimic: Mimic | None = None  # joint of the file that this joint follows linearly
    # Driver of the coordinate; joint names are those of the file.
    driver: Driver | None = None


@dataclass(frozen=True, slots=True)
class SimpleShape:
    """A primitive shape in the frame of its link."""

    kind: str  # ``box``, ``sphere``, ``cylinder`` or ``capsule``; the last two along z
    # Three sides of a box; radius; or radius and length, for a capsule without its ends
    # [m].
    size: tuple[float, ...]
    position: Vector = ORIGIN  # position of the shape's centre [m]
    rotation: Quaternion = IDENTITY_ROTATION  # rotation in the frame of the link


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A triangle surface in the frame of its link."""

    points: FloatArray  # ``(V, 3)`` [m]
    faces: IntArray  # ``(N, 3)``


@dataclass(frozen=True, slots=True, eq=False)
class LinkMass:
    """Mass and inertia of a link in its frame."""

    mass: float  # [kg]
    centre: Vector  # [m]
    inertia: FloatArray  # about the centre, symmetric (3, 3) [kg m²]


@dataclass(slots=True, eq=False)
class Link:
    """A link or body with the joints that move it."""

    name: str  # name in the file
    parent: int  # index of the parent link, -1 for none; less than its own
    # Joints between parent and link, in order.
    joints: list[RobotJoint] = field(default_factory=list)
    offset: Vector = ORIGIN  # offset from the last joint to the link [m]
    solids: list[SimpleShape] = field(default_factory=list)  # shapes that collide
    surfaces: list[Triangles] = field(default_factory=list)  # visible surfaces
    mass: LinkMass | None = None  # mass and inertia; None if not stated
    # Named poses on the link.
    sites: list[tuple[str, Vector, Quaternion]] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Robot:
    """A robot as a tree of links."""

    name: str  # name of the robot
    links: list[Link]  # links, parents before children


def float_vector(values: FloatArray) -> Vector:
    """Return an array's three numbers without negative zeros."""
    x, y, z = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z)


def float_quaternion(values: FloatArray) -> Quaternion:
    """Return an array's four numbers (x, y, z, w) without negative zeros."""
    x, y, z, w = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z, w)
