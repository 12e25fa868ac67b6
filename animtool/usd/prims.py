"""Where a prim of a stage is, over time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, excerpt
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.similar import similar
from animtool.units import up_from_up
from animtool.usd.layers import usd_errors
from animtool.usd.rig_prims import decompose, open_stage, up_axis

# Whose names are compared with one that there is not.
MAX_COMPARED = 20_000


def open_prim(
    path: Path, prim: str, rig: Rig, space: str | None = None
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Return a prim's transforms over time, in the world of a rig.

    Units and up axis of the stage are converted to the rig's; second 0 is time code
    0. Scales of the prim are left out.

    Args:
        path: The USD file.
        prim: Path of the prim.
        rig: Whose world it is.
        space: Path of a prim in whose frame the rig stands, its numbers being the
            rig's own; None is the world.

    Returns:
        A function from seconds ``(F,)`` to positions ``(F, 3)`` [m] and rotations
        ``(F, 4)``; it raises `FormatError` where a transform is not finite.

    Raises:
        FormatError: It is no USD file, or holds no such prim (USD034); the fault of a
            ``space`` says so in its ``where``.
    """
    with usd_errors(path):
        stage = open_stage(path)
        found = _prim(stage, path, prim)
        above = None if space is None else _prim(stage, path, space, "space")
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    turn = up_from_up(rig.up, up_axis(stage))
    if above is not None:
        unit, turn = rig.meters_per_unit, None

    def transforms(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        # Named here, the stage lives as long as the function, and its prims with it.
        codes = seconds * stage.GetTimeCodesPerSecond()
        with usd_errors(path):
            matrices = _matrices(found, above, codes)
        if not np.isfinite(matrices).all():
            message = "its transform is not finite"
            raise FormatError(Fault("USD014", message, f"{path}<{prim}>"))
        positions, rotations, _ = decompose(matrices)
        positions = positions * unit
        if turn is not None:
            positions = so3.rotate(turn, positions)
            rotations = so3.multiply(turn, rotations)
        return positions, so3.align_signs(rotations)

    return transforms


def _matrices(prim: Any, above: Any, codes: FloatArray) -> FloatArray:
    """Return the prim's transforms, relative to another if given ``(F, 4, 4)``."""
    cache = UsdGeom.XformCache()
    matrices = []
    for code in codes.tolist():
        cache.SetTime(Usd.TimeCode(code))
        world = cache.GetLocalToWorldTransform(prim)
        if above is not None:
            world = world * cache.GetLocalToWorldTransform(above).GetInverse()
        matrices.append(world)
    return np.array(matrices, np.float64).reshape(-1, 4, 4)


def _prim(stage: Any, path: Path, name: str, where: str | None = None) -> Any:
    """Return a prim, or say that there is none, ``where`` it was named."""
    found = find_prim(stage, name)
    if found:
        return found
    raise FormatError(
        Fault(
            "USD034",
            f"holds no prim {excerpt(name)}",
            str(path),
            hint=nearest_prim(stage, name),
            where=where,
        )
    )


def find_prim(stage: Any, name: str) -> Any:
    """Return the prim at an absolute path; None where there is none."""
    valid = Sdf.Path.IsValidPathString(name) and Sdf.Path(name).IsAbsolutePath()
    return (stage.GetPrimAtPath(name) or None) if valid else None


def nearest_prim(stage: Any, name: str) -> str | None:
    """Return a hint that names the prim whose path is most like one."""
    all_of_them = islice(stage.Traverse(), MAX_COMPARED)
    names = [str(prim.GetPath()) for prim in all_of_them]
    near = similar(name, names)
    return f"did you mean {near}?" if near else None
