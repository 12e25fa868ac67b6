"""Checks on blend shapes, joint influences, and the prims they deform."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, excerpt, listed
from animtool.core.rules import finding
from animtool.usd.caches.reader import PointReader
from animtool.usd.checks.subject import StageSubject
from animtool.usd.layers.faults import duplicates, singular, tokens
from animtool.usd.rigs.prims import upwards

# Text files with three digits and eight influences are within.
SUM_TOLERANCE = 4e-3


def check_skins(subject: StageSubject) -> Iterator[Fault]:
    """Check indices, weights and bind transform of every skinned prim.

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
    indexed, heavy = (
        np.array(primvar.ComputeFlattened() or () if there else (), np.float64)
        for primvar, there in zip((indices, weights), have, strict=True)
    )
    if not len(indexed) or not len(heavy):
        message = f"{len(indexed)} jointIndices and {len(heavy)} jointWeights"
        yield finding("USD234", prim.GetPath(), message)
        return
    yield from _joints(prim, binding, indexed)
    unfit = _layout(prim, indices, weights, len(indexed), len(heavy))
    if unfit:
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        yield finding("USD231", path, unfit)
    yield from _values(prim, heavy, 0 if unfit else weights.GetElementSize())


def _joints(prim: Any, binding: Any, indices: FloatArray) -> Iterator[Fault]:
    skeleton_query = binding.GetInheritedSkeleton()
    skeleton = tokens(skeleton_query.GetJointsAttr()) if skeleton_query else []
    bound = _bound_joints(prim)
    unknown = [name for name in bound if name not in set(skeleton)]
    if skeleton and unknown:
        message = (
            f"{len(unknown)} joints that {skeleton_query.GetPath()} does not have: "
        )
        message += listed(unknown)
        yield finding("USD238", f"{prim.GetPath()}.skel:joints", message)
    count = len(bound or skeleton)
    wrong = indices[(indices < 0) | (indices >= count)] if count else indices[:0]
    if len(wrong):
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        message = (
            f"{len(wrong)} of {len(indices)} indices are not in 0 to {count - 1}, "
            f"the first is {wrong[0]:.0f}"
        )
        yield finding("USD230", path, message)


def _bound_joints(prim: Any) -> list[str]:
    """Return skel:joints of a prim or its nearest ancestor that authors them."""
    attrs = (UsdSkel.BindingAPI(above).GetJointsAttr() for above in upwards(prim))
    return next((tokens(a) for a in attrs if a and a.HasAuthoredValue()), [])


def _layout(prim: Any, indices: Any, weights: Any, count: int, heavy: int) -> str:
    """Return the mismatch of counts as text; empty if they agree."""
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
    expected = count if rows is None else rows * sizes[0]
    if count != expected or heavy != expected or count % max(sizes[0], 1):
        amount = "" if rows is None else f" for {rows} x {sizes[0]}"
        return f"{count} jointIndices and {heavy} jointWeights{amount}"
    return ""


def has_points(prim: Any) -> bool:
    """Return whether a prim is point-based geometry that is checked."""
    return prim.IsA(UsdGeom.Gprim) and point_count(prim) != 0


def point_count(prim: Any) -> int | None:
    """Return the number of points of a prim; None if its type has none."""
    if not prim.IsA(UsdGeom.PointBased):
        return None
    return PointReader(prim).count()


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
                f"the weights of {off.sum()} of {len(sums)} points have another sum, "
                f"of point {worst} {sums[worst]:.6g}"
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


def check_targets(subject: StageSubject) -> Iterator[Fault]:
    """Check that a prim with blend shapes names one target per shape."""
    for prim in subject.prims:
        if not has_points(prim):
            continue
        binding = UsdSkel.BindingAPI(prim)
        attr, targets = binding.GetBlendShapesAttr(), binding.GetBlendShapeTargetsRel()
        names = tokens(attr)
        paths = targets.GetTargets() if targets else []
        twice = duplicates(names)
        if len(names) != len(paths) and (names or paths):
            message = f"{len(names)} blendShapes for {len(paths)} targets"
            yield finding("USD245", f"{prim.GetPath()}.skel:blendShapes", message)
        elif twice:
            message = f"{len(twice)} duplicate shapes: {listed(twice)}"
            yield finding("USD245", attr.GetPath(), message)


def check_shapes(subject: StageSubject) -> Iterator[Fault]:
    """Check offsets, indices and inbetweens of every BlendShape."""
    points = _points(subject)
    for shape in subject.of_type(UsdSkel.BlendShape):
        yield from _shape(shape, points.get(shape.GetPath()))


