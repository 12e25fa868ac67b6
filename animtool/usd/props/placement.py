"""Space in which props are written: a character's space, or the stage's world."""

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
    placed_transforms,
    transform_by_matrices,
)
from animtool.rig.placement import IDENTITY_TOLERANCE, Placement
from animtool.usd.layers.names import TAKE_SET, RigPaths

if TYPE_CHECKING:
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class PropPlacements:
    """Prim paths and spaces of the props of a take."""

    model: str  # prim path of the character
    meters_per_unit: float  # unit of the rig [m]
    up: UpAxis  # up axis of the rig, and of the take
    exists: Callable[[str], bool]  # whether another layer has a prim at a path
    target: RigTarget | None = None  # rig below a layer
    # Returns the placement from take space to that rig's space at time codes; None is
    # the identity.
    to_rig: Callable[[FloatArray], Placement] | None = None
    variant: str = ""  # path of the model in a take's variant; empty without variants

    def unit(self, path: str) -> float:
        """Return the length unit at a prim path [m]."""
        if self.target is None or is_within(path, self.model):
            return self.meters_per_unit
        return self.target.unit

    def spec(self, path: str) -> str:
        """Return the layer path of a stage prim."""
        if not self.variant:
            return path
        return str(Sdf.Path(path).ReplacePrefix(self.model, self.variant))

    def located(
        self, track: Track, path: str, codes: FloatArray, transforms: Transforms
    ) -> Transforms:
        """Return a track at time codes ``(F,)``, in the space of its parent prim."""
        if self.target is None or not track.placed:
            return transforms
        if is_within(path, self.model):
            if self.to_rig is not None:
                transforms = placed_transforms(transforms, self.to_rig(codes))
            parent_space = space_above(self.target, path, codes, inside=True)
        else:
            if track.follows_placement:
                transforms = self._with_rig(transforms, codes)
            up_rotation = up_from_up(self.target.up, self.up)
            if up_rotation is not None:
                transforms = placed_transforms(
                    transforms, Placement.from_rotation(np.array(up_rotation))
                )
            parent_space = space_above(self.target, path, codes, inside=False)
        if parent_space is not None:
            parent_space[:, :3, 3] *= self.unit(path)
            transforms = _premultiplied_transforms(transforms, parent_space)
        return replace(transforms, rotations=so3.align_signs(transforms.rotations))

    def _with_rig(self, transforms: Transforms, codes: FloatArray) -> Transforms:
        """Return transforms of a take moved with the rig's stage placement."""
        assert self.target is not None
        rig_placement = self.target.placement()
        if rig_placement.uneven:
            # The rig was read without this transform, which its stage applies again.
            return transforms
        placement_matrices = (
            self.target.placement(codes) if rig_placement.rides else rig_placement
        ).fixed
        if self.to_rig is not None:
            placement_matrices = placement_matrices.after(self.to_rig(codes))
        return (
            transforms
            if placement_matrices.simplified().is_identity
            else placed_transforms(transforms, placement_matrices)
        )


def prop_placements(
    paths: RigPaths,
    target: RigTarget | None,
    rig_layer: object,
    meters_per_unit: float,
    up: UpAxis,
    take: str = "",
    to_rig: Callable[[FloatArray], Placement] | None = None,
) -> PropPlacements:
    """Return the placements of a take's tracks.

    Args:
        paths: Prim paths of the character.
        target: Rig below a layer; None for a stage.
        rig_layer: Another layer with the rig, or None.
        meters_per_unit: Unit of the rig [m].
        up: Up axis of the rig.
        take: Name of the take in a library.
        to_rig: See `PropPlacements`.
    """

    def exists(path: str) -> bool:
        if take:
            # Another take may have this prim; only one take is bound at a time.
            return False
        if target is not None:
            return bool(target.stage.GetPrimAtPath(target.on_stage(path)))
        layer: Any = rig_layer
        return layer is not None and layer.GetPrimAtPath(path) is not None

    model = Sdf.Path(paths.model)
    variant = str(model.AppendVariantSelection(TAKE_SET, take)) if take else ""
    return PropPlacements(
        paths.model, meters_per_unit, up, exists, target, to_rig, variant
    )


def space_above(
    target: RigTarget, path: str, codes: FloatArray, *, inside: bool
) -> FloatArray | None:
    """Return the inverse world matrices of a layer path's parent at time codes.

    Relative to the Skeleton's space or, without ``inside``, to the world: column
    vectors in stage units ``(F, 4, 4)``, or one matrix if static; None is the identity.
    """
    # A stage without a target rig needs no conversion.
    from animtool.usd.props.prim_transforms import world_matrices
    from animtool.usd.rigs.placement import fixed_matrices

    stage = target.stage
    parent_path = Sdf.Path(target.on_stage(path)).GetParentPath()
    while not stage.GetPrimAtPath(parent_path):
        parent_path = parent_path.GetParentPath()
    matrices = np.linalg.inv(world_matrices(stage.GetPrimAtPath(parent_path), codes))
    if inside:
        skeleton = stage.GetPrimAtPath(target.on_stage(target.paths.skeleton))
        matrices = fixed_matrices(skeleton, codes.tolist()) @ matrices
    if np.abs(matrices - matrices[:1]).max() <= IDENTITY_TOLERANCE:
        matrices = matrices[:1]
    if np.abs(matrices - np.eye(4)).max() <= IDENTITY_TOLERANCE:
        return None
    return np.ascontiguousarray(matrices.swapaxes(1, 2))


def matrices_inside(
    target: RigTarget,
    to_rig: Callable[[FloatArray], Placement] | None,
    path: str,
    codes: FloatArray,
) -> FloatArray | None:
    """Return the matrices from take space to the parent space of a layer path.

    Column vectors in the unit of the rig ``(F, 4, 4)``; None is the identity.
    """
    parent_space = space_above(target, path, codes, inside=True)
    if to_rig is None:
        return parent_space
    placement, unit = to_rig(codes), target.skeleton.rig.meters_per_unit
    if placement.is_identity:
        return parent_space
    local = np.tile(np.eye(4), (len(placement.sizes), 1, 1))
    local[:, :3, :3] = so3.to_matrix(placement.rotations)
    local[:, :3, :3] *= placement.sizes[:, None, None]
    local[:, :3, 3] = placement.translations / unit
    return local if parent_space is None else parent_space @ local


def _premultiplied_transforms(
    transforms: Transforms, matrices: FloatArray
) -> Transforms:
    """Return transforms multiplied by matrices, as T, R, S if there is no shear."""
    from animtool.usd.rigs.prims import decompose

    translations, rotations, scales = decompose(matrices.swapaxes(1, 2))
    sizes = np.cbrt(np.abs(scales).prod(axis=-1))
    unscaled = np.tile(np.eye(4), (len(matrices), 1, 1))
    unscaled[:, :3, :3] = so3.to_matrix(rotations) * sizes[:, None, None]
    unscaled[:, :3, 3] = translations
    if np.abs(unscaled - matrices).max() <= IDENTITY_TOLERANCE * np.abs(matrices).max():
        return placed_transforms(transforms, Placement(translations, rotations, sizes))
    return transform_by_matrices(transforms, matrices)


def is_within(path: str, ancestor: str) -> bool:
    """Return whether a path equals another, or is below it."""
    return path == ancestor or path.startswith(f"{ancestor}/")
