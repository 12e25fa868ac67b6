"""Robot description common to URDF and MJCF: a tree of links and joints."""

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
    """A rig joint: all or part of a joint of the file.

    Attributes:
        name: Name of the joint in the file; empty without one.
        type: Joint type.
        translation: Position in the frame of the previous joint [m].
        rotation: Rotation in the frame of the previous joint.
        axis: Unit axis of a pin or prismatic joint.
        limits: Limits of the coordinate; None is unlimited.
        mimic: Joint of the file that this joint follows linearly.
        driver: Driver of the coordinate; joint names are those of the file.
    """

    name: str
    type: JointType
    translation: Vector = ORIGIN
    rotation: Quaternion = IDENTITY_ROTATION
    axis: Vector = (0.0, 0.0, 1.0)
    limits: RangeLimit | None = None
    mimic: Mimic | None = None
    driver: Driver | None = None


@dataclass(frozen=True, slots=True)
class SimpleShape:
    """A primitive shape in the frame of its link.

    Attributes:
        kind: ``box``, ``sphere``, ``cylinder`` or ``capsule``; the last two along z.
        size: Three sides of a box; radius; or radius and length, for a capsule without
            its ends [m].
        position: Position of the shape's centre [m].
        rotation: Rotation in the frame of the link.
    """

    kind: str
    size: tuple[float, ...]
    position: Vector = ORIGIN
    rotation: Quaternion = IDENTITY_ROTATION


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
    """A link or body with the joints that move it.

    Attributes:
        name: Name in the file.
        parent: Index of the parent link, -1 for none; less than its own.
        joints: Joints between parent and link, in order.
        offset: Offset from the last joint to the link [m].
        solids: Shapes that collide.
        surfaces: Visible surfaces.
        weight: Mass and inertia; None if not stated.
        sites: Named poses on the link.
    """

    name: str
    parent: int
    joints: list[RobotJoint] = field(default_factory=list)
    offset: Vector = ORIGIN
    solids: list[SimpleShape] = field(default_factory=list)
    surfaces: list[Triangles] = field(default_factory=list)
    weight: LinkMass | None = None
    sites: list[tuple[str, Vector, Quaternion]] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Robot:
    """A tree of links.

    Attributes:
        name: Name of the robot.
        links: Links, parents before children.
    """

    name: str
    links: list[Link]


def float_vector(values: FloatArray) -> Vector:
    """Return an array's three numbers without negative zeros."""
    x, y, z = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z)


def float_quaternion(values: FloatArray) -> Quaternion:
    """Return an array's four numbers (x, y, z, w) without negative zeros."""
    x, y, z, w = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z, w)
