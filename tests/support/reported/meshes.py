"""Checks of skinned meshes, as UsdSkel skins them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Usd, UsdGeom, UsdSkel

from support.reported.outcome import Outcome, require
from support.reported.stages import ClockedStage, open_clocked, sample_codes

Floats = npt.NDArray[np.float64]


def _skinned(clocked: ClockedStage, codes: Floats) -> ClockedStage:
    """Return a copy of a stage whose meshes have their skinned points."""
    stage = Usd.Stage.Open(clocked.stage.Flatten())
    for root in [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]:
        interval = Gf.Interval(float(codes.min()), float(codes.max()))
        done = UsdSkel.BakeSkinning(UsdSkel.Root(root), interval)
        require(done, f"{root.GetPath()} cannot be skinned")
    return ClockedStage(stage, clocked.codes, clocked.fps)


def mesh_bounds_m(
    outcome: Outcome,
    *,
    mesh: str,
    time: float,
    value: Any,
    tolerance: float,
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require the least and the most of each axis of a mesh, skinned, in the world."""
    rig = None if over is None else outcome.file(over)
    clocked = open_clocked(outcome.file(of), rig)
    inside = clocked.codes[0] <= time <= clocked.codes[-1]
    require(inside, f"no frame {time} in {clocked.codes[0]:g} to {clocked.codes[-1]:g}")
    skinned = _skinned(clocked, np.array([time]))
    meshes = skinned.prims(UsdGeom.Mesh, mesh)
    every = [prim.GetName() for prim in skinned.prims(UsdGeom.Mesh)]
    require(len(meshes) == 1, f"{len(meshes)} meshes {mesh!r} among {every}")
    local = UsdGeom.Mesh(meshes[0]).GetPointsAttr().Get(time)
    require(local, f"{mesh} has no points at {time}")
    points = skinned.points(np.array(local), meshes[0], time)
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    off = float(np.abs(bounds - np.asarray(value, float)).max())
    require(off <= tolerance, f"{np.round(bounds, 5).tolist()}, off by {off:.3g} m")


def extents_hold(outcome: Outcome, *, max: float, of: str | None = None) -> None:
    """Require that skinned points are within the extents of their SkelRoots [m]."""
    clocked = open_clocked(outcome.file(of))
    samples = np.array(sample_codes(clocked.stage))
    codes = np.unique(np.concatenate([clocked.codes, samples]))
    skinned = _skinned(clocked, codes)
    roots = clocked.prims(UsdSkel.Root)
    require(roots, "there is no SkelRoot")
    seen = 0
    for root in roots:
        attribute = UsdGeom.Boundable(root).GetExtentAttr()
        require(attribute.HasAuthoredValue(), f"{root.GetPath()} has no extent")
        bare = skinned.stage.GetPrimAtPath(root.GetPath())
        for prim in Usd.PrimRange(bare):
            if not prim.IsA(UsdGeom.PointBased):
                continue
            for code in codes:
                local = UsdGeom.PointBased(prim).GetPointsAttr().Get(code)
                require(local, f"{prim.GetPath()} has no points at {code:g}")
                extent = np.array(attribute.Get(code), float)
                over = _overhang(np.array(local, float), prim, bare, extent, code)
                text = f"a point is {over:.4g} m out of the extent at {code:g}"
                require(over <= max, text)
                seen += 1
    require(seen, "no SkelRoot holds points")


def _overhang(
    points: Floats, prim: Any, root: Any, extent: Floats, code: float
) -> float:
    """Return how far the points of a prim are out of an extent of another [m]."""
    cache = UsdGeom.XformCache(float(code))
    matrix, _ = cache.ComputeRelativeTransform(prim, root)
    place = np.array(matrix)
    inside = points @ place[:3, :3] + place[3, :3]
    over = np.maximum(np.maximum(extent[0] - inside, inside - extent[1]), 0.0)
    world = over @ np.array(cache.GetLocalToWorldTransform(root))[:3, :3]
    unit = UsdGeom.GetStageMetersPerUnit(root.GetStage())
    return float(np.linalg.norm(world, axis=1).max() * unit)


CHECKS = {
    "extents_hold": extents_hold,
    "mesh_bounds_m": mesh_bounds_m,
}
