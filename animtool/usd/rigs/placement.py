"""Where a stage has a Skeleton: the one place that composes its transforms.

What pxr composes above a Skeleton, ``LocalToWorld`` in metres, is a `Placement` in the
unit and the up axis of the rig: it is none for a rig in centimetres that a shot in
metres scales by .01. A uniform scale goes into lengths, the rest into roots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name, up_from_up
from animtool.maths import so3
from animtool.rig.placed import placed_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import Spot
from animtool.usd.props.prim_transforms import world_matrices
from animtool.usd.rigs.prims import decompose, up_axis, upwards

# Factors along axes, and cosines between axes, that differ by less are float32's.
EVEN = 1e-5
KEEP, DROP = "keep", "drop"


@dataclass(frozen=True, slots=True)
class SkeletonPlacement:
    """Where a Skeleton is over the frames of a take."""

    whole: Placement  # all that is above its joints
    # The part that a layer over the rig does not replace: without what moves the
    # SkelRoot itself.
    fixed: Placement
    # Why joints cannot hold it, with numbers; empty where they can.
    uneven: str = ""
    # Where the rig's unit or up axis is not its stage's, and no transform says so.
    apart: str = ""
    rides: bool = False  # whether the fixed part moves
    _up: UpAxis = UpAxis.Y

    @property
    def stands(self) -> Placement:
        """Where it stands and faces, at rest."""
        return self._at_rest()[0]

    @property
    def rest(self) -> Placement:
        """What its rest pose is brought to: its size, upright, where it stands."""
        stands, sized = self._at_rest()
        return stands.after(sized)

    @property
    def sized(self) -> Placement:
        """What makes its rest pose its size, and upright."""
        return self._at_rest()[1]

    @property
    def motion(self) -> Placement:
        """What moves it where it stands: all but how it stands, frame by frame."""
        stands, _ = self.fixed.split(self._up)
        return stands.inverse().after(self.whole).steady()

    def _at_rest(self) -> tuple[Placement, Placement]:
        first = self.whole.first()
        return self.fixed.first().split(self._up)[0], first.split(self._up)[1]


def movers(skeleton: Any) -> list[Any]:
    """Return the prims whose transforms place a Skeleton, if one of them moves."""
    chain = [mover for prim in upwards(skeleton) if (mover := UsdGeom.Xformable(prim))]
    moves = any(mover.TransformMightBeTimeVarying() for mover in chain)
    return chain if moves else []


def skeleton_placement(
    skeleton: Any, rig: Rig, codes: Sequence[float] | None = None
) -> SkeletonPlacement:
    """Return where a Skeleton prim is at time codes; None is its first.

    rig: as its numbers are, whose unit and up axis the placement is in.
    """
    moving = bool(movers(skeleton))
    times = _times(skeleton, codes) if moving else [0.0]
    whole = world_matrices(skeleton, np.array(times))
    fixed = whole
    if moving:
        fixed = _without_root_motion(skeleton, times, whole)
    if not np.isfinite(whole).all() or not np.isfinite(fixed).all():
        where = Spot("", str(skeleton.GetPath()))
        where.fail("USD171", "the Skeleton's transform is not finite")
    units = _Units.of(skeleton, rig, whole[0])
    held = units.placement(fixed)
    # One frame does not tell.
    rides = held.moves if codes else moving and _may_ride(skeleton)
    return SkeletonPlacement(
        units.placement(whole), held, _uneven(whole), units.apart, rides, rig.up
    )


def _may_ride(skeleton: Any) -> bool:
    """Return whether a prim that places a Skeleton moves, but for its SkelRoot."""
    root = UsdSkel.Root.Find(skeleton)
    own = root.GetPath() if root else None
    return any(
        mover.GetPath() != own and mover.TransformMightBeTimeVarying()
        for mover in movers(skeleton)
    )


def _times(skeleton: Any, codes: Sequence[float] | None) -> list[float]:
    if codes is not None and len(codes):
        return list(codes)
    stage = skeleton.GetStage()
    if stage.HasAuthoredMetadata("startTimeCode"):
        return [float(stage.GetStartTimeCode())]
    samples = [time for mover in movers(skeleton) for time in mover.GetTimeSamples()]
    return [min(samples, default=0.0)]


def fixed_matrices(skeleton: Any, codes: Sequence[float]) -> FloatArray:
    """Return what a layer over the rig does not replace above a Skeleton's joints.

    As pxr has it ``(F, 4, 4)``, at time codes.
    """
    whole = world_matrices(skeleton, np.array(codes))
    return _without_root_motion(skeleton, codes, whole)


def _without_root_motion(
    skeleton: Any, times: Sequence[float], whole: FloatArray
) -> FloatArray:
    """Return transforms without the operations that move the SkelRoot itself."""
    root = UsdSkel.Root.Find(skeleton)
    if not root or not root.TransformMightBeTimeVarying():
        return whole
    prim, found = root.GetPrim(), []
    resets = root.GetResetXformStack()
    for time, world in zip(times, whole, strict=True):
        cache = UsdGeom.XformCache(Usd.TimeCode(time))
        above = Gf.Matrix4d(1) if resets else cache.GetParentToWorldTransform(prim)
        below = Gf.Matrix4d(world) * cache.GetLocalToWorldTransform(prim).GetInverse()
        own = Gf.Matrix4d(1)
        for operation in reversed(root.GetOrderedXformOps()):
            if not moves_root(operation):
                own *= operation.GetOpTransform(Usd.TimeCode(time))
        found.append(below * own * above)
    return np.array(found, np.float64).reshape(-1, 4, 4)


def moves_root(operation: Any) -> bool:
    """Return whether an operation of a SkelRoot is motion that a take replaces."""
    named = "rootMotion" in str(operation.GetOpName())
    return named or bool(operation.MightBeTimeVarying())


@dataclass(frozen=True, slots=True)
class _Units:
    """From the world of a stage to metres, with the up axis of a rig."""

    unit: float  # of the stage [m]
    size: float  # what the scales of transforms are multiplied by
    turn: FloatArray | None  # from the stage's up axis, for translations
    righted: FloatArray | None  # likewise for rotations
    apart: str

    @staticmethod
    def of(skeleton: Any, rig: Rig, matrix: FloatArray) -> _Units:
        """Return those of a Skeleton that has a transform."""
        stage = skeleton.GetStage()
        unit, up = float(UsdGeom.GetStageMetersPerUnit(stage)), up_axis(stage)
        apart = []
        size = unit / rig.meters_per_unit
        _, rotation, scales = decompose(matrix)
        if math.isclose(size, 1.0, rel_tol=1e-6):
            size = 1.0
        elif np.abs(np.abs(scales) - 1.0).max() <= EVEN:
            # Nothing is made of the other unit: the rig's numbers are in its own.
            size = 1.0
            apart.append(f"in {unit_name(unit)}, but its rig in")
            apart[-1] += f" {unit_name(rig.meters_per_unit)}"
        turn = up_from_up(rig.up, up)
        turned = righted = None if turn is None else np.array(turn)
        if turned is not None:
            axis = np.array(rig.up.vector)
            if np.abs(so3.rotate(rotation, axis) - axis).max() <= EVEN:
                righted = None
                apart.append(f"{up} up, but its rig {rig.up}")
        return _Units(unit, size, turned, righted, " and ".join(apart))

    def placement(self, matrices: FloatArray) -> Placement:
        """Return transforms ``(F, 4, 4)`` as a placement, the nearest where uneven."""
        translations, rotations, scales = decompose(matrices)
        sizes = np.cbrt(np.abs(scales).prod(axis=-1)) * self.size
        translations = translations * self.unit
        if self.turn is not None:
            translations = so3.rotate(self.turn, translations)
        if self.righted is not None:
            rotations = so3.multiply(self.righted, rotations)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        placement = Placement(translations, so3.align_signs(rotations), sizes)
        return _snapped(placement.steady())


def _snapped(placement: Placement) -> Placement:
    """Return a placement whose rounding is gone, where it is none."""
    if not placement.moves and placement.is_none:
        return Placement.from_rotation(so3.IDENTITY)
    near = np.abs(placement.sizes - 1.0) <= EVEN / 10
    sizes = np.where(near, 1.0, placement.sizes)
    first = sizes[0]
    if np.abs(sizes / first - 1.0).max() <= EVEN / 10:
        sizes = np.full_like(sizes, first)
    return replace(placement, sizes=sizes)


def _uneven(matrices: FloatArray) -> str:
    """Say with numbers why joints cannot hold a transform; empty where they can."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=-1)
    mirrored = np.linalg.det(linear) <= 0.0
    spread = np.ptp(lengths, axis=-1) > EVEN * lengths.max(axis=-1)
    unit = linear / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    cosines = np.abs(unit @ unit.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2))
    sheared = cosines > EVEN
    wrong = mirrored | spread | sheared
    if not wrong.any():
        return ""
    i = int(wrong.argmax())
    x, y, z = lengths[i].tolist()
    texts = [f"is scaled by {x:.4g} x {y:.4g} x {z:.4g}"]
    if sheared[i]:
        texts.append(f"sheared by {math.degrees(math.asin(cosines[i])):.3g}°")
    if mirrored[i]:
        flat = lengths[i].min() == 0.0
        texts.append("flat" if flat else "mirrored")
    return " and ".join(texts)


