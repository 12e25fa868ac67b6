"""Converts prop tracks to the space of their parent prim in a layer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.transforms import (
    Track,
    Transforms,
    apply_placement,
    transform_by_matrices,
)
from animtool.rig.placement import IDENTITY_TOLERANCE, Placement, placement_matrices
from animtool.usd.layers.names import TAKE_SET, RigPaths, replace_prefix

if TYPE_CHECKING:
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class PropPlacements:
    """Prim paths and spaces of the props of a take."""

    model: str  # prim path of the character
    meters_per_unit: float  # unit of the rig [m]
    up: UpAxis  # up axis of the rig, and of the take
    has_prim: Callable[[str], bool]  # whether another layer has a prim at a path
    target: RigTarget | None = None  # rig below a layer
    # Returns the placement from take space to that rig's space at time codes; None is
    # the identity.
    rig_from_take: Callable[[FloatArray], Placement] | None = None
    variant: str = ""  # path of the model in a take's variant; empty if there are none

    def unit_at_path(self, path: str) -> float:
        """Return the length unit of the space at a prim path [m]."""
        if self.target is None or is_same_or_below(path, self.model):
            return self.meters_per_unit
        return self.target.unit

    def layer_path(self, path: str) -> str:
        """Return the layer path of a stage prim."""
        if not self.variant:
            return path
        return replace_prefix(path, self.model, self.variant)

    def to_parent_space(
        self, track: Track, path: str, codes: FloatArray, transforms: Transforms
    ) -> Transforms:
        """Convert a track's transforms at time codes ``(F,)`` to its parent's space."""
        if self.target is None or not track.has_transform:
            return transforms
        if is_same_or_below(path, self.model):
            if self.rig_from_take is not None:
                transforms = apply_placement(transforms, self.rig_from_take(codes))
            parent_matrices = parent_from_space(
                self.target, path, codes, in_skeleton_space=True
            )
        else:
            if track.follows_placement:
                transforms = self._follow_rig_placement(transforms, codes)
            up_rotation = up_from_up(self.target.up, self.up)
            if up_rotation is not None:
                transforms = apply_placement(
                    transforms, Placement.from_rotation(np.array(up_rotation))
                )
            parent_matrices = parent_from_space(
                self.target, path, codes, in_skeleton_space=False
            )
        if parent_matrices is not None:
            parent_matrices[:, :3, 3] *= self.unit_at_path(path)
            transforms = _premultiply(transforms, parent_matrices)
        return replace(transforms, rotations=so3.align_signs(transforms.rotations))

    def _follow_rig_placement(
        self, transforms: Transforms, codes: FloatArray
    ) -> Transforms:
        """Return transforms of a take that follow the rig's stage placement."""
        assert self.target is not None
        rig_placement = self.target.placement()
        if rig_placement.unsupported_reason:
            # The rig was read without this transform, which its stage applies again.
            return transforms
        if rig_placement.is_animated:
            rig_placement = self.target.placement(codes)
        placement = rig_placement.fixed_placement
        if self.rig_from_take is not None:
            placement = placement.after(self.rig_from_take(codes))
        if placement.simplified().is_identity:
            return transforms
        return apply_placement(transforms, placement)


def build_prop_placements(
    paths: RigPaths,
    target: RigTarget | None,
    rig_layer: object,
    meters_per_unit: float,
    up: UpAxis,
    take_name: str = "",
    rig_from_take: Callable[[FloatArray], Placement] | None = None,
) -> PropPlacements:
    """Return the paths and spaces of a take's props.

    Args:
        paths: Prim paths of the character.
        target: Rig below a layer; None for a stage.
        rig_layer: Another layer with the rig, or None.
        meters_per_unit: Unit of the rig [m].
        up: Up axis of the rig.
        take_name: Name of the take in a library.
        rig_from_take: See `PropPlacements`.
    """

    def has_prim(path: str) -> bool:
        if take_name:
            # Another take may have this prim; only one take is bound at a time.
            return False
        if target is not None:
            return bool(target.stage.GetPrimAtPath(target.to_stage_path(path)))
        layer: Any = rig_layer
        return layer is not None and layer.GetPrimAtPath(path) is not None

    model = Sdf.Path(paths.model)
    variant = (
        str(model.AppendVariantSelection(TAKE_SET, take_name)) if take_name else ""
    )
    return PropPlacements(
        paths.model, meters_per_unit, up, has_prim, target, rig_from_take, variant
    )


def parent_from_space(
    target: RigTarget, path: str, codes: FloatArray, *, in_skeleton_space: bool
) -> FloatArray | None:
    """Return the matrices to the space of a layer path's parent at time codes.

    They start from the Skeleton's space or, without ``in_skeleton_space``, from the
    world. Column vectors in stage units ``(F, 4, 4)``, or one matrix if static; None is
    the identity.
    """
    # A stage without a target rig needs no conversion.
    from animtool.usd.props.prim_transforms import world_matrices
    from animtool.usd.rigs.placement import fixed_matrices

    stage = target.stage
    parent_path = Sdf.Path(target.to_stage_path(path)).GetParentPath()
    while not stage.GetPrimAtPath(parent_path):
        parent_path = parent_path.GetParentPath()
    matrices = np.linalg.inv(world_matrices(stage.GetPrimAtPath(parent_path), codes))
    if in_skeleton_space:
        skeleton = stage.GetPrimAtPath(target.to_stage_path(target.paths.skeleton))
        matrices = fixed_matrices(skeleton, codes.tolist()) @ matrices
    if np.abs(matrices - matrices[:1]).max() <= IDENTITY_TOLERANCE:
        matrices = matrices[:1]
    if np.abs(matrices - np.eye(4)).max() <= IDENTITY_TOLERANCE:
        return None
    return np.ascontiguousarray(matrices.swapaxes(1, 2))


def parent_from_take(
    target: RigTarget,
    rig_from_take: Callable[[FloatArray], Placement] | None,
    path: str,
    codes: FloatArray,
) -> FloatArray | None:
    """Return the matrices from take space to the parent space of a layer path.

    Column vectors in the unit of the rig ``(F, 4, 4)``; None is the identity.
    """
    parent_matrices = parent_from_space(target, path, codes, in_skeleton_space=True)
    if rig_from_take is None:
        return parent_matrices
    placement = rig_from_take(codes)
    if placement.is_identity:
        return parent_matrices
    rig_matrices = placement_matrices(placement, target.skeleton.rig.meters_per_unit)
    return rig_matrices if parent_matrices is None else parent_matrices @ rig_matrices


def _premultiply(transforms: Transforms, matrices: FloatArray) -> Transforms:
    """Premultiply transforms by matrices; keep components if these have no shear."""
    from animtool.usd.rigs.prims import decompose

    translations, rotations, scales = decompose(matrices.swapaxes(1, 2))
    uniform_scales = np.cbrt(np.abs(scales).prod(axis=-1))
    similarity = Placement(translations, rotations, uniform_scales)
    if (
        np.abs(placement_matrices(similarity) - matrices).max()
        <= IDENTITY_TOLERANCE * np.abs(matrices).max()
    ):
        return apply_placement(transforms, similarity)
    return transform_by_matrices(transforms, matrices)


def is_same_or_below(path: str, ancestor: str) -> bool:
    """Return whether a path equals another, or is below it."""
    return path == ancestor or path.startswith(f"{ancestor}/")
