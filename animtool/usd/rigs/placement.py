"""Computes the placement of a Skeleton on a stage from all transforms above it.

The local-to-world transform of a Skeleton becomes a `Placement` in the unit and up axis
of the rig. It is the identity for a rig in centimetres that a shot in metres scales by
0.01. The uniform scale applies to bone lengths, the other components to the roots.
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
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.props.prim_transforms import world_matrices
from animtool.usd.rigs.prims import decompose, sample_times, self_and_ancestors, up_axis

# Tolerance of scale factors, and of cosines between axes, in float32.
SCALE_TOLERANCE = 1e-5
KEEP_PLACEMENT, DROP_PLACEMENT = "keep", "drop"


@dataclass(frozen=True, slots=True)
class SkeletonPlacement:
    """Placement of a Skeleton over the frames of a take."""

    full_placement: Placement  # all transforms above its joints
    # Transforms above its joints without root motion of the SkelRoot: those that a
    # layer over the rig keeps.
    fixed_placement: Placement
    # Why joints cannot represent the transform; empty if they can.
    unsupported_reason: str = ""
    # Mismatch between the unit or up axis of rig and stage that no transform converts;
    # empty if there is none.
    unit_mismatch: str = ""
    is_animated: bool = False  # whether the fixed transforms are animated
    _up: UpAxis = UpAxis.Y

    @property
    def heading_placement(self) -> Placement:
        """Position and heading of the rest pose."""
        return self._split_rest()[0]

    @property
    def rest_placement(self) -> Placement:
        """Scale, upright rotation, position and heading of the rest pose."""
        heading, upright_placement = self._split_rest()
        return heading.after(upright_placement)

    @property
    def upright_placement(self) -> Placement:
        """Scale and upright rotation of the rest pose."""
        return self._split_rest()[1]

    @property
    def motion(self) -> Placement:
        """Placement per frame relative to `heading_placement`."""
        heading, _ = self.fixed_placement.split(self._up)
        return heading.inverse().after(self.full_placement).simplified()

    def _split_rest(self) -> tuple[Placement, Placement]:
        first_placement = self.full_placement.first()
        return self.fixed_placement.first().split(self._up)[0], first_placement.split(
            self._up
        )[1]


def animated_ancestors(skeleton: Any) -> list[Any]:
    """Return a Skeleton's xformable ancestors and itself; empty if none is animated."""
    xformables = [
        xformable
        for prim in self_and_ancestors(skeleton)
        if (xformable := UsdGeom.Xformable(prim))
    ]
    is_animated = any(
        xformable.TransformMightBeTimeVarying() for xformable in xformables
    )
    return xformables if is_animated else []


def has_animated_rotation_or_scale(skeleton: Any) -> bool:
    """Return whether an animated transform above a Skeleton is not a translation."""
    translate = UsdGeom.XformOp.TypeTranslate
    return any(
        operation.GetOpType() != translate and operation.MightBeTimeVarying()
        for xformable in animated_ancestors(skeleton)
        for operation in xformable.GetOrderedXformOps()
    )


def skeleton_placement(
    skeleton: Any, rig: Rig, codes: Sequence[float] | None = None
) -> SkeletonPlacement:
    """Return the placement of a Skeleton at time codes; None is the first time.

    ``rig`` has local values; the placement uses its unit and up axis.
    """
    is_animated = bool(animated_ancestors(skeleton))
    time_codes = _placement_times(skeleton, codes) if is_animated else [0.0]
    all_matrices = world_matrices(skeleton, np.array(time_codes))
    layer_matrices = all_matrices
    if is_animated:
        layer_matrices = _without_root_motion(skeleton, time_codes, all_matrices)
    if not np.isfinite(all_matrices).all() or not np.isfinite(layer_matrices).all():
        location = PrimLocation("", str(skeleton.GetPath()))
        location.fail("USD171", "the Skeleton's transform is not finite")
    stage_units = _StageUnits.from_skeleton(skeleton, rig, all_matrices[0])
    fixed_placement = stage_units.placement(layer_matrices)
    # A single frame cannot show whether the placement is animated.
    is_placement_animated = (
        fixed_placement.is_animated
        if codes
        else is_animated and _has_moving_ancestor(skeleton)
    )
    return SkeletonPlacement(
        stage_units.placement(all_matrices),
        fixed_placement,
        _find_unsupported_reason(all_matrices),
        stage_units.unit_mismatch,
        is_placement_animated,
        rig.up,
    )


def _has_moving_ancestor(skeleton: Any) -> bool:
    """Return whether an ancestor other than the SkelRoot moves the Skeleton."""
    root = UsdSkel.Root.Find(skeleton)
    root_path = root.GetPath() if root else None
    return any(
        xformable.GetPath() != root_path and xformable.TransformMightBeTimeVarying()
        for xformable in animated_ancestors(skeleton)
    )


