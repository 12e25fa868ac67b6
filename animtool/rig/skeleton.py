"""A rig in memory: joints in a tree, parents before children."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.rig.controls import Control
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import (
    Attachment,
    Collider,
    IkChain,
    Mesh,
    Shape,
    Vector,
)
from animtool.units import UpAxis

__all__ = ["Joint", "JointType", "Mimic", "Pose", "Rig"]

Quaternion = tuple[float, float, float, float]


class JointType(StrEnum):
    """What a joint can do, relative to its rest frame."""

    FREE = "free"
    BALL = "ball"
    PIN = "pin"
    PRISMATIC = "prismatic"
    FIXED = "fixed"


@dataclass(frozen=True, slots=True)
class Mimic:
    """A pin or prismatic joint's coordinate as ``gain`` · another's + ``offset``.

    Attributes:
        joint: Name of the pin or prismatic joint that it follows.
        gain: In radians and metres of the two joints.
        offset: [rad] or [m].
    """

    joint: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Pose:
    """A local transform, parent space: translation [m], rotation (x, y, z, w)."""

    translation: Vector
    rotation: Quaternion


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint. ``world = world(parent) · T(translation) · R(rotation) · motion(q)``.

    Attributes:
        name: Unique in its rig.
        parent: Index of the parent, -1 for a root; less than the joint's own.
        type: What it can do.
        translation: Rest offset in the parent's frame [m].
        rotation: Rest rotation (x, y, z, w) in the parent's frame.
        axis: Unit axis of a pin or prismatic joint, in the joint's rest frame.
        source_name: The name as its file spells it; empty where that is ``name``.
        channels: Order of a BVH joint's channels (``Xposition`` …); None where the
            source has none of its own.
        tips: Ends of the joint's bone that carry no joint (BVH End Sites), in the
            joint's frame [m].
        limits: How far it may go; None is any way.
        mimic: The joint that it follows.
        mirror: Name of its counterpart on the other side; empty for none.
    """

    name: str
    parent: int
    type: JointType = JointType.FREE
    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    axis: Vector = (0.0, 0.0, 1.0)
    source_name: str = ""
    channels: tuple[str, ...] | None = None
    tips: tuple[Vector, ...] = ()
    limits: RangeLimit | BallLimit | None = None
    mimic: Mimic | None = None
    mirror: str = ""


@dataclass(frozen=True)
class Rig:
    """A skeleton.

    Attributes:
        name: What the character is called.
        joints: Parents before children, several roots allowed.
        meters_per_unit: Length unit of the source [m]; joints are in metres.
        up: The up axis of the source.
        bind: Local transforms of the joints whose bind pose is not their rest.
        meshes: Surfaces.
        shapes: Blend shapes.
        controls: What an animator holds.
        ik: Chains that reach for goals.
        attach: Joints that simulations move.
        colliders: What simulations may not pass through.
        radians_per_unit: Angle unit of the source [rad]; inside they are radians.

    Raises:
        ValueError: A name stands twice, or a parent does not precede its child.
    """

    name: str
    joints: tuple[Joint, ...]
    meters_per_unit: float = 1.0
    up: UpAxis = UpAxis.Y
    bind: Mapping[str, Pose] = field(default_factory=dict)
    meshes: tuple[Mesh, ...] = ()
    shapes: tuple[Shape, ...] = ()
    controls: tuple[Control, ...] = ()
    ik: tuple[IkChain, ...] = ()
    attach: tuple[Attachment, ...] = ()
    colliders: tuple[Collider, ...] = ()
    radians_per_unit: float = math.radians(1.0)
    _index: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the tree and index it by name."""
        index: dict[str, int] = {}
        for i, joint in enumerate(self.joints):
            if joint.name in index:
                raise ValueError(f"two joints are named {joint.name!r}")
            if not -1 <= joint.parent < i:
                raise ValueError(f"the parent of {joint.name!r} must precede it")
            index[joint.name] = i
        object.__setattr__(self, "_index", index)

    def index(self, name: str) -> int:
        """Return the index of a joint.

        Raises:
            KeyError: There is none of that name.
        """
        return self._index[name]

    @property
    def names(self) -> list[str]:
        """Joint names, in order."""
        return [joint.name for joint in self.joints]

    @cached_property
    def parents(self) -> IntArray:
        """Parent of each joint ``(J,)``, -1 for a root."""
        return np.array([joint.parent for joint in self.joints], np.int64)

    @cached_property
    def rest_translations(self) -> FloatArray:
        """Rest offsets ``(J, 3)`` [m], parent space."""
        return np.array([j.translation for j in self.joints], np.float64).reshape(-1, 3)

    @cached_property
    def rest_rotations(self) -> FloatArray:
        """Rest rotations ``(J, 4)``, parent space."""
        return np.array([j.rotation for j in self.joints], np.float64).reshape(-1, 4)

    @property
    def roots(self) -> list[int]:
        """Indices of the joints without a parent."""
        return [i for i, joint in enumerate(self.joints) if joint.parent < 0]

    def paths(self, names: Sequence[str] | None = None) -> list[str]:
        """Return ``root/…/joint`` for every joint, with other names if given."""
        names = self.names if names is None else names
        paths: list[str] = []
        for joint, name in zip(self.joints, names, strict=True):
            paths.append(name if joint.parent < 0 else f"{paths[joint.parent]}/{name}")
        return paths
