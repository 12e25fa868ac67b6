"""Detects meshes in another unit than the joints that move them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.errors import Fault, warning
from animtool.rig.skeleton import Rig

if TYPE_CHECKING:
    from animtool.rig.surfaces import Surface

# Ratio of the sizes of a mesh and its skeleton that no character has [1].
MAX_SIZE_RATIO = 30.0
# Factors of units that are confused most, and ratios of the sizes in the right one [1].
UNIT_FACTORS, FITTING_RATIOS = (100.0, 1000.0), (0.2, 3.0)
# With fewer joints, a rig is a prop that may be anywhere in a large mesh.
MIN_SKELETON_JOINTS = 3


def mesh_size_texts(
    sizes: Mapping[str, float], rig_size: float
) -> tuple[str, str, str] | None:
    """Return name, message and hint about the largest mesh if its unit is another.

    ``sizes`` are those of skinned meshes by name, ``rig_size`` is that of the joints at
    rest [m]. Smaller meshes, such as eyes, are not compared.
    """
    name = max(sizes, key=sizes.__getitem__, default="")
    size = sizes.get(name, 0.0)
    if not size or not rig_size:
        return None
    ratio = size / rig_size
    if 1.0 / MAX_SIZE_RATIO <= ratio <= MAX_SIZE_RATIO:
        return None
    message = f"{name!r} is {size:.3g} m across, but the joints at rest span "
    message += f"{rig_size:.3g} m"
    hint = "write points in the file's unit, like the joints, or add geom_bind"
    for factor in UNIT_FACTORS:
        if FITTING_RATIOS[0] <= ratio / factor <= FITTING_RATIOS[1]:
            hint = f"divide its points by {factor:g}: {hint}"
            break
    return name, message, hint


def mesh_size_warnings(rig: Rig, surfaces: Sequence[Surface]) -> list[Fault]:
    """Return a warning if a skinned mesh of a rig is in another unit (RIG218)."""
    from animtool.rig.kinematics import rest_size  # loads the kernels

    if len(rig.joints) < MIN_SKELETON_JOINTS:
        return []
    sizes = {
        surface.name: float(np.linalg.norm(np.ptp(surface.points, axis=0)))
        for surface in surfaces
        if surface.skin is not None
        and len(surface.points)
        and np.array_equal(surface.geom_bind, np.eye(4))
    }
    texts = mesh_size_texts(sizes, rest_size(rig))
    return [] if texts is None else [warning("RIG218", *texts[1:])]