def _points(subject: StageSubject) -> dict[Any, int]:
    """Return the point count of the prims that each shape deforms."""
    counts: dict[Any, int] = {}
    for prim in subject.prims:
        targets = prim.GetRelationship("skel:blendShapeTargets")
        count = point_count(prim) if targets else None
        if count:
            counts |= dict.fromkeys(targets.GetTargets(), count)
    return counts


def _rows(attr: Any) -> FloatArray:
    value = attr.Get() if attr else None
    return np.array(value or (), np.float64).reshape(-1, 3)


def _shape(shape: Any, points: int | None) -> Iterator[Fault]:
    offsets = _rows(shape.GetOffsetsAttr())
    indices = np.array(shape.GetPointIndicesAttr().Get() or (), np.int64)
    expected = len(indices) or points
    path = shape.GetOffsetsAttr().GetPath()
    inbetweens = list(shape.GetInbetweens())
    turned = [_rows(shape.GetNormalOffsetsAttr())]
    turned += [_rows(step.GetNormalOffsetsAttr()) for step in inbetweens]
    turning = max(map(len, turned))
    if not len(offsets) and turning:
        # A shape may change normals only.
        offsets = np.zeros((turning if expected is None else expected, 3))
    if expected is not None and len(offsets) != expected:
        counted_as = "pointIndices" if len(indices) else "points"
        yield finding(
            "USD240", path, f"{len(offsets)} offsets for {expected} {counted_as}"
        )
    yield from _indices(shape, indices, points)
    yield from _finite(shape.GetOffsetsAttr(), offsets)
    moves = [offsets, *turned, *(_rows(step.GetAttr()) for step in inbetweens)]
    if len(offsets) and not any(rows.any() for rows in moves):
        yield finding("RIG209", path, f"all {len(offsets)} offsets are 0")
    count = expected if expected is not None else len(offsets)
    yield from _normals(shape.GetNormalOffsetsAttr(), count)
    yield from _inbetweens(inbetweens, count)


def _indices(shape: Any, indices: IntArray, points: int | None) -> Iterator[Fault]:
    path = shape.GetPointIndicesAttr().GetPath()
    last = np.iinfo(np.int64).max if points is None else points - 1
    wrong = indices[(indices < 0) | (indices > last)]
    if len(wrong):
        end = "" if points is None else f" to {last}"
        message = (
            f"{len(wrong)} of {len(indices)} are not in 0{end}, the first is {wrong[0]}"
        )
        yield finding("USD241", path, message)
    elif len(np.unique(indices)) != len(indices):
        rows, counts = np.unique(indices, return_counts=True)
        twice = rows[counts > 1]
        message = (
            f"{len(twice)} of {len(indices)} are duplicates, the first is {twice[0]}"
        )
        yield finding("USD241", path, message)


def _finite(attr: Any, rows: FloatArray) -> Iterator[Fault]:
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        message = f"{len(bad)} of {len(rows)} are not finite, the first is {bad[0]}"
        yield finding("USD243", attr.GetPath(), message)


def _normals(attr: Any, expected: int) -> Iterator[Fault]:
    rows = _rows(attr)
    if attr and attr.HasAuthoredValue() and len(rows) not in {0, expected}:
        message = f"{len(rows)} normalOffsets for {expected} offsets"
        yield finding("USD242", attr.GetPath(), message)
    yield from _finite(attr, rows)


def _inbetweens(steps: list[Any], expected: int) -> Iterator[Fault]:
    taken: dict[float, str] = {}
    for step in steps:
        attr, weight = step.GetAttr(), step.GetWeight()
        rows = _rows(attr)
        alone = not len(rows) and len(_rows(step.GetNormalOffsetsAttr()))
        if len(rows) != expected and not alone:
            message = f"{len(rows)} offsets for {expected}"
            yield finding("USD240", attr.GetPath(), message)
        yield from _finite(attr, rows)
        yield from _normals(step.GetNormalOffsetsAttr(), expected)
        if weight is None or not np.isfinite(weight) or weight in {0.0, 1.0}:
            have = "no weight" if weight is None else f"weight {weight:g}"
            yield finding("USD244", attr.GetPath(), have)
        elif weight in taken:
            message = f"weight {weight:g}, as {excerpt(taken[weight])}"
            yield finding("USD244", attr.GetPath(), message)
        else:
            taken[weight] = attr.GetName()