def _placement_times(skeleton: Any, codes: Sequence[float] | None) -> list[float]:
    if codes is not None and len(codes):
        return list(codes)
    stage = skeleton.GetStage()
    if stage.HasAuthoredMetadata("startTimeCode"):
        return [float(stage.GetStartTimeCode())]
    return [min(sample_times(animated_ancestors(skeleton)), default=0.0)]


def fixed_matrices(skeleton: Any, codes: Sequence[float]) -> FloatArray:
    """Return a Skeleton's world matrices without root motion of the SkelRoot.

    Row vectors as in pxr ``(F, 4, 4)``, at time codes.
    """
    all_matrices = world_matrices(skeleton, np.array(codes))
    return _without_root_motion(skeleton, codes, all_matrices)


def _without_root_motion(
    skeleton: Any, times: Sequence[float], all_matrices: FloatArray
) -> FloatArray:
    """Return world matrices of a Skeleton without root motion of its SkelRoot."""
    root = UsdSkel.Root.Find(skeleton)
    if not root or not root.TransformMightBeTimeVarying():
        return all_matrices
    prim, matrices = root.GetPrim(), []
    resets_stack = root.GetResetXformStack()
    for time, world in zip(times, all_matrices, strict=True):
        cache = UsdGeom.XformCache(Usd.TimeCode(time))
        parent_matrix = (
            Gf.Matrix4d(1) if resets_stack else cache.GetParentToWorldTransform(prim)
        )
        relative_matrix = (
            Gf.Matrix4d(world) * cache.GetLocalToWorldTransform(prim).GetInverse()
        )
        fixed_local = Gf.Matrix4d(1)
        for operation in reversed(root.GetOrderedXformOps()):
            if not is_root_motion(operation):
                fixed_local *= operation.GetOpTransform(Usd.TimeCode(time))
        matrices.append(relative_matrix * fixed_local * parent_matrix)
    return np.array(matrices, np.float64).reshape(-1, 4, 4)


def is_root_motion(operation: Any) -> bool:
    """Return whether a transform operation of a SkelRoot is root motion."""
    has_root_motion_name = "rootMotion" in str(operation.GetOpName())
    return has_root_motion_name or bool(operation.MightBeTimeVarying())


@dataclass(frozen=True, slots=True)
class _StageUnits:
    """Conversion from stage world to metres in a rig's up axis."""

    meters_per_unit: float  # unit of the stage [m]
    scale_factor: float  # factor of the scales of transforms
    up_rotation: FloatArray | None  # from the stage's up axis, for translations
    upright_rotation: FloatArray | None  # from the stage's up axis, for rotations
    unit_mismatch: str

    @staticmethod
    def from_skeleton(skeleton: Any, rig: Rig, matrix: FloatArray) -> _StageUnits:
        """Return the conversion for a Skeleton with a world matrix."""
        stage = skeleton.GetStage()
        meters_per_unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        stage_up = up_axis(stage)
        mismatches = []
        scale_factor = meters_per_unit / rig.meters_per_unit
        _, rotation, scales = decompose(matrix)
        if math.isclose(scale_factor, 1.0, rel_tol=1e-6):
            scale_factor = 1.0
        elif np.abs(np.abs(scales) - 1.0).max() <= SCALE_TOLERANCE:
            # The mismatch is only reported: the rig's numbers are not converted.
            scale_factor = 1.0
            mismatches.append(f"in {unit_name(meters_per_unit)}, but its rig in")
            mismatches[-1] += f" {unit_name(rig.meters_per_unit)}"
        up_rotation = up_from_up(rig.up, stage_up)
        translation_rotation = upright_rotation = (
            None if up_rotation is None else np.array(up_rotation)
        )
        if translation_rotation is not None:
            axis = np.array(rig.up.vector)
            if np.abs(so3.rotate(rotation, axis) - axis).max() <= SCALE_TOLERANCE:
                upright_rotation = None
                mismatches.append(f"{stage_up} up, but its rig {rig.up}")
        return _StageUnits(
            meters_per_unit,
            scale_factor,
            translation_rotation,
            upright_rotation,
            " and ".join(mismatches),
        )

    def placement(self, matrices: FloatArray) -> Placement:
        """Convert matrices ``(F, 4, 4)`` to the nearest placement."""
        translations, rotations, scales = decompose(matrices)
        uniform_scales = np.cbrt(np.abs(scales).prod(axis=-1)) * self.scale_factor
        translations = translations * self.meters_per_unit
        if self.up_rotation is not None:
            translations = so3.rotate(self.up_rotation, translations)
        if self.upright_rotation is not None:
            rotations = so3.multiply(self.upright_rotation, rotations)
        uniform_scales = np.where(uniform_scales > 0.0, uniform_scales, 1.0)
        placement = Placement(translations, so3.align_signs(rotations), uniform_scales)
        return _snap_placement(placement.simplified())


