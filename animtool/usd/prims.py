"""Where a prim of a stage is, over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, FormatError, OptionError, excerpt
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.similar import similar
from animtool.units import UpAxis, up_from_up
from animtool.usd.faults import Spot
from animtool.usd.layers import usd_errors
from animtool.usd.point_reader import PointReader, transformed
from animtool.usd.rig_prims import decompose, open_stage, up_axis, upwards

# Whose names are compared with one that there is not.
MAX_COMPARED = 20_000


def open_prim(
    path: Path, prim: str, rig: Rig, space: str | None = None
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Return a prim's transforms over time, in the world of a rig.

    Units and up axis of the stage are converted to the rig's; second 0 is time code
    0. Scales of the prim are left out.

    space: path of a prim in whose frame the rig stands, its numbers being the rig's
    own; None is the world.

    Returns A function from seconds ``(F,)`` to positions ``(F, 3)`` [m] and rotations
    ``(F, 4)``; it raises `FormatError` where a transform is not finite.
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
            Spot(str(path), prim).fail("USD171", message)
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
    prim = find_prim(stage, name)
    if prim:
        return prim
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


@dataclass(frozen=True, slots=True)
class StillMesh:
    """Points and faces in the world."""

    points: FloatArray  # ``(N, 3)`` [m]
    counts: IntArray  # corners of each face ``(M,)``
    indices: IntArray  # corners, face by face


def read_still_mesh(path: Path, prim: str, up: UpAxis) -> StillMesh:
    """Return a mesh as it is at the earliest time that its file has."""
    return open_mesh(path, prim, up).at(None)


class MeshSource:
    """A mesh of a stage that is open.

    span: first and last time code at which it is told to move, in shape or place; None
    where it never does.
    """

    def __init__(self, stage: Any, prim: Any, up: UpAxis) -> None:
        # A prim lives no longer than its stage.
        self._stage, self._reader = stage, PointReader(prim)
        self._unit = UsdGeom.GetStageMetersPerUnit(stage)
        self._turn = up_from_up(up, up_axis(stage))
        self.fps = float(stage.GetTimeCodesPerSecond())
        times = set(self._reader.times)
        for one in filter(UsdGeom.Xformable, upwards(prim)):
            times |= set(UsdGeom.Xformable(one).GetTimeSamples())
        self.span: tuple[float, float] | None = None
        if times:
            self.span = float(min(times)), float(max(times))

    def at(self, code: float | None) -> StillMesh:
        """Return it at a time code; None is the earliest that there is.

        Raises:
            OptionError: It makes no sense (SIM051).
        """
        time = Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)
        points, (counts, indices) = self._reader.at(time), self._reader.faces(time)
        _check(points, counts, indices, str(self._reader.prim.GetPath()))
        world = self._reader.world_from_prim(time)
        placed = transformed(points, world) * self._unit
        if self._turn is not None:
            placed = so3.rotate(np.array(self._turn), placed)
        return StillMesh(np.asarray(placed, np.float64), counts, indices)


def open_mesh(path: Path, prim: str, up: UpAxis) -> MeshSource:
    """Return a mesh that can be looked at over time."""
    with usd_errors(path):
        stage = open_stage(path)
        mesh = find_prim(stage, prim)
        if mesh is None or not mesh.IsA(UsdGeom.Mesh):
            what = "no prim" if mesh is None else "no mesh"
            hint = nearest_prim(stage, prim) if mesh is None else None
            message = f"{path.name} holds {what} {excerpt(prim)}"
            raise OptionError(Fault("SIM051", message, hint=hint))
        return MeshSource(stage, mesh, up)


def _check(points: FloatArray, counts: IntArray, indices: IntArray, prim: str) -> None:
    message = ""
    if not len(points) or not len(counts):
        message = "has no points or no faces"
    elif not np.isfinite(points).all():
        message = "has a point that is not finite"
    elif (counts < 3).any():
        message = f"has a face of {counts.min()} corners"
    elif counts.sum() != len(indices):
        message = f"has {len(indices)} corners, and its faces {counts.sum()}"
    elif indices.min() < 0 or indices.max() >= len(points):
        message = f"has a corner that is none of its {len(points)} points"
    if message:
        raise OptionError(Fault("SIM051", f"{prim} {message}"))
