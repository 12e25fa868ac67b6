"""Placement of a Skeleton on a stage, composed from all transforms above it.

The transform that pxr composes above a Skeleton, ``LocalToWorld`` in metres, becomes a
`Placement` in the unit and the up axis of the rig. It is the identity for a rig in
centimetres that a shot in metres scales by 0.01. A uniform scale goes to lengths, the
remaining transform to the roots.
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
from animtool.usd.rigs.prims import decompose, self_and_ancestors, up_axis

# Tolerance of scale factors, and of cosines between axes, in float32.
SCALE_TOLERANCE = 1e-5
KEEP, DROP = "keep", "drop"


@dataclass(frozen=True, slots=True)
class SkeletonPlacement:
    """Placement of a Skeleton over the frames of a take."""

    full: Placement  # all transforms above its joints
    # The transforms that a layer over the rig keeps: without root motion of the
    # SkelRoot.
    fixed: Placement
    # Why joints cannot represent it, with numbers; empty if they can.
    uneven: str = ""
    # Mismatch of the rig's and the stage's unit or up axis that no transform
    # compensates; empty if there is none.
    unit_mismatch: str = ""
    rides: bool = False  # whether the fixed transforms are animated
    _up: UpAxis = UpAxis.Y

    @property
    def stands(self) -> Placement:
        """Position and heading at rest."""
        return self._at_rest()[0]

    @property
    def rest(self) -> Placement:
        """Placement of its rest pose: size, upright rotation and position."""
        placement_rest, sizes_rest = self._at_rest()
        return placement_rest.after(sizes_rest)

    @property
    def sized(self) -> Placement:
        """Scale and upright rotation of its rest pose."""
        return self._at_rest()[1]

    @property
    def motion(self) -> Placement:
        """Placement per frame relative to `stands`."""
        stands, _ = self.fixed.split(self._up)
        return stands.inverse().after(self.full).simplified()

    def _at_rest(self) -> tuple[Placement, Placement]:
        first_placement = self.full.first()
        return self.fixed.first().split(self._up)[0], first_placement.split(self._up)[1]


def animated_ancestors(skeleton: Any) -> list[Any]:
    """Return the prims whose transforms place a Skeleton, if any is animated."""
    chain = [
        xformable
        for prim in self_and_ancestors(skeleton)
        if (xformable := UsdGeom.Xformable(prim))
    ]
    is_animated = any(xformable.TransformMightBeTimeVarying() for xformable in chain)
    return chain if is_animated else []


def rotates_or_scales(skeleton: Any) -> bool:
    """Return whether transforms above a Skeleton move it other than by translation."""
    translate = UsdGeom.XformOp.TypeTranslate
    return any(
        operation.GetOpType() != translate and operation.MightBeTimeVarying()
        for xformable in animated_ancestors(skeleton)
        for operation in xformable.GetOrderedXformOps()
    )


def skeleton_placement(
    skeleton: Any, rig: Rig, codes: Sequence[float] | None = None
) -> SkeletonPlacement:
    """Return the placement of a Skeleton at time codes; None is its first.

    ``rig`` has local values; the placement uses its unit and up axis.
    """
    is_animated = bool(animated_ancestors(skeleton))
    times = _placement_times(skeleton, codes) if is_animated else [0.0]
    all_matrices = world_matrices(skeleton, np.array(times))
    kept_matrices = all_matrices
    if is_animated:
        kept_matrices = _without_root_motion(skeleton, times, all_matrices)
    if not np.isfinite(all_matrices).all() or not np.isfinite(kept_matrices).all():
        where = PrimLocation("", str(skeleton.GetPath()))
        where.fail("USD171", "the Skeleton's transform is not finite")
    units = _StageUnits.of(skeleton, rig, all_matrices[0])
    fixed_placement = units.placement(kept_matrices)
    # One frame does not show whether the placement is animated.
    rides = (
        fixed_placement.moves
        if codes
        else is_animated and _has_moving_ancestor(skeleton)
    )
    return SkeletonPlacement(
        units.placement(all_matrices),
        fixed_placement,
        _unrepresentable_reason(all_matrices),
        units.unit_mismatch,
        rides,
        rig.up,
    )


def _has_moving_ancestor(skeleton: Any) -> bool:
    """Return whether an ancestor other than the SkelRoot moves the Skeleton."""
    root = UsdSkel.Root.Find(skeleton)
    root_path = root.GetPath() if root else None
    return any(
        mover.GetPath() != root_path and mover.TransformMightBeTimeVarying()
        for mover in animated_ancestors(skeleton)
    )


def _placement_times(skeleton: Any, codes: Sequence[float] | None) -> list[float]:
    if codes is not None and len(codes):
        return list(codes)
    stage = skeleton.GetStage()
    if stage.HasAuthoredMetadata("startTimeCode"):
        return [float(stage.GetStartTimeCode())]
    samples = [
        time
        for mover in animated_ancestors(skeleton)
        for time in mover.GetTimeSamples()
    ]
    return [min(samples, default=0.0)]


def fixed_matrices(skeleton: Any, codes: Sequence[float]) -> FloatArray:
    """Return the matrices above a Skeleton's joints that a layer keeps.

    Row vectors as in pxr ``(F, 4, 4)``, at time codes.
    """
    all_matrices = world_matrices(skeleton, np.array(codes))
    return _without_root_motion(skeleton, codes, all_matrices)


def _without_root_motion(
    skeleton: Any, times: Sequence[float], all_matrices: FloatArray
) -> FloatArray:
    """Return matrices without the SkelRoot's animated operations."""
    root = UsdSkel.Root.Find(skeleton)
    if not root or not root.TransformMightBeTimeVarying():
        return all_matrices
    prim, matrices = root.GetPrim(), []
    resets = root.GetResetXformStack()
    for time, world in zip(times, all_matrices, strict=True):
        cache = UsdGeom.XformCache(Usd.TimeCode(time))
        parent_matrix = (
            Gf.Matrix4d(1) if resets else cache.GetParentToWorldTransform(prim)
        )
        relative_matrix = (
            Gf.Matrix4d(world) * cache.GetLocalToWorldTransform(prim).GetInverse()
        )
        local = Gf.Matrix4d(1)
        for operation in reversed(root.GetOrderedXformOps()):
            if not moves_root(operation):
                local *= operation.GetOpTransform(Usd.TimeCode(time))
        matrices.append(relative_matrix * local * parent_matrix)
    return np.array(matrices, np.float64).reshape(-1, 4, 4)


