"""Checks on the influences of joints on prims."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray
from animtool.errors import Fault, listed
from animtool.usd.checks.animation import tokens
from animtool.usd.checks.skeleton import singular
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding

# Text files with three digits and eight influences are within.
SUM_TOLERANCE = 4e-3


def check_skins(subject: Subject) -> Iterator[Fault]:
    """Check indices, weights and bind transform of every prim that has its own.

    What prims above geometry hold for it to inherit is not looked at, nor are prims
    without points.
    """
    for prim in subject.prims:
        binding = UsdSkel.BindingAPI(prim)
        indices = binding.GetJointIndicesPrimvar()
        weights = binding.GetJointWeightsPrimvar()
        have = [bool(p) and p.HasAuthoredValue() for p in (indices, weights)]
        if any(have) and has_points(prim):
            yield from _influences(prim, binding, indices, weights, have)
        yield from _geom_bind(binding.GetGeomBindTransformAttr())


def _influences(
    prim: Any, binding: Any, indices: Any, weights: Any, have: list[bool]
) -> Iterator[Fault]:
    found, heavy = (
        np.array(primvar.ComputeFlattened() or () if there else (), np.float64)
        for primvar, there in zip((indices, weights), have, strict=True)
    )
    if not len(found) or not len(heavy):
        message = f"{len(found)} jointIndices and {len(heavy)} jointWeights"
        yield finding("USD234", prim.GetPath(), message)
        return
    yield from _joints(prim, binding, found)
    unfit = _layout(prim, indices, weights, len(found), len(heavy))
    if unfit:
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        yield finding("USD231", path, unfit)
    yield from _values(prim, heavy, 0 if unfit else weights.GetElementSize())


def _joints(prim: Any, binding: Any, indices: FloatArray) -> Iterator[Fault]:
    held = binding.GetInheritedSkeleton()
    skeleton = tokens(held.GetJointsAttr()) if held else []
    own = _own_joints(prim)
    unknown = [name for name in own if name not in set(skeleton)]
    if skeleton and unknown:
        message = f"{len(unknown)} joints that {held.GetPath()} lacks: "
        message += listed(unknown)
        yield finding("USD238", f"{prim.GetPath()}.skel:joints", message)
    count = len(own or skeleton)
    wrong = indices[(indices < 0) | (indices >= count)] if count else indices[:0]
    if len(wrong):
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        message = (
            f"{len(wrong)} of {len(indices)} indices are not in 0 to {count - 1}, "
            f"the first is {wrong[0]:.0f}"
        )
        yield finding("USD230", path, message)


def _own_joints(prim: Any) -> list[str]:
    """Return skel:joints of a prim or the nearest prim above that has them."""
    while prim and not prim.IsPseudoRoot():
        attr = UsdSkel.BindingAPI(prim).GetJointsAttr()
        if attr and attr.HasAuthoredValue():
            return tokens(attr)
        prim = prim.GetParent()
    return []


def _layout(prim: Any, indices: Any, weights: Any, found: int, heavy: int) -> str:
    """Return what does not fit of the counts; empty where all does."""
    sizes = indices.GetElementSize(), weights.GetElementSize()
    kinds = indices.GetInterpolation(), weights.GetInterpolation()
    if sizes[0] != sizes[1] or kinds[0] != kinds[1]:
        return (
            f"jointIndices have elementSize {sizes[0]} ({kinds[0]}), "
            f"jointWeights {sizes[1]} ({kinds[1]})"
        )
    if kinds[0] not in {"constant", "vertex"}:
        return f"interpolation {kinds[0]}; allowed: constant, vertex"
    rows = 1 if kinds[0] == "constant" else point_count(prim)
    wanted = found if rows is None else rows * sizes[0]
    if found != wanted or heavy != wanted or found % max(sizes[0], 1):
        amount = "" if rows is None else f" for {rows} x {sizes[0]}"
        return f"{found} jointIndices and {heavy} jointWeights{amount}"
    return ""


def has_points(prim: Any) -> bool:
    """Return whether a prim is geometry that something can be wrong with."""
    return prim.IsA(UsdGeom.Gprim) and point_count(prim) != 0


def point_count(prim: Any) -> int | None:
    """Return how many points a prim has; None where it is no kind that has some."""
    if not prim.IsA(UsdGeom.PointBased):
        return None
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    return len(attr.Get(Usd.TimeCode.EarliestTime()) or ())


def _values(prim: Any, weights: FloatArray, size: int) -> Iterator[Fault]:
    path = f"{prim.GetPath()}.primvars:skel:jointWeights"
    bad = ~np.isfinite(weights) | (weights < 0)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        message = (
            f"{bad.sum()} of {len(weights)} weights are negative or not finite, the "
            f"first is {weights[first]:g}, that of point {first // max(size, 1)}"
        )
        yield finding("USD233", path, message)
    elif size:
        sums = weights.reshape(-1, size).sum(axis=1)
        off = np.abs(sums - 1.0) > SUM_TOLERANCE
        if off.any():
            worst = int(np.abs(sums - 1.0).argmax())
            message = (
                f"{off.sum()} of {len(sums)} points have another sum, point {worst} "
                f"{sums[worst]:.6g}"
            )
            yield finding("USD232", path, message)


def _geom_bind(attr: Any) -> Iterator[Fault]:
    value = attr.Get(Usd.TimeCode.EarliestTime()) if attr else None
    if value is None:
        return
    matrix = np.array(value, np.float64)[None]
    if not np.isfinite(matrix).all():
        yield finding("USD235", attr.GetPath(), "it is not finite")
    elif singular(matrix)[0]:
        determinant = np.linalg.det(matrix[0, :3, :3])
        message = f"it has no inverse: its determinant is {determinant:.3g}"
        yield finding("USD235", attr.GetPath(), message)
