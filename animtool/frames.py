"""What a moving prim is at one time: points, curves, a mesh or copies of meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from animtool._types import FloatArray, IntArray
from animtool.physics import Physics

# Named arrays of points: ``(N,)`` whole or real numbers, or vectors ``(N, 3)``.
Primvars: TypeAlias = Mapping[str, FloatArray | IntArray]


@dataclass(frozen=True, slots=True)
class PointsFrame:
    """Points that appear and disappear."""

    ids: IntArray  # (N,)
    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    radii: FloatArray  # (N,) [m]
    primvars: Primvars = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CurvesFrame:
    """Linear curves, one after the other."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # points of each curve (C,)
    width: float  # of all [m]
    tears: bool = False  # whether counts may change
    primvars: Primvars = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MeshFrame:
    """A polygon mesh whose faces never change."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # corners of each face (M,)
    indices: IntArray  # corners, face by face
    closed: bool = False  # whether only its outside is visible
    primvars: Primvars = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TransformsFrame:
    """Copies of meshes that appear and disappear, each placed as a whole."""

    ids: IntArray  # (N,)
    points: FloatArray  # where the origin of each is (N, 3) [m]
    velocities: FloatArray  # of these (N, 3) [m/s]
    rotations: FloatArray  # unit quaternions x, y, z, w (N, 4)
    spins: FloatArray  # angular velocities, in the world (N, 3) [rad/s]
    scales: FloatArray  # (N, 3) [1]
    copied: IntArray  # which of the meshes each is (N,)
    meshes: tuple[MeshFrame, ...]  # about their own origins, the same in every frame
    primvars: Primvars = field(default_factory=dict)
    names: tuple[str, ...] = ()  # of each, the same in every frame; or none
    xforms: bool = False  # whether each becomes a prim of its own, by its name
    still: frozenset[int] = frozenset()  # places of such that never move
    physics: Physics | None = None  # of such, if it is to be written


Frame: TypeAlias = PointsFrame | CurvesFrame | MeshFrame | TransformsFrame
