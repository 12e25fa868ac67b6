"""Frames of simulated prims: points, curves, meshes, instances and characters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, TypeAlias

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.motion.physics import Physics

if TYPE_CHECKING:
    from animtool.rig.skeleton import Rig

# Named arrays of points: ``(N,)`` integers or floats, or vectors ``(N, 3)``.
Primvars: TypeAlias = Mapping[str, FloatArray | IntArray]


@dataclass(frozen=True, slots=True)
class PointsFrame:
    """Points at one frame; they may appear and disappear over time."""

    ids: IntArray  # (N,)
    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    radii: FloatArray  # (N,) [m]
    primvars: Primvars = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CurvesFrame:
    """Linear curves at one frame, stored one after another."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # points of each curve (C,)
    width: float  # width of all curves [m]
    tears: bool = False  # whether curve counts may change
    primvars: Primvars = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MeshFrame:
    """A polygon mesh at one frame; its faces change only if it tears."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # corners of each face (M,)
    indices: IntArray  # corners, face by face
    closed: bool = False  # whether only the outside of the mesh is visible
    primvars: Primvars = field(default_factory=dict)
    tears: bool = False  # whether faces may change from frame to frame


@dataclass(frozen=True, slots=True)
class TransformsFrame:
    """Rigid copies of meshes at one frame; they may appear and disappear over time."""

    ids: IntArray  # (N,)
    points: FloatArray  # origin of each copy (N, 3) [m]
    velocities: FloatArray  # velocity of each origin (N, 3) [m/s]
    rotations: FloatArray  # unit quaternions x, y, z, w (N, 4)
    spins: FloatArray  # angular velocities, world space (N, 3) [rad/s]
    scales: FloatArray  # (N, 3) [1]
    mesh_indices: IntArray  # mesh of each copy (N,)
    meshes: tuple[MeshFrame, ...]  # in local space, the same in every frame
    primvars: Primvars = field(default_factory=dict)
    names: tuple[str, ...] = ()  # of the copies, the same in every frame; may be empty
    xforms: bool = False  # whether each becomes a named prim instead of an instance
    static: frozenset[int] = frozenset()  # indices of prims that never move
    physics: Physics | None = None  # initial state of these prims, if it is written


@dataclass(frozen=True, slots=True)
class Cast:
    """A rig shared by characters, and the idle cycle of standing ones."""

    rig: Rig  # rig with y up
    animated: IntArray  # indices of joints that rotate, ascending ``(M,)``
    # Joint of the left and of the right foot that is fixed while the foot stands.
    feet: tuple[int, int]
    # Local rotations of `animated` in the idle cycle, evenly sampled ``(K, M, 4)``.
    rotations: FloatArray
    roots: FloatArray  # positions of the first joint in the idle cycle ``(K, 3)`` [m]
    period: float  # length of the idle cycle [s]


@dataclass(frozen=True, slots=True)
class CharactersFrame:
    """Characters at one frame on shared rigs, each with a placement and a pose.

    Every frame has the same characters, sorted by rig; some may be invisible.
    """

    ids: IntArray  # ``(N,)``
    points: FloatArray  # origins of the characters' rigs ``(N, 3)`` [m]
    velocities: FloatArray  # velocities of the origins ``(N, 3)`` [m/s]
    upright: FloatArray  # rotation to the up axis, the same in every frame ``(4,)``
    # Rotation of each about y, applied before ``upright``, continuous ``(N,)`` [rad].
    headings: FloatArray
    # Size of each relative to its rig, the same in every frame ``(N,)`` [1].
    scales: FloatArray
    casts: tuple[Cast, ...]  # the rigs, the same in every frame
    counts: IntArray  # number of characters with each rig ``(C,)``
    # Local rotations of animated joints, by rig ``(n, M, 4)`` each.
    joint_rotations: tuple[FloatArray, ...]
    roots: FloatArray  # positions of the first joint of each ``(N, 3)`` [m]
    stands: BoolArray  # mask of standing feet ``(N, 2)``
    # Mask of feet that stand, are about to land or just lifted ``(N, 2)``.
    near_ground: BoolArray
    clocks: FloatArray  # idle time of characters that only stand, else NaN ``(N,)`` [s]
    visible: BoolArray  # ``(N,)``
    primvars: Primvars = field(default_factory=dict)


Frame: TypeAlias = (
    PointsFrame | CurvesFrame | MeshFrame | TransformsFrame | CharactersFrame
)
