"""Placement of a Skeleton on a stage, composed from all transforms above it.

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
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.props.prim_transforms import world_matrices
from animtool.usd.rigs.prims import decompose, up_axis, upwards

# Factors along axes, and cosines between axes, that differ by less are float32's.
EVEN = 1e-5
KEEP, DROP = "keep", "drop"


@dataclass(frozen=True, slots=True)
class SkeletonPlacement:
    """Placement of a Skeleton over the frames of a take."""

    full: Placement  # all that is above its joints
    # The part that a layer over the rig does not replace: without what moves the
    # SkelRoot itself.
    fixed: Placement
    # Why joints cannot hold it, with numbers; empty where they can.
    uneven: str = ""
    # Where the rig's unit or up axis is not its stage's, and no transform says so.
    unit_mismatch: str = ""
    rides: bool = False  # whether the fixed part moves
    _up: UpAxis = UpAxis.Y

    @property
    def stands(self) -> Placement:
        """Where it is placed and faces at rest."""
        return self._at_rest()[0]

    @property
    def rest(self) -> Placement:
        """Placement of its rest pose: size, upright rotation and position."""
        stands, sized = self._at_rest()
        return stands.after(sized)

    @property
    def sized(self) -> Placement:
        """Scale and upright rotation of its rest pose."""
        return self._at_rest()[1]

    @property
    def motion(self) -> Placement:
        """Placement per frame relative to `stands`."""
        stands, _ = self.fixed.split(self._up)
        return stands.inverse().after(self.full).steady()

    def _at_rest(self) -> tuple[Placement, Placement]:
        first = self.full.first()
        return self.fixed.first().split(self._up)[0], first.split(self._up)[1]


def movers(skeleton: Any) -> list[Any]:
    """Return the prims whose transforms place a Skeleton, if any is animated."""
    chain = [mover for prim in upwards(skeleton) if (mover := UsdGeom.Xformable(prim))]
    moves = any(mover.TransformMightBeTimeVarying() for mover in chain)
    return chain if moves else []


def skeleton_placement(
    skeleton: Any, rig: Rig, codes: Sequence[float] | None = None
) -> SkeletonPlacement:
    """Return the placement of a Skeleton at time codes; None is its first.

    rig: in local values; the placement uses its unit and up axis.
    """
    moving = bool(movers(skeleton))
    times = _times(skeleton, codes) if moving else [0.0]
    full = world_matrices(skeleton, np.array(times))
    fixed = full
    if moving:
        fixed = _without_root_motion(skeleton, times, full)
    if not np.isfinite(full).all() or not np.isfinite(fixed).all():
        where = PrimLocation("", str(skeleton.GetPath()))
        where.fail("USD171", "the Skeleton's transform is not finite")
    units = _StageUnits.of(skeleton, rig, full[0])
    fixed_placement = units.placement(fixed)
    # One frame does not tell.
    rides = fixed_placement.moves if codes else moving and _may_ride(skeleton)
    return SkeletonPlacement(
        units.placement(full),
        fixed_placement,
        _uneven(full),
        units.unit_mismatch,
        rides,
        rig.up,
    )


def _may_ride(skeleton: Any) -> bool:
    """Return whether an ancestor other than the SkelRoot moves the Skeleton."""
    root = UsdSkel.Root.Find(skeleton)
    root_path = root.GetPath() if root else None
    return any(
        mover.GetPath() != root_path and mover.TransformMightBeTimeVarying()
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
    """Return the matrices above a Skeleton's joints that a layer keeps.

    As pxr has it ``(F, 4, 4)``, at time codes.
    """
    full = world_matrices(skeleton, np.array(codes))
    return _without_root_motion(skeleton, codes, full)


def _without_root_motion(
    skeleton: Any, times: Sequence[float], full: FloatArray
) -> FloatArray:
    """Return matrices without the SkelRoot's animated operations."""
    root = UsdSkel.Root.Find(skeleton)
    if not root or not root.TransformMightBeTimeVarying():
        return full
    prim, matrices = root.GetPrim(), []
    resets = root.GetResetXformStack()
    for time, world in zip(times, full, strict=True):
        cache = UsdGeom.XformCache(Usd.TimeCode(time))
        above = Gf.Matrix4d(1) if resets else cache.GetParentToWorldTransform(prim)
        below = Gf.Matrix4d(world) * cache.GetLocalToWorldTransform(prim).GetInverse()
        local = Gf.Matrix4d(1)
        for operation in reversed(root.GetOrderedXformOps()):
            if not moves_root(operation):
                local *= operation.GetOpTransform(Usd.TimeCode(time))
        matrices.append(below * local * above)
    return np.array(matrices, np.float64).reshape(-1, 4, 4)


def moves_root(operation: Any) -> bool:
    """Return whether an operation of a SkelRoot is motion that a take replaces."""
    named = "rootMotion" in str(operation.GetOpName())
    return named or bool(operation.MightBeTimeVarying())


