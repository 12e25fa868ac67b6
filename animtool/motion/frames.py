"""Frames of simulated prims, and checks for numbers out of bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, NoReturn, TypeAlias

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.quantities import floor_to_two_digits, plain_number
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


# Largest number of a frame; files hold up to 3e38 in any unit.
MAX_FRAME_VALUE = 1e30
# Checked arrays besides primvars, with their units.
ARRAY_UNITS = {
    "points": "m",
    "velocities": "m/s",
    "spins": "rad/s",
    "rotations": "",
    "scales": "",
    "radii": "m",
}


def check_bounds(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if any number of a frame is out of bounds (SIM102)."""
    arrays = {key: getattr(frame, key, None) for key in ARRAY_UNITS}
    primvars = sorted(getattr(frame, "primvars", {}).items())
    arrays |= {f"primvars:{key}": values for key, values in primvars}
    for array_name, values in arrays.items():
        if values is None or not values.size or values.dtype.kind != "f":
            continue
        if values.min() >= -MAX_FRAME_VALUE and values.max() <= MAX_FRAME_VALUE:
            continue
        index = np.argwhere(~(np.abs(values) <= MAX_FRAME_VALUE))[0]
        number, unit = float(values[tuple(index)]), ARRAY_UNITS.get(array_name, "")
        value_text = f"{number:.3g} {unit}".rstrip()
        _stop(name, t, f"{array_name}[{int(index[0])}] is {value_text}", step)


def check_finite(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if any point of a frame is not finite (SIM102).

    Field velocities may be undefined between frames, and are not checked.
    """
    arrays = [frame.points]
    if isinstance(frame, TransformsFrame):
        arrays += [frame.rotations, frame.scales]
    if all(np.isfinite(array).all() for array in arrays):
        return
    is_finite = np.isfinite(np.concatenate(arrays, axis=1))
    (nonfinite_indices,) = np.nonzero(~is_finite.all(axis=1))
    _stop(name, t, f"point {int(nonfinite_indices[0])} is not finite", step)


def _stop(name: str, t: float, reason: str, step: float) -> NoReturn:
    """Raise SIM102 with a reason, and half the step [s] as a hint."""
    half_step = plain_number(floor_to_two_digits(step / 2))
    hint = f"use step: {half_step}, or weaker forces"
    message = f"{name} blew up at {t:g} s: {reason}"
    raise ToleranceError(Fault("SIM102", message, hint=hint))
