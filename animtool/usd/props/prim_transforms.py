"""Reads world transforms of a stage prim over time, for goals of a rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.units import up_from_up
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.rigs.prims import (
    decompose,
    find_prim,
    nearest_prim,
    open_stage,
    up_axis,
)


def prim_transform_reader(
    path: Path, prim_path: str, rig: Rig, space_path: str | None = None
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Return a function that reads a prim's world transforms, in the rig's axes.

    Units and up axis of the stage are converted to the rig's; second 0 is time code 0.
    Scales of the prim are ignored.

    Args:
        path: The stage.
        prim_path: Path of the prim.
        rig: The rig.
        space_path: Path of a prim whose local space is the rig's; None is the world.

    Returns:
        A function from seconds ``(F,)`` to positions ``(F, 3)`` [m] and rotations
        ``(F, 4)``; it raises `FormatError` if a transform is not finite.
    """
    with usd_errors(path):
        stage = open_stage(path)
        usd_prim = _require_prim(stage, path, prim_path)
        space_prim = None
        if space_path is not None:
            space_prim = _require_prim(stage, path, space_path, "space")
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    up_rotation = up_from_up(rig.up, up_axis(stage))
    if space_prim is not None:
        unit, up_rotation = rig.meters_per_unit, None

    def transforms(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        # This reference keeps the stage and its prims alive as long as the function.
        codes = seconds * stage.GetTimeCodesPerSecond()
        with usd_errors(path):
            matrices = world_matrices(usd_prim, codes, space_prim)
        if not np.isfinite(matrices).all():
            message = "its transform is not finite"
            PrimLocation(str(path), prim_path).fail("USD171", message)
        positions, rotations, _ = decompose(matrices)
        positions = positions * unit
        if up_rotation is not None:
            positions = so3.rotate(up_rotation, positions)
            rotations = so3.multiply(up_rotation, rotations)
        return positions, so3.align_signs(rotations)

    return transforms


def world_matrices(prim: Any, codes: FloatArray, relative_to: Any = None) -> FloatArray:
    """Return a prim's matrices ``(F, 4, 4)``, world or relative to another prim."""
    cache = UsdGeom.XformCache()
    matrices = []
    for code in codes.tolist():
        cache.SetTime(Usd.TimeCode(code))
        matrix = cache.GetLocalToWorldTransform(prim)
        if relative_to is not None:
            matrix = matrix * cache.GetLocalToWorldTransform(relative_to).GetInverse()
        matrices.append(matrix)
    return np.array(matrices, np.float64).reshape(-1, 4, 4)


def _require_prim(
    stage: Any, path: Path, name: str, fault_location: str | None = None
) -> Any:
    """Return a prim; raise `FormatError` at ``fault_location`` if it is missing."""
    prim = find_prim(stage, name)
    if prim:
        return prim
    raise FormatError(
        Fault(
            "USD034",
            f"has no prim {excerpt(name)}",
            str(path),
            hint=nearest_prim(stage, name),
            where=fault_location,
        )
    )
