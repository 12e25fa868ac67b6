"""Exact bounds of the points that a SkelRoot skins, as UsdSkel poses them.

`ComputeExtentFromPlugins` has the joints and a padding of the rest pose, which skinned
points may leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.usd.caches.reader import PointReader, transformed

# Points posed where the largest of many samples is looked for.
MAX_POINTS = 20_000_000


@dataclass(frozen=True, slots=True)
class _SkinnedPrim:
    """A prim that a Skeleton deforms."""

    query: Any  # its `UsdSkel.SkinningQuery`
    points: Any  # at rest
    shapes: Any  # a `UsdSkel.BlendShapeQuery`, None without shapes
    reach: list[Any]  # points that the shapes move, and by how much


class SkinnedBounds:
    """Bounds of the skinned points below a SkelRoot at any time, in its space."""

    def __init__(self, root: Any) -> None:
        self._root = root
        try:
            self._bound = _bindings(root)
        except Tf.ErrorException:
            self._bound = []

    @property
    def points(self) -> int:
        """Number of points."""
        return sum(len(one.points) for _, prims in self._bound for one in prims)

    def at(self, code: Any) -> FloatArray | None:
        """Return the bounds ``(2, 3)`` at a time code; None without skinned points.

        None too where UsdSkel cannot: other checks report broken influences.
        """
        try:
            return self._at(code)
        except Tf.ErrorException:
            return None

    def _at(self, code: Any) -> FloatArray | None:
        xforms = UsdGeom.XformCache(code)
        ends = []
        for skeleton, prims in self._bound:
            transforms = skeleton.ComputeSkinningTransforms(code) if prims else None
            for one in prims:
                posed, holder = _posed(one, skeleton, transforms, code)
                if posed is None:
                    continue
                matrix, _ = xforms.ComputeRelativeTransform(holder, self._root)
                inside = transformed(posed, np.array(matrix, np.float64))
                ends.append((inside.min(axis=0), inside.max(axis=0)))
        if not ends:
            return None
        lows, highs = np.array(ends).swapaxes(0, 1)
        bounds = np.stack([lows.min(axis=0), highs.max(axis=0)])
        return bounds if np.isfinite(bounds).all() else None


def overhang(
    root: Any, extents: FloatArray, times: Sequence[float]
) -> tuple[float, float, bool] | None:
    """Return the largest distance of skinned points outside extents, and where.

    Where these are many, the last is False, and it is the largest of some.

    Args:
        root: The SkelRoot.
        extents: One a time, or one for all ``(F or 1, 2, 3)``.
        times: Their time codes; NaN alone is the default.
    """
    bounds = SkinnedBounds(root)
    most = max(1, MAX_POINTS // max(bounds.points, 1))
    count = len(times)
    chosen = np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
    worst, when = 0.0, times[0]
    for i in chosen.tolist():
        time = times[i]
        code = Usd.TimeCode.Default() if np.isnan(time) else Usd.TimeCode(time)
        posed = bounds.at(code)
        if posed is None:
            continue
        low, high = extents[i if len(extents) > 1 else 0]
        over = float(np.maximum(low - posed[0], posed[1] - high).max())
        if over > worst:
            worst, when = over, time
    return (worst, when, len(chosen) == count) if worst > 0.0 else None


def _bindings(root: Any) -> list[tuple[Any, list[_SkinnedPrim]]]:
    """Return the skeletons below a SkelRoot as queries, with their skinned prims."""
    cache, everything = UsdSkel.Cache(), Usd.TraverseInstanceProxies()
    schema = UsdSkel.Root(root)
    cache.Populate(schema, everything)
    return [
        (cache.GetSkelQuery(binding.GetSkeleton()), _skinned(binding))
        for binding in cache.ComputeSkelBindings(schema, everything)
    ]


def _skinned(binding: Any) -> list[_SkinnedPrim]:
    """Return the prims with points of a binding."""
    prims = []
    for query in binding.GetSkinningTargets():
        prim = query.GetPrim()
        if not prim.IsA(UsdGeom.PointBased):
            continue
        points = PointReader(prim).attr.Get(Usd.TimeCode.EarliestTime())
        if not points:
            continue
        shapes = reach = None
        if query.HasBlendShapes():
            shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            reach = [
                shapes.ComputeBlendShapePointIndices(),
                shapes.ComputeSubShapePointOffsets(),
            ]
        prims.append(_SkinnedPrim(query, points, shapes, reach or []))
    return prims


def _posed(
    one: _SkinnedPrim, skeleton: Any, transforms: Any, code: Any
) -> tuple[FloatArray | None, Any]:
    """Return the posed points of a prim ``(N, 3)``, and the prim of their space."""
    query, points = one.query, type(one.points)(one.points)
    animation = skeleton.GetAnimQuery()
    if one.shapes is not None and animation:
        weights = animation.ComputeBlendShapeWeights(code)
        mapper = query.GetBlendShapeMapper()
        weights = mapper.Remap(weights) if weights and mapper else weights
        if weights:
            subshapes = one.shapes.ComputeSubShapeWeights(weights)
            one.shapes.ComputeDeformedPoints(*subshapes, *one.reach, points)
    if not query.HasJointInfluences():
        return np.array(points, np.float64), query.GetPrim()
    if not transforms:
        return None, query.GetPrim()
    if query.IsRigidlyDeformed():
        matrix = np.array(query.ComputeSkinnedTransform(transforms, code), np.float64)
        return transformed(np.array(points, np.float64), matrix), skeleton.GetPrim()
    if not query.ComputeSkinnedPoints(transforms, points, code):
        return None, query.GetPrim()
    return np.array(points, np.float64), skeleton.GetPrim()
