"""Where props are written: in a character's space, or in the stage's world."""

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
from animtool.motion.transforms import Track, Transforms, below_matrices, placed
from animtool.rig.placement import IDENTITY_TOLERANCE, Placement
from animtool.usd.layers.names import TAKE_SET, RigPaths

if TYPE_CHECKING:
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class PropPlacements:
    """Prim paths and spaces of the props of a take."""

    model: str  # the prim of the character
    meters_per_unit: float  # unit of the rig [m]
    up: UpAxis  # up axis of the rig, and of the take
    exists: Callable[[str], bool]  # whether something else has a prim at a path
    target: RigTarget | None = None  # the rig of a layer
    # From where the take is to the numbers of that rig, at time codes; None: the same.
    to_rig: Callable[[FloatArray], Placement] | None = None
    variant: str = ""  # the model in the variant of a take; empty where there is none

    def unit(self, path: str) -> float:
        """Return the length unit at a prim path [m]."""
        if self.target is None or within(path, self.model):
            return self.meters_per_unit
        return self.target.unit

    def spec(self, path: str) -> str:
        """Return the layer path of a stage prim."""
        if not self.variant:
            return path
        return str(Sdf.Path(path).ReplacePrefix(self.model, self.variant))

    def located(
        self, track: Track, path: str, codes: FloatArray, known: Transforms
    ) -> Transforms:
        """Return a track at time codes ``(F,)``, in the space of its parent prim."""
        if self.target is None or not track.placed:
            return known
        if within(path, self.model):
            if self.to_rig is not None:
                known = placed(known, self.to_rig(codes))
            above = space_above(self.target, path, codes, inside=True)
        else:
            if track.follows_placement:
                known = self._with_rig(known, codes)
            up_rotation = up_from_up(self.target.up, self.up)
            if up_rotation is not None:
                known = placed(known, Placement.from_rotation(np.array(up_rotation)))
            above = space_above(self.target, path, codes, inside=False)
        if above is not None:
            above[:, :3, 3] *= self.unit(path)
            known = _below(known, above)
        return replace(known, rotations=so3.align_signs(known.rotations))

    def _with_rig(self, known: Transforms, codes: FloatArray) -> Transforms:
        """Return transforms of a take moved with the rig's stage placement."""
        assert self.target is not None
        rig_placement = self.target.placement()
        if rig_placement.uneven:
            # It is read without such a transform, which the rig applies again.
            return known
        fixed = (
            self.target.placement(codes) if rig_placement.rides else rig_placement
        ).fixed
        if self.to_rig is not None:
            fixed = fixed.after(self.to_rig(codes))
        return known if fixed.steady().is_none else placed(known, fixed)


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

    rig_layer: another layer that holds the rig, or None;
    meters_per_unit: unit of the rig [m]; to_rig: see `PropPlacements`.
    """

    def exists(path: str) -> bool:
        if take:
            # Another take may have it, which is not bound at the same time.
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

    From the Skeleton's space, or with ``inside`` off from the world: column vectors in
    the numbers of the stage ``(F, 4, 4)``, one where nothing moves; None is the same.
    """
    # Stages that are no layers need nothing of them.
    from animtool.usd.props.prim_transforms import world_matrices
    from animtool.usd.rigs.placement import fixed_matrices

    stage = target.stage
    above = Sdf.Path(target.on_stage(path)).GetParentPath()
    while not stage.GetPrimAtPath(above):
        above = above.GetParentPath()
    matrices = np.linalg.inv(world_matrices(stage.GetPrimAtPath(above), codes))
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

    Column vectors in the unit of the rig ``(F, 4, 4)``; None is the same.
    """
    above = space_above(target, path, codes, inside=True)
    if to_rig is None:
        return above
    placement, unit = to_rig(codes), target.skeleton.rig.meters_per_unit
    if placement.is_none:
        return above
    local = np.tile(np.eye(4), (len(placement.sizes), 1, 1))
    local[:, :3, :3] = so3.to_matrix(placement.rotations)
    local[:, :3, :3] *= placement.sizes[:, None, None]
    local[:, :3, 3] = placement.translations / unit
    return local if above is None else above @ local


def _below(known: Transforms, matrices: FloatArray) -> Transforms:
    """Return transforms after matrices, as T, R, S if these only move and scale."""
    from animtool.usd.rigs.prims import decompose

    translations, rotations, scales = decompose(matrices.swapaxes(1, 2))
    sizes = np.cbrt(np.abs(scales).prod(axis=-1))
    even = np.tile(np.eye(4), (len(matrices), 1, 1))
    even[:, :3, :3] = so3.to_matrix(rotations) * sizes[:, None, None]
    even[:, :3, 3] = translations
    if np.abs(even - matrices).max() <= IDENTITY_TOLERANCE * np.abs(matrices).max():
        return placed(known, Placement(translations, rotations, sizes))
    return below_matrices(known, matrices)


def within(path: str, above: str) -> bool:
    """Return whether a path equals another, or is below it."""
    return path == above or path.startswith(f"{above}/")
