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
UNTURNED: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Move:
    """A rig joint: all or part of a joint of the file.

    Attributes:
        name: The file's name of the joint; empty where it has none.
        type: What it can do.
        translation: Where it is, in the frame before it [m].
        rotation: How it is turned there.
        axis: Unit axis of a pin or prismatic joint.
        limits: How far it may go; None is any way.
        mimic: The joint of the file that it follows.
        driven: What it is otherwise; names are those of the file.
    """

    name: str
    type: JointType
    translation: Vector = ORIGIN
    rotation: Quaternion = UNTURNED
    axis: Vector = (0.0, 0.0, 1.0)
    limits: RangeLimit | None = None
    mimic: Mimic | None = None
    driven: Driver | None = None


@dataclass(frozen=True, slots=True)
class SimpleShape:
    """A primitive shape in the frame of its link.

    Attributes:
        kind: ``box``, ``sphere``, ``cylinder`` or ``capsule``; the last two along z.
        size: Three sides of a box; radius; radius and length, of a capsule without
            its ends [m].
        position: Its centre [m].
        rotation: How it is turned.
    """

    kind: str
    size: tuple[float, ...]
    position: Vector = ORIGIN
    rotation: Quaternion = UNTURNED


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A triangle surface in the frame of its link."""

    points: FloatArray  # ``(V, 3)`` [m]
    faces: IntArray  # ``(N, 3)``


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """Mass and inertia of a link in its frame."""

    mass: float  # [kg]
    centre: Vector  # [m]
    inertia: FloatArray  # about the centre, symmetric (3, 3) [kg m²]


@dataclass(slots=True, eq=False)
class Link:
    """A link or body with the joints that move it.

    Attributes:
        name: As the file names it.
        parent: Index of the link that it hangs from, -1 for none; less than its own.
        moves: The joints between the two, in order.
        after: From the last of them to the link [m].
        solids: Its shapes that collide.
        shown: What it looks like.
        weight: None where the file says none.
        sites: Named places on it, with their poses.
    """

    name: str
    parent: int
    moves: list[Move] = field(default_factory=list)
    after: Vector = ORIGIN
    solids: list[SimpleShape] = field(default_factory=list)
    shown: list[Triangles] = field(default_factory=list)
    weight: Weight | None = None
    sites: list[tuple[str, Vector, Quaternion]] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Robot:
    """A tree of links.

    Attributes:
        name: What it is called.
        links: Parents before children.
    """

    name: str
    links: list[Link]


def vector(values: FloatArray) -> Vector:
    """Return an array's three numbers without negative zeros."""
    x, y, z = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z)


def quaternion(values: FloatArray) -> Quaternion:
    """Return an array's four numbers (x, y, z, w) without negative zeros."""
    x, y, z, w = (np.asarray(values, np.float64) + 0.0).tolist()
    return (x, y, z, w)