@dataclass(frozen=True, slots=True)
class _StageUnits:
    """Conversion from stage world to metres in a rig's up axis."""

    unit: float  # of the stage [m]
    size: float  # what the scales of transforms are multiplied by
    up_rotation: FloatArray | None  # from the stage's up axis, for translations
    righted: FloatArray | None  # likewise for rotations
    unit_mismatch: str

    @staticmethod
    def of(skeleton: Any, rig: Rig, matrix: FloatArray) -> _StageUnits:
        """Return the conversion for a Skeleton with a transform."""
        stage = skeleton.GetStage()
        unit, up = float(UsdGeom.GetStageMetersPerUnit(stage)), up_axis(stage)
        unit_mismatch = []
        size = unit / rig.meters_per_unit
        _, rotation, scales = decompose(matrix)
        if math.isclose(size, 1.0, rel_tol=1e-6):
            size = 1.0
        elif np.abs(np.abs(scales) - 1.0).max() <= EVEN:
            # Nothing is made of the other unit: the rig's numbers are in its own.
            size = 1.0
            unit_mismatch.append(f"in {unit_name(unit)}, but its rig in")
            unit_mismatch[-1] += f" {unit_name(rig.meters_per_unit)}"
        up_rotation = up_from_up(rig.up, up)
        turned = righted = None if up_rotation is None else np.array(up_rotation)
        if turned is not None:
            axis = np.array(rig.up.vector)
            if np.abs(so3.rotate(rotation, axis) - axis).max() <= EVEN:
                righted = None
                unit_mismatch.append(f"{up} up, but its rig {rig.up}")
        return _StageUnits(unit, size, turned, righted, " and ".join(unit_mismatch))

    def placement(self, matrices: FloatArray) -> Placement:
        """Return matrices ``(F, 4, 4)`` as a placement, the nearest if uneven."""
        translations, rotations, scales = decompose(matrices)
        sizes = np.cbrt(np.abs(scales).prod(axis=-1)) * self.size
        translations = translations * self.unit
        if self.up_rotation is not None:
            translations = so3.rotate(self.up_rotation, translations)
        if self.righted is not None:
            rotations = so3.multiply(self.righted, rotations)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        placement = Placement(translations, so3.align_signs(rotations), sizes)
        return _snapped(placement.steady())


def _snapped(placement: Placement) -> Placement:
    """Return a placement snapped to the identity within rounding."""
    if not placement.moves and placement.is_none:
        return Placement.from_rotation(so3.IDENTITY)
    near = np.abs(placement.sizes - 1.0) <= EVEN / 10
    sizes = np.where(near, 1.0, placement.sizes)
    first = sizes[0]
    if np.abs(sizes / first - 1.0).max() <= EVEN / 10:
        sizes = np.full_like(sizes, first)
    return replace(placement, sizes=sizes)


def _uneven(matrices: FloatArray) -> str:
    """Return why joints cannot hold a transform, with numbers; empty if they can."""
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


def refuse_uneven(placement: SkeletonPlacement, where: PrimLocation) -> None:
    """Refuse a placement that joints cannot hold (USD035)."""
    if not placement.uneven:
        return
    message = f"the character {placement.uneven}, which joints cannot represent"
    hint = f"scale it uniformly, or drop its placement: {argument('placement', 'drop')}"
    raise FormatError(where.fault("USD035", message, hint))


def uneven_notice(placement: SkeletonPlacement, where: PrimLocation) -> list[Fault]:
    """Return a warning about a transform that joints cannot represent (USD109)."""
    if not placement.uneven:
        return []
    message = f"the character {placement.uneven}, which joints cannot represent: "
    message += "the transform is ignored"
    hint = "scale it uniformly where it is placed"
    return [where.fault("USD109", message, hint, Severity.WARNING)]


def unit_mismatch_notice(placement: SkeletonPlacement, where: str) -> list[Fault]:
    """Return a notice if rig and stage units or up axes differ (USD110)."""
    if not placement.unit_mismatch:
        return []
    message = (
        f"the stage is {placement.unit_mismatch}, but no transform converts between "
        "them: using the rig's"
    )
    hint = "the shot's own transform must match them"
    return [Fault("USD110", message, where, (), hint, Severity.NOTE)]


NOWHERE = SkeletonPlacement(
    Placement.from_rotation(so3.IDENTITY), Placement.from_rotation(so3.IDENTITY)
)


def rest_rig(rig: Rig, placement: SkeletonPlacement, choice: str | None = None) -> Rig:
    """Return a rig whose rest pose is placed where its stage has it.

    choice: ``drop`` leaves out where the stage has it; None keeps it.
    """
    sized = placed_rig(rig, placement.sized)
    if choice == DROP:
        return sized
    stands = placement.stands
    placed = placed_rig(rig, placement.rest)
    if sized.stands is not None:
        # Its values include a placement, too.
        stands = stands.after(sized.stands)
    return replace(
        placed,
        stands=None if stands.is_none else stands,
        rides=placement.rides or rig.rides,
    )


def local_placement(skeleton: Any, rig: Rig) -> SkeletonPlacement:
    """Return the rest placement of a rig, without an uneven transform."""
    placement = skeleton_placement(skeleton, rig)
    if placement.uneven:
        return replace(NOWHERE, uneven=placement.uneven)
    return placement