def _snap_placement(placement: Placement) -> Placement:
    """Return a placement snapped to the identity within rounding."""
    if not placement.is_animated and placement.is_identity:
        return Placement.from_rotation(so3.IDENTITY)
    is_unit = np.abs(placement.sizes - 1.0) <= SCALE_TOLERANCE / 10
    sizes = np.where(is_unit, 1.0, placement.sizes)
    first_size = sizes[0]
    if np.abs(sizes / first_size - 1.0).max() <= SCALE_TOLERANCE / 10:
        sizes = np.full_like(sizes, first_size)
    return replace(placement, sizes=sizes)


def _find_unsupported_reason(matrices: FloatArray) -> str:
    """Return why joints cannot represent a transform; empty if joints can."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=-1)
    is_mirrored = np.linalg.det(linear) <= 0.0
    is_nonuniform = np.ptp(lengths, axis=-1) > SCALE_TOLERANCE * lengths.max(axis=-1)
    unit_axes = linear / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    shear_cosines = np.abs(unit_axes @ unit_axes.swapaxes(-1, -2) - np.eye(3)).max(
        axis=(-1, -2)
    )
    is_sheared = shear_cosines > SCALE_TOLERANCE
    is_unsupported = is_mirrored | is_nonuniform | is_sheared
    if not is_unsupported.any():
        return ""
    first_frame = int(is_unsupported.argmax())
    x, y, z = lengths[first_frame].tolist()
    descriptions = [f"is scaled by {x:.4g} x {y:.4g} x {z:.4g}"]
    if is_sheared[first_frame]:
        descriptions.append(
            f"sheared by {math.degrees(math.asin(shear_cosines[first_frame])):.3g}°"
        )
    if is_mirrored[first_frame]:
        is_singular = lengths[first_frame].min() == 0.0
        descriptions.append("flat" if is_singular else "mirrored")
    return " and ".join(descriptions)


def refuse_unsupported(placement: SkeletonPlacement, location: PrimLocation) -> None:
    """Refuse a placement that joints cannot represent (USD035)."""
    if not placement.unsupported_reason:
        return
    message = (
        f"the character {placement.unsupported_reason}, which joints cannot represent"
    )
    hint = f"scale it uniformly, or drop its placement: {argument('placement', 'drop')}"
    raise FormatError(location.fault("USD035", message, hint))


def unsupported_notice(
    placement: SkeletonPlacement, location: PrimLocation
) -> list[Fault]:
    """Return a warning about a transform that joints cannot represent (USD109)."""
    if not placement.unsupported_reason:
        return []
    message = (
        f"the character {placement.unsupported_reason}, which joints cannot represent: "
        "the transform is ignored"
    )
    hint = "scale it uniformly where it is placed"
    return [location.fault("USD109", message, hint, Severity.WARNING)]


def unit_mismatch_notice(placement: SkeletonPlacement, file_path: str) -> list[Fault]:
    """Return a notice if rig and stage units or up axes differ (USD110)."""
    if not placement.unit_mismatch:
        return []
    message = (
        f"the stage is {placement.unit_mismatch}, but no transform converts between "
        "them: using the rig's"
    )
    hint = "the shot's own transform must match them"
    return [Fault("USD110", message, file_path, (), hint, Severity.NOTE)]


NO_PLACEMENT = SkeletonPlacement(
    Placement.from_rotation(so3.IDENTITY), Placement.from_rotation(so3.IDENTITY)
)


def rig_at_stage_placement(
    rig: Rig, placement: SkeletonPlacement, placement_choice: str | None = None
) -> Rig:
    """Return a rig whose rest pose is at its stage placement.

    With ``drop`` as ``placement_choice`` the rig is only scaled and upright; None keeps
    its position and heading.
    """
    sized_rig = transform_rig(rig, placement.upright_placement)
    if placement_choice == DROP_PLACEMENT:
        return sized_rig
    heading_placement = placement.heading_placement
    rig_at_rest = transform_rig(rig, placement.rest_placement)
    if sized_rig.placement is not None:
        # Its values also include a placement.
        heading_placement = heading_placement.after(sized_rig.placement)
    return replace(
        rig_at_rest,
        placement=None if heading_placement.is_identity else heading_placement,
        has_animated_parents=placement.is_animated or rig.has_animated_parents,
    )


def local_placement(skeleton: Any, rig: Rig) -> SkeletonPlacement:
    """Return a rig's rest placement; the identity if joints cannot represent it."""
    placement = skeleton_placement(skeleton, rig)
    if placement.unsupported_reason:
        return replace(NO_PLACEMENT, unsupported_reason=placement.unsupported_reason)
    return placement
