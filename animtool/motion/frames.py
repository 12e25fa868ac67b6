"""What a moving prim is at one time: points, curves, a mesh, copies or characters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, TypeAlias

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.motion.physics import Physics

if TYPE_CHECKING:
    from animtool.rig.skeleton import Rig

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
    """A polygon mesh whose faces never change, unless it tears."""

    points: FloatArray  # (N, 3) [m]
    velocities: FloatArray  # (N, 3) [m/s]
    counts: IntArray  # corners of each face (M,)
    indices: IntArray  # corners, face by face
    closed: bool = False  # whether only its outside is visible
    primvars: Primvars = field(default_factory=dict)
    tears: bool = False  # whether faces may be others in another frame


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


@dataclass(frozen=True, slots=True)
class Cast:
    """A rig that characters have, and what those do alike who stand.

    Attributes:
        rig: With y up.
        moves: Joints that turn, ascending ``(M,)``.
        feet: A joint of the left and of the right foot that stays where that stands.
        turns: Local rotations of `moves` of who stands, at even times ``(K, M, 4)``.
        roots: Of the first joint then ``(K, 3)`` [m].
        period: After which these begin again [s].
    """

    rig: Rig
    moves: IntArray
    feet: tuple[int, int]
    turns: FloatArray
    roots: FloatArray
    period: float


@dataclass(frozen=True, slots=True)
class CharactersFrame:
    """Characters of some rigs, each placed as a whole and in a pose of its own.

    They are the same in every frame, in order of their rigs; some may not be visible.

    Attributes:
        ids: ``(N,)``.
        points: Where the origin of each one's rig is ``(N, 3)`` [m].
        velocities: Of these ``(N, 3)`` [m/s].
        upright: How all are turned, the same in every frame ``(4,)``.
        headings: How each is turned about y before that, continuous ``(N,)`` [rad].
        scales: Of each over its rig, the same in every frame ``(N,)``.
        casts: The rigs, the same in every frame.
        counts: How many have each rig ``(C,)``.
        turns: Local rotations of joints that move, by rig ``(n, M, 4)`` each.
        roots: Of the first joint of each ``(N, 3)`` [m].
        stands: Which feet of each stand ``(N, 2)``.
        near: Which stand, or are about to land or have just lifted ``(N, 2)``.
        clocks: For how long who does but stand has done so, else NaN ``(N,)`` [s].
        visible: ``(N,)``.
    """

    ids: IntArray
    points: FloatArray
    velocities: FloatArray
    upright: FloatArray
    headings: FloatArray
    scales: FloatArray
    casts: tuple[Cast, ...]
    counts: IntArray
    turns: tuple[FloatArray, ...]
    roots: FloatArray
    stands: BoolArray
    near: BoolArray
    clocks: FloatArray
    visible: BoolArray
    primvars: Primvars = field(default_factory=dict)


Frame: TypeAlias = (
    PointsFrame | CurvesFrame | MeshFrame | TransformsFrame | CharactersFrame
)
