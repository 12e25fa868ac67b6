"""A mesh of a USD file, for what needs its points and faces alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, excerpt
from animtool.maths import so3
from animtool.units import UpAxis, up_from_up
from animtool.usd.layers import usd_errors
from animtool.usd.prims import find_prim, nearest_prim
from animtool.usd.rig_prims import (
    open_stage,
    up_axis,
)
from animtool.usd.values import integers, numbers


@dataclass(frozen=True, slots=True)
class StillMesh:
    """Points and faces in the world.

    Attributes:
        points: ``(N, 3)`` [m].
        counts: Corners of each face ``(M,)``.
        indices: Corners, face by face.
    """

    points: FloatArray
    counts: IntArray
    indices: IntArray


def read_still_mesh(path: Path, prim: str, up: UpAxis) -> StillMesh:
    """Return a mesh as it is at the earliest time that its file has.

    Args:
        path: The USD file.
        prim: Path of the prim.
        up: Up axis of the world.

    Raises:
        FormatError: The file is no USD.
        OptionError: It has no such mesh, or the mesh makes no sense (SIM051).
    """
    return open_mesh(path, prim, up).at(None)


class MeshSource:
    """A mesh of a stage that is open.

    Attributes:
        fps: Time codes a second.
        span: First and last time code at which it is told to move, in shape or place;
            None where it never does.

    Args:
        stage: The stage.
        prim: Of the mesh.
        up: Up axis of the world.
    """

    def __init__(self, stage: Any, prim: Any, up: UpAxis) -> None:
        # A prim lives no longer than its stage.
        self._stage, self._mesh = stage, UsdGeom.Mesh(prim)
        self._unit = UsdGeom.GetStageMetersPerUnit(stage)
        self._turn = up_from_up(up, up_axis(stage))
        self.fps = float(stage.GetTimeCodesPerSecond())
        times = set(self._mesh.GetPointsAttr().GetTimeSamples())
        while prim and not prim.IsPseudoRoot():
            if UsdGeom.Xformable(prim):
                times |= set(UsdGeom.Xformable(prim).GetTimeSamples())
            prim = prim.GetParent()
        self.span: tuple[float, float] | None = None
        if times:
            self.span = float(min(times)), float(max(times))

    def at(self, code: float | None) -> StillMesh:
        """Return it at a time code; None is the earliest that there is.

        Raises:
            OptionError: It makes no sense (SIM051).
        """
        time = Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)
        mesh = self._mesh
        points = numbers(mesh.GetPointsAttr(), 3, time)
        counts = integers(mesh.GetFaceVertexCountsAttr(), time)
        indices = integers(mesh.GetFaceVertexIndicesAttr(), time)
        world = np.array(mesh.ComputeLocalToWorldTransform(time), np.float64)
        _check(points, counts, indices, str(mesh.GetPath()))
        placed = (points @ world[:3, :3] + world[3, :3]) * self._unit
        if self._turn is not None:
            placed = so3.rotate(np.array(self._turn), placed)
        return StillMesh(np.asarray(placed, np.float64), counts, indices)


def open_mesh(path: Path, prim: str, up: UpAxis) -> MeshSource:
    """Return a mesh that can be looked at over time.

    Args:
        path: The USD file.
        prim: Path of the prim.
        up: Up axis of the world.

    Raises:
        FormatError: The file is no USD.
        OptionError: It has no such mesh (SIM051).
    """
    with usd_errors(path):
        stage = open_stage(path)
        found = find_prim(stage, prim)
        if found is None or not found.IsA(UsdGeom.Mesh):
            what = "no prim" if found is None else "no mesh"
            hint = nearest_prim(stage, prim) if found is None else None
            message = f"{path.name} holds {what} {excerpt(prim)}"
            raise OptionError(Fault("SIM051", message, hint=hint))
        return MeshSource(stage, found, up)


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