def moves_root(operation: Any) -> bool:
    """Return whether an operation of a SkelRoot is motion that a take replaces."""
    is_root_motion = "rootMotion" in str(operation.GetOpName())
    return is_root_motion or bool(operation.MightBeTimeVarying())


@dataclass(frozen=True, slots=True)
class _StageUnits:
    """Conversion from stage world to metres in a rig's up axis."""

    unit: float  # unit of the stage [m]
    size: float  # factor of the scales of transforms
    up_rotation: FloatArray | None  # from the stage's up axis, for translations
    upright: FloatArray | None  # from the stage's up axis, for rotations
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
        elif np.abs(np.abs(scales) - 1.0).max() <= SCALE_TOLERANCE:
            # The mismatch is only reported: the rig's numbers stay in its own unit.
            size = 1.0
            unit_mismatch.append(f"in {unit_name(unit)}, but its rig in")
            unit_mismatch[-1] += f" {unit_name(rig.meters_per_unit)}"
        up_rotation = up_from_up(rig.up, up)
        for_translations = for_rotations = (
            None if up_rotation is None else np.array(up_rotation)
        )
        if for_translations is not None:
            axis = np.array(rig.up.vector)
            if np.abs(so3.rotate(rotation, axis) - axis).max() <= SCALE_TOLERANCE:
                for_rotations = None
                unit_mismatch.append(f"{up} up, but its rig {rig.up}")
        return _StageUnits(
            unit, size, for_translations, for_rotations, " and ".join(unit_mismatch)
        )

    def placement(self, matrices: FloatArray) -> Placement:
        """Return matrices ``(F, 4, 4)`` as a placement, or the nearest one."""
        translations, rotations, scales = decompose(matrices)
        sizes = np.cbrt(np.abs(scales).prod(axis=-1)) * self.size
        translations = translations * self.unit
        if self.up_rotation is not None:
            translations = so3.rotate(self.up_rotation, translations)
        if self.upright is not None:
            rotations = so3.multiply(self.upright, rotations)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        placement = Placement(translations, so3.align_signs(rotations), sizes)
        return _snapped_placement(placement.simplified())


