"""Where a written animation puts the joints when USD plays it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray
from animtool.rig.kinematics import WorldTransforms


def played_world(path: Path, codes: FloatArray) -> WorldTransforms:
    """Return the world transforms of the first skeleton of a stage, by UsdSkel.

    Args:
        path: A stage with a skeleton.
        codes: Time codes, between samples too ``(F,)``.
    """
    stage = Usd.Stage.Open(str(path))
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
    root = UsdSkel.Root.Find(prim)
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
    joints = len(query.GetJointOrder())
    local = np.zeros((len(codes), joints, 4, 4))
    placed = np.zeros((len(codes), 1, 4, 4))
    # UsdSkel evaluates one time at a time.
    for i, code in enumerate(codes.tolist()):
        when = Usd.TimeCode(code)
        local[i] = query.ComputeJointSkelTransforms(when)
        placed[i] = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(when)
    # Rows of USD's matrices are columns of ours.
    world = np.swapaxes(local @ placed, -1, -2)
    positions = world[..., :3, 3] * UsdGeom.GetStageMetersPerUnit(stage)
    return WorldTransforms(
        np.ascontiguousarray(positions), np.ascontiguousarray(world[..., :3, :3])
    )
