"""The motion of what stands above a Skeleton, given to its root joints."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, Severity
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.usd.rig_prims import decompose

UNIT_SCALE_TOLERANCE = 1e-6


def moving_carriers(skeleton: Any) -> list[Any]:
    """Return the prims from the SkelRoot to the Skeleton, if one of them moves."""
    chain: list[Any] = []
    prim = skeleton
    while prim and prim.GetPath().pathElementCount:
        chain.append(UsdGeom.Xformable(prim))
        if prim.IsA(UsdSkel.Root):
            break
        prim = prim.GetParent()
    moves = any(mover and mover.TransformMightBeTimeVarying() for mover in chain)
    return [mover for mover in chain if mover] if moves else []


def _carriers(skeleton: Any, codes: list[float]) -> FloatArray:
    """Return the Skeleton's transforms above its SkelRoot's parent ``(F, 4, 4)``."""
    above = UsdSkel.Root.Find(skeleton).GetPrim().GetParent()
    matrices = []
    for code in codes:
        cache = UsdGeom.XformCache(Usd.TimeCode(code))
        world = cache.GetLocalToWorldTransform(skeleton)
        matrices.append(world * cache.GetLocalToWorldTransform(above).GetInverse())
    return np.array(matrices)


def carry_roots(
    rig: Rig,
    skeleton: Any,
    codes: list[float],
    translations: FloatArray,
    rotations: FloatArray,
    scales: FloatArray,
    where: str,
) -> list[Fault]:
    """Give the roots the motion of what carries them, in place.

    Args:
        rig: J joints.
        skeleton: The Skeleton's prim, below a SkelRoot.
        codes: F time codes.
        translations: Of the joints, local ``(F, J, 3)`` [m].
        rotations: Of the joints, local ``(F, J, 4)``.
        scales: Of the joints ``(F, J, 3)``.
        where: The animation, for messages.

    Returns:
        A warning where what it finds cannot be put into joints exactly (USD109).

    Raises:
        FormatError: A transform is not finite (USD014).
    """
    matrices = _carriers(skeleton, codes)
    if not np.isfinite(matrices).all():
        raise FormatError(
            Fault("USD014", "the SkelRoot's transform is not finite", where)
        )
    moves, turns, sizes = decompose(matrices)
    for root in rig.roots:
        sized = sizes * translations[:, root]
        translations[:, root] = so3.rotate(turns, sized) + moves * rig.meters_per_unit
        rotations[:, root] = so3.multiply(turns, rotations[:, root])
        scales[:, root] *= sizes
    rotations[:] = so3.align_signs(rotations)
    # Rounding of the matrices is no scale.
    near = np.abs(scales - 1.0) < UNIT_SCALE_TOLERANCE
    scales[near] = 1.0
    if np.ptp(sizes, axis=-1).max() <= UNIT_SCALE_TOLERANCE:
        return []
    message = "the SkelRoot is scaled by different factors along its axes"
    hint = "joints that turn under it are not read exactly"
    return [Fault("USD109", message, where, (), hint, Severity.WARNING)]