def _snapped_placement(placement: Placement) -> Placement:
    """Return a placement snapped to the identity within rounding."""
    if not placement.moves and placement.is_identity:
        return Placement.from_rotation(so3.IDENTITY)
    is_unit = np.abs(placement.sizes - 1.0) <= SCALE_TOLERANCE / 10
    sizes = np.where(is_unit, 1.0, placement.sizes)
    first_size = sizes[0]
    if np.abs(sizes / first_size - 1.0).max() <= SCALE_TOLERANCE / 10:
        sizes = np.full_like(sizes, first_size)
    return replace(placement, sizes=sizes)


def _unrepresentable_reason(matrices: FloatArray) -> str:
    """Return why joints cannot represent a transform; empty if they can."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=-1)
    is_mirrored = np.linalg.det(linear) <= 0.0
    spread = np.ptp(lengths, axis=-1) > SCALE_TOLERANCE * lengths.max(axis=-1)
    unit = linear / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    cosines = np.abs(unit @ unit.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2))
    is_sheared = cosines > SCALE_TOLERANCE
    is_bad = is_mirrored | spread | is_sheared
    if not is_bad.any():
        return ""
    i = int(is_bad.argmax())
    x, y, z = lengths[i].tolist()
    texts = [f"is scaled by {x:.4g} x {y:.4g} x {z:.4g}"]
    if is_sheared[i]:
        texts.append(f"sheared by {math.degrees(math.asin(cosines[i])):.3g}°")
    if is_mirrored[i]:
        is_singular = lengths[i].min() == 0.0
        texts.append("flat" if is_singular else "mirrored")
    return " and ".join(texts)


def refuse_uneven(placement: SkeletonPlacement, where: PrimLocation) -> None:
    """Refuse a placement that joints cannot represent (USD035)."""
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


NO_PLACEMENT = SkeletonPlacement(
    Placement.from_rotation(so3.IDENTITY), Placement.from_rotation(so3.IDENTITY)
)


def rest_rig(rig: Rig, placement: SkeletonPlacement, choice: str | None = None) -> Rig:
    """Return a rig with its rest pose at its stage placement.

    ``choice`` ``drop`` ignores the stage placement; None keeps it.
    """
    sized_rig = placed_rig(rig, placement.sized)
    if choice == DROP:
        return sized_rig
    stands = placement.stands
    placed_rig_ = placed_rig(rig, placement.rest)
    if sized_rig.stands is not None:
        # Its values also include a placement.
        stands = stands.after(sized_rig.stands)
    return replace(
        placed_rig_,
        stands=None if stands.is_identity else stands,
        rides=placement.rides or rig.rides,
    )


def local_placement(skeleton: Any, rig: Rig) -> SkeletonPlacement:
    """Return the rest placement of a rig; none if joints cannot represent it."""
    placement = skeleton_placement(skeleton, rig)
    if placement.uneven:
        return replace(NO_PLACEMENT, uneven=placement.uneven)
    return placement