def refuse_uneven(placement: SkeletonPlacement, where: Spot) -> None:
    """Refuse a placement that joints cannot hold (USD035)."""
    if not placement.uneven:
        return
    message = f"the character {placement.uneven}, which joints cannot represent"
    hint = f"scale it uniformly, or drop its placement: {argument('placement', 'drop')}"
    raise FormatError(where.fault("USD035", message, hint))


def uneven_notice(placement: SkeletonPlacement, where: Spot) -> list[Fault]:
    """Say with numbers which transform is left out (USD109)."""
    if not placement.uneven:
        return []
    message = f"the character {placement.uneven}, which joints cannot represent: "
    message += "the transform is ignored"
    hint = "scale it uniformly where it is placed"
    return [where.fault("USD109", message, hint, Severity.WARNING)]


def apart_notice(placement: SkeletonPlacement, where: str) -> list[Fault]:
    """Say so where a rig is read in its own unit or up axis (USD110)."""
    if not placement.apart:
        return []
    message = (
        f"the stage is {placement.apart}, but no transform converts between them: "
    )
    message += "using the rig's"
    hint = "the shot's own transform must match them"
    return [Fault("USD110", message, where, (), hint, Severity.NOTE)]


NOWHERE = SkeletonPlacement(
    Placement.from_rotation(so3.IDENTITY), Placement.from_rotation(so3.IDENTITY)
)


def rest_rig(rig: Rig, placement: SkeletonPlacement, choice: str | None = None) -> Rig:
    """Return a rig, as its numbers are, with its rest pose where its stage has it.

    choice: ``drop`` leaves out where the stage has it; None keeps it.
    """
    sized = placed_rig(rig, placement.sized)
    if choice == DROP:
        return sized
    stands = placement.stands
    placed = placed_rig(rig, placement.rest)
    if sized.stands is not None:
        # Its numbers have it stand somewhere too.
        stands = stands.after(sized.stands)
    return replace(
        placed,
        stands=None if stands.is_none else stands,
        rides=placement.rides or rig.rides,
    )


def own_placement(skeleton: Any, rig: Rig) -> SkeletonPlacement:
    """Return where a rig is at rest; an uneven placement is left out of that."""
    placement = skeleton_placement(skeleton, rig)
    if placement.uneven:
        return replace(NOWHERE, uneven=placement.uneven)
    return placement
