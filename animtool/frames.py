"""What a moving prim is at one time: points, curves or a mesh, with named arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from animtool._types import FloatArray, IntArray

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


Frame: TypeAlias = PointsFrame | CurvesFrame | MeshFrame
