"""Points of meshes in the world, as a stage shows them and as UsdSkel deforms them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

Array = npt.NDArray[np.float64]


def world_points(stage: Usd.Stage, path: str, codes: list[float]) -> Array:
    """Return authored points of a mesh or curves in the world ``(F, V, 3)``."""
    mesh = UsdGeom.PointBased(stage.GetPrimAtPath(path))
    frames = []
    for code in codes:
        cache = UsdGeom.XformCache(Usd.TimeCode(code))
        world = np.array(cache.GetLocalToWorldTransform(mesh.GetPrim()))
        points = np.array(mesh.GetPointsAttr().Get(code), np.float64)
        frames.append(points @ world[:3, :3] + world[3, :3])
    return np.array(frames)


def skinned_points(path: Path, codes: list[float]) -> dict[str, Array]:
    """Return what UsdSkel bakes of a stage, by the paths of meshes and curves."""
    stage = Usd.Stage.Open(Usd.Stage.Open(str(path)).Flatten())
    roots = [p for p in stage.Traverse() if p.IsA(UsdSkel.Root)]
    assert roots
    interval = Gf.Interval(min(codes), max(codes))
    for root in roots:
        assert UsdSkel.BakeSkinning(UsdSkel.Root(root), interval)
    return {
        str(p.GetPath()): world_points(stage, str(p.GetPath()), codes)
        for p in stage.Traverse()
        if p.IsA(UsdGeom.Mesh) or p.IsA(UsdGeom.BasisCurves)
    }


def layered(folder: Path, *layers: Path) -> Path:
    """Return a shot of layers, the strongest first."""
    path = folder / f"shot_{layers[0].stem}.usda"
    shot = Sdf.Layer.CreateNew(str(path))
    shot.subLayerPaths = [str(layer) for layer in layers]
    strongest = Sdf.Layer.FindOrOpen(str(layers[0]))
    for key in ("timeCodesPerSecond", "framesPerSecond", "defaultPrim"):
        setattr(shot, key, getattr(strongest, key))
    for key in ("metersPerUnit", "upAxis"):
        shot.pseudoRoot.SetInfo(key, strongest.pseudoRoot.GetInfo(key))
    shot.startTimeCode = strongest.startTimeCode
    shot.endTimeCode = strongest.endTimeCode
    shot.Save()
    return path


def bindings(stage: Usd.Stage) -> list[str]:
    """Return the prims that UsdSkel would deform."""
    found = []
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            cache, root = UsdSkel.Cache(), UsdSkel.Root(prim)
            cache.Populate(root, Usd.PrimDefaultPredicate)
            for bound in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
                found += [
                    str(q.GetPrim().GetPath()) for q in bound.GetSkinningTargets()
                ]
    return found
