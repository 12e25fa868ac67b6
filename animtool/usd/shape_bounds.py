"""Bounds of meshes that blend shapes alone move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import Float32Array, FloatArray


def shape_bounds(
    root: Any, shapes: Sequence[str], weights: Sequence[Float32Array]
) -> Float32Array | None:
    """Return bounds ``(2, 3)`` of all frames in the space of a SkelRoot.

    Args:
        root: The SkelRoot's prim.
        shapes: Names of S shapes.
        weights: Their weights ``(F, S)``, one array a block.

    Returns:
        None where there is no mesh with points.
    """
    largest = np.zeros(len(shapes))
    for rows in weights:
        largest = np.maximum(largest, np.abs(rows).max(axis=0, initial=0.0))
    reach = dict(zip(shapes, largest.tolist(), strict=True))
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    lows: list[FloatArray] = []
    highs: list[FloatArray] = []
    for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
        points = (
            UsdGeom.Mesh(prim).GetPointsAttr().Get() if prim.IsA(UsdGeom.Mesh) else ()
        )
        if not points:
            continue
        own, _ = cache.ComputeRelativeTransform(prim, root)
        matrix = np.array(own, np.float64)
        placed = np.array(points, np.float64) @ matrix[:3, :3] + matrix[3, :3]
        pad = _padding(prim, reach) * float(np.linalg.norm(matrix[:3, :3], 2))
        lows.append(placed.min(axis=0) - pad)
        highs.append(placed.max(axis=0) + pad)
    if not lows:
        return None
    bounds = np.array([np.min(lows, axis=0), np.max(highs, axis=0)])
    # Outwards, so that rounding leaves no point outside.
    outside = np.array([[-np.inf], [np.inf]], np.float32)
    return np.asarray(np.nextafter(bounds.astype(np.float32), outside), np.float32)


def _padding(prim: Any, reach: dict[str, float]) -> float:
    """Return how far shapes move a point of a mesh at most."""
    binding = UsdSkel.BindingAPI(prim)
    names = binding.GetBlendShapesAttr().Get() or ()
    targets = binding.GetBlendShapeTargetsRel().GetTargets()
    stage, pad = prim.GetStage(), 0.0
    for name, target in zip(names, targets, strict=False):
        weight = reach.get(str(name), 0.0)
        shape = UsdSkel.BlendShape(stage.GetPrimAtPath(target))
        if not weight or not shape:
            continue
        steps = [step.GetAttr() for step in shape.GetInbetweens()]
        if steps:
            # On the way to an inbetween, a small weight may move points as far as it.
            weight = max(weight, 1.0)
        pad += weight * max(map(_largest, (shape.GetOffsetsAttr(), *steps)))
    return pad


def _largest(attr: Any) -> float:
    offsets = np.array(attr.Get() or (), np.float64).reshape(-1, 3)
    return float(np.linalg.norm(offsets, axis=1).max(initial=0.0))
