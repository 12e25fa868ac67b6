"""Computes the exact bounds of the skinned points below a SkelRoot.

`ComputeExtentFromPlugins` uses the joints and a padding from the rest pose, which
skinned points may exceed.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.usd.caches.reader import PointReader, transform_points

# Maximum number of points deformed to find the largest overhang of all samples.
MAX_SKINNED_POINTS = 20_000_000


@dataclass(frozen=True, slots=True)
class _SkinnedPrim:
    """A prim that a Skeleton deforms."""

    query: Any  # `UsdSkel.SkinningQuery`
    points: Any  # rest points
    shape_query: Any  # `UsdSkel.BlendShapeQuery`; None if there are no shapes
    shape_arrays: list[Any]  # points that each shape moves, and their offsets


class SkinnedBounds:
    """Bounds of the skinned points below a SkelRoot over time, in SkelRoot space."""

    def __init__(self, root: Any) -> None:
        self._root = root
        # Queries of the skeletons below the SkelRoot, with their skinned prims.
        self._bindings: list[tuple[Any, list[_SkinnedPrim]]] = []
        cache, predicate = UsdSkel.Cache(), Usd.TraverseInstanceProxies()
        schema = UsdSkel.Root(root)
        with suppress(Tf.ErrorException):
            cache.Populate(schema, predicate)
            self._bindings = [
                (cache.GetSkelQuery(binding.GetSkeleton()), _skinned_prims(binding))
                for binding in cache.ComputeSkelBindings(schema, predicate)
            ]

    @property
    def point_count(self) -> int:
        """Number of skinned points of all prims below the SkelRoot."""
        return sum(
            len(skinned_prim.points)
            for _, prims in self._bindings
            for skinned_prim in prims
        )

    def at_time(self, code: Any) -> FloatArray | None:
        """Return the bounds ``(2, 3)`` at a time code; None if no point is skinned.

        Also None if UsdSkel cannot skin: other checks report invalid influences.
        """
        try:
            return self._compute_bounds(code)
        except Tf.ErrorException:
            return None

    def _compute_bounds(self, code: Any) -> FloatArray | None:
        xforms = UsdGeom.XformCache(code)
        prim_bounds = []
        for skeleton, prims in self._bindings:
            transforms = skeleton.ComputeSkinningTransforms(code) if prims else None
            for skinned_prim in prims:
                posed_points, space_prim = _posed_points(
                    skinned_prim, skeleton, transforms, code
                )
                if posed_points is None:
                    continue
                matrix, _ = xforms.ComputeRelativeTransform(space_prim, self._root)
                root_points = transform_points(
                    posed_points, np.array(matrix, np.float64)
                )
                prim_bounds.append((root_points.min(axis=0), root_points.max(axis=0)))
        if not prim_bounds:
            return None
        lows, highs = np.array(prim_bounds).swapaxes(0, 1)
        bounds = np.stack([lows.min(axis=0), highs.max(axis=0)])
        return bounds if np.isfinite(bounds).all() else None


def find_overhang(
    root: Any, extents: FloatArray, times: Sequence[float]
) -> tuple[float, float, bool] | None:
    """Return the largest distance of skinned points outside extents, and its time code.

    With many points, only a subset of the samples is posed; the last value is False.

    Args:
        root: The SkelRoot.
        extents: One per time, or one for all ``(F or 1, 2, 3)``.
        times: Time codes of the extents; NaN alone is the default.
    """
    bounds = SkinnedBounds(root)
    max_samples = max(1, MAX_SKINNED_POINTS // max(bounds.point_count, 1))
    sample_indices = spaced_indices(len(times), max_samples)
    largest_distance, largest_code = 0.0, times[0]
    for i in sample_indices.tolist():
        point_bounds = bounds.at_time(time_code_of(times[i]))
        if point_bounds is None:
            continue
        lowest, highest = extents[i if len(extents) > 1 else 0]
        max_distance = float(
            np.maximum(lowest - point_bounds[0], point_bounds[1] - highest).max()
        )
        if max_distance > largest_distance:
            largest_distance, largest_code = max_distance, times[i]
    if not largest_distance:
        return None
    return largest_distance, largest_code, len(sample_indices) == len(times)


def spaced_indices(count: int, max_count: int) -> IntArray:
    """Return up to ``max_count`` evenly spaced indices below a count."""
    return np.linspace(0, count - 1, min(count, max_count)).astype(np.int64)


def time_code_of(time: float) -> Any:
    """Return a time as `Usd.TimeCode`; the default time code for NaN."""
    return Usd.TimeCode.Default() if np.isnan(time) else Usd.TimeCode(time)


def _skinned_prims(binding: Any) -> list[_SkinnedPrim]:
    """Return the prims with points of a binding."""
    prims = []
    for query in binding.GetSkinningTargets():
        prim = query.GetPrim()
        if not prim.IsA(UsdGeom.PointBased):
            continue
        points = PointReader(prim).points_attr.Get(Usd.TimeCode.EarliestTime())
        if not points:
            continue
        shape_query = shape_arrays = None
        if query.HasBlendShapes():
            shape_query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            shape_arrays = [
                shape_query.ComputeBlendShapePointIndices(),
                shape_query.ComputeSubShapePointOffsets(),
            ]
        prims.append(_SkinnedPrim(query, points, shape_query, shape_arrays or []))
    return prims


def _posed_points(
    skinned_prim: _SkinnedPrim, skeleton: Any, transforms: Any, code: Any
) -> tuple[FloatArray | None, Any]:
    """Return the deformed points of a prim ``(N, 3)`` and the prim of their space."""
    query, points = skinned_prim.query, type(skinned_prim.points)(skinned_prim.points)
    animation = skeleton.GetAnimQuery()
    if skinned_prim.shape_query is not None and animation:
        weights = animation.ComputeBlendShapeWeights(code)
        mapper = query.GetBlendShapeMapper()
        weights = mapper.Remap(weights) if weights and mapper else weights
        if weights:
            subshapes = skinned_prim.shape_query.ComputeSubShapeWeights(weights)
            skinned_prim.shape_query.ComputeDeformedPoints(
                *subshapes, *skinned_prim.shape_arrays, points
            )
    if not query.HasJointInfluences():
        return np.array(points, np.float64), query.GetPrim()
    if not transforms:
        return None, query.GetPrim()
    if query.IsRigidlyDeformed():
        matrix = np.array(query.ComputeSkinnedTransform(transforms, code), np.float64)
        return transform_points(
            np.array(points, np.float64), matrix
        ), skeleton.GetPrim()
    if not query.ComputeSkinnedPoints(transforms, points, code):
        return None, query.GetPrim()
    return np.array(points, np.float64), skeleton.GetPrim()
