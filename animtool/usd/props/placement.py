"""Where props are written: below a character in its space, or in a stage's world."""

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
from animtool.rig.placement import SAME, Placement
from animtool.usd.layers.names import TAKE_SET, RigPaths

if TYPE_CHECKING:
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class PropPlacements:
    """Where things are to be written."""

    model: str  # the prim of the character
    meters_per_unit: float  # unit of the rig [m]
    up: UpAxis  # up axis of the rig, and of the take
    exists: Callable[[str], bool]  # whether something else has a prim at a path
    target: RigTarget | None = None  # the rig of a layer
    # From where the take is to the numbers of that rig, at time codes; None: the same.
    to_rig: Callable[[FloatArray], Placement] | None = None
    variant: str = ""  # the model in the variant of a take; empty where there is none

    def unit(self, path: str) -> float:
        """Return the length unit of what is at a path [m]."""
        if self.target is None or within(path, self.model):
            return self.meters_per_unit
        return self.target.unit

    def spec(self, path: str) -> str:
        """Return where a layer has a prim of the stage."""
        if not self.variant:
            return path
        return str(Sdf.Path(path).ReplacePrefix(self.model, self.variant))

    def located(
        self, track: Track, path: str, codes: FloatArray, known: Transforms
    ) -> Transforms:
        """Return a track at time codes ``(F,)``, in the space of the prim above it."""
        if self.target is None or not track.placed:
            return known
        if within(path, self.model):
            if self.to_rig is not None:
                known = placed(known, self.to_rig(codes))
            above = space_above(self.target, path, codes, inside=True)
        else:
            if track.along:
                known = self._with_rig(known, codes)
            turn = up_from_up(self.target.up, self.up)
            if turn is not None:
                known = placed(known, Placement.from_rotation(np.array(turn)))
            above = space_above(self.target, path, codes, inside=False)
        if above is not None:
            above[:, :3, 3] *= self.unit(path)
            known = _below(known, above)
        return replace(known, rotations=so3.align_signs(known.rotations))

    def _with_rig(self, known: Transforms, codes: FloatArray) -> Transforms:
        """Return what goes along with a take, where the rig's stage has that."""
        assert self.target is not None
        own = self.target.placement()
        if own.uneven:
            # It is read without such a transform, and the rig has it again.
            return known
        fixed = (self.target.placement(codes) if own.rides else own).fixed
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
    """Return where a take's tracks go.

    rig_layer: another layer that holds the rig; None where there is none;
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
    """Return the way to the prim above a path of a layer, at time codes ``(F,)``.

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
    way = np.linalg.inv(world_matrices(stage.GetPrimAtPath(above), codes))
    if inside:
        skeleton = stage.GetPrimAtPath(target.on_stage(target.paths.skeleton))
        way = fixed_matrices(skeleton, codes.tolist()) @ way
    if np.abs(way - way[:1]).max() <= SAME:
        way = way[:1]
    if np.abs(way - np.eye(4)).max() <= SAME:
        return None
    return np.ascontiguousarray(way.swapaxes(1, 2))


def way_inside(
    target: RigTarget,
    to_rig: Callable[[FloatArray], Placement] | None,
    path: str,
    codes: FloatArray,
) -> FloatArray | None:
    """Return the way from where a take is to the prim above a path of its layer.

    Column vectors in the unit of the rig ``(F, 4, 4)``; None is the same.
    """
    way = space_above(target, path, codes, inside=True)
    if to_rig is None:
        return way
    placement, unit = to_rig(codes), target.skeleton.rig.meters_per_unit
    if placement.is_none:
        return way
    own = np.tile(np.eye(4), (len(placement.sizes), 1, 1))
    own[:, :3, :3] = so3.to_matrix(placement.rotations)
    own[:, :3, :3] *= placement.sizes[:, None, None]
    own[:, :3, 3] = placement.translations / unit
    return own if way is None else way @ own


def _below(known: Transforms, matrices: FloatArray) -> Transforms:
    """Return transforms after matrices, in parts where these only move and scale."""
    from animtool.usd.rigs.prims import decompose

    translations, rotations, scales = decompose(matrices.swapaxes(1, 2))
    sizes = np.cbrt(np.abs(scales).prod(axis=-1))
    even = np.tile(np.eye(4), (len(matrices), 1, 1))
    even[:, :3, :3] = so3.to_matrix(rotations) * sizes[:, None, None]
    even[:, :3, 3] = translations
    if np.abs(even - matrices).max() <= SAME * np.abs(matrices).max():
        return placed(known, Placement(translations, rotations, sizes))
    return below_matrices(known, matrices)


def within(path: str, above: str) -> bool:
    """Return whether a path is another, or below it."""
    return path == above or path.startswith(f"{above}/")
