"""Checks on blend shapes, joint influences, and the prims they deform."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted, excerpt, listed
from animtool.core.rules import finding
from animtool.usd.caches.reader import PointReader
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.layers.faults import duplicate_tokens, is_singular, token_array
from animtool.usd.rigs.prims import self_and_ancestors

# Tolerance of weight sums; text files with three digits and eight influences are within
# it.
SUM_TOLERANCE = 4e-3


def check_skins(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check indices, weights and bind transform of every skinned prim.

    Inherited bindings on prims above geometry are not checked, nor are prims without
    points.
    """
    for prim in checked_stage.prims:
        binding = UsdSkel.BindingAPI(prim)
        indices = binding.GetJointIndicesPrimvar()
        weights = binding.GetJointWeightsPrimvar()
        has_values = [bool(p) and p.HasAuthoredValue() for p in (indices, weights)]
        if any(has_values) and has_points(prim):
            yield from _check_influences(prim, binding, indices, weights, has_values)
        yield from _check_geom_bind(binding.GetGeomBindTransformAttr())


def _check_influences(
    prim: Any, binding: Any, indices: Any, weights: Any, has_values: list[bool]
) -> Iterator[Fault]:
    index_values, weight_values = (
        np.array(primvar.ComputeFlattened() or () if is_present else (), np.float64)
        for primvar, is_present in zip((indices, weights), has_values, strict=True)
    )
    if not len(index_values) or not len(weight_values):
        message = (
            f"{len(index_values)} jointIndices and {len(weight_values)} jointWeights"
        )
        yield finding("USD234", prim.GetPath(), message)
        return
    yield from _check_joints(prim, binding, index_values)
    mismatch = _count_mismatch(
        prim, indices, weights, len(index_values), len(weight_values)
    )
    if mismatch:
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        yield finding("USD231", path, mismatch)
    yield from _check_weight_values(
        prim, weight_values, 0 if mismatch else weights.GetElementSize()
    )


def _check_joints(prim: Any, binding: Any, indices: FloatArray) -> Iterator[Fault]:
    skeleton_query = binding.GetInheritedSkeleton()
    skeleton_joints = (
        token_array(skeleton_query.GetJointsAttr()) if skeleton_query else []
    )
    joint_names = _bound_joints(prim)
    unknown_joints = [name for name in joint_names if name not in set(skeleton_joints)]
    if skeleton_joints and unknown_joints:
        message = (
            f"{counted(len(unknown_joints), 'joint')} that {skeleton_query.GetPath()} "
            f"does not have: {listed(unknown_joints)}"
        )
        yield finding("USD238", f"{prim.GetPath()}.skel:joints", message)
    count = len(joint_names or skeleton_joints)
    out_of_range = indices[(indices < 0) | (indices >= count)] if count else indices[:0]
    if len(out_of_range):
        path = f"{prim.GetPath()}.primvars:skel:jointIndices"
        message = (
            f"{len(out_of_range)} of {len(indices)} indices are not in 0 to "
            f"{count - 1}, the first is {out_of_range[0]:.0f}"
        )
        yield finding("USD230", path, message)


def _bound_joints(prim: Any) -> list[str]:
    """Return skel:joints of a prim or its nearest ancestor that authors them."""
    attrs = (
        UsdSkel.BindingAPI(ancestor).GetJointsAttr()
        for ancestor in self_and_ancestors(prim)
    )
    return next((token_array(a) for a in attrs if a and a.HasAuthoredValue()), [])


def _count_mismatch(
    prim: Any, indices: Any, weights: Any, index_count: int, weight_count: int
) -> str:
    """Describe a mismatch of influence counts; empty if they agree."""
    element_sizes = indices.GetElementSize(), weights.GetElementSize()
    interpolations = indices.GetInterpolation(), weights.GetInterpolation()
    if element_sizes[0] != element_sizes[1] or interpolations[0] != interpolations[1]:
        return (
            f"jointIndices have elementSize {element_sizes[0]} ({interpolations[0]}), "
            f"jointWeights {element_sizes[1]} ({interpolations[1]})"
        )
    if interpolations[0] not in {"constant", "vertex"}:
        return f"interpolation {interpolations[0]}; allowed: constant, vertex"
    row_count = 1 if interpolations[0] == "constant" else point_count(prim)
    expected_length = index_count if row_count is None else row_count * element_sizes[0]
    if (
        index_count != expected_length
        or weight_count != expected_length
        or index_count % max(element_sizes[0], 1)
    ):
        expected_text = (
            "" if row_count is None else f" for {row_count} x {element_sizes[0]}"
        )
        return (
            f"{index_count} jointIndices and {weight_count} jointWeights{expected_text}"
        )
    return ""


def has_points(prim: Any) -> bool:
    """Return whether a prim is point-based geometry that is checked."""
    return prim.IsA(UsdGeom.Gprim) and point_count(prim) != 0


def point_count(prim: Any) -> int | None:
    """Return the number of points of a prim; None if its type has none."""
    if not prim.IsA(UsdGeom.PointBased):
        return None
    return PointReader(prim).point_count()


def _check_weight_values(
    prim: Any, weights: FloatArray, influence_count: int
) -> Iterator[Fault]:
    path = f"{prim.GetPath()}.primvars:skel:jointWeights"
    is_invalid = ~np.isfinite(weights) | (weights < 0)
    if is_invalid.any():
        first_invalid = int(np.flatnonzero(is_invalid)[0])
        message = (
            f"{is_invalid.sum()} of {len(weights)} weights are negative or not finite, "
            f"the first is {weights[first_invalid]:g}, that of point "
            f"{first_invalid // max(influence_count, 1)}"
        )
        yield finding("USD233", path, message)
    elif influence_count:
        weight_sums = weights.reshape(-1, influence_count).sum(axis=1)
        is_off_one = np.abs(weight_sums - 1.0) > SUM_TOLERANCE
        if is_off_one.any():
            worst_point = int(np.abs(weight_sums - 1.0).argmax())
            message = (
                f"the weights of {is_off_one.sum()} of {len(weight_sums)} points have "
                f"another sum, of point {worst_point} {weight_sums[worst_point]:.6g}"
            )
            yield finding("USD232", path, message)


def _check_geom_bind(attr: Any) -> Iterator[Fault]:
    value = attr.Get(Usd.TimeCode.EarliestTime()) if attr else None
    if value is None:
        return
    matrix = np.array(value, np.float64)[None]
    if not np.isfinite(matrix).all():
        yield finding("USD235", attr.GetPath(), "it is not finite")
    elif is_singular(matrix)[0]:
        determinant = np.linalg.det(matrix[0, :3, :3])
        message = f"it has no inverse: its determinant is {determinant:.3g}"
        yield finding("USD235", attr.GetPath(), message)


def check_targets(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that a prim with blend shapes names one target per shape."""
    for prim in checked_stage.prims:
        if not has_points(prim):
            continue
        binding = UsdSkel.BindingAPI(prim)
        attr, targets = binding.GetBlendShapesAttr(), binding.GetBlendShapeTargetsRel()
        names = token_array(attr)
        paths = targets.GetTargets() if targets else []
        repeated_names = duplicate_tokens(names)
        if len(names) != len(paths) and (names or paths):
            message = f"{len(names)} blendShapes for {len(paths)} targets"
            yield finding("USD245", f"{prim.GetPath()}.skel:blendShapes", message)
        elif repeated_names:
            message = (
                f"{len(repeated_names)} duplicate shapes: {listed(repeated_names)}"
            )
            yield finding("USD245", attr.GetPath(), message)


def check_shapes(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check offsets, indices and inbetweens of every BlendShape."""
    # Point count of the prims that each shape deforms.
    point_count_by_shape: dict[Any, int] = {}
    for prim in checked_stage.prims:
        targets = prim.GetRelationship("skel:blendShapeTargets")
        count = point_count(prim) if targets else None
        if count:
            point_count_by_shape |= dict.fromkeys(targets.GetTargets(), count)
    for shape in checked_stage.prims_of_type(UsdSkel.BlendShape):
        yield from _check_shape(shape, point_count_by_shape.get(shape.GetPath()))


def _offset_rows(attr: Any) -> FloatArray:
    value = attr.Get() if attr else None
    return np.array(value or (), np.float64).reshape(-1, 3)


def _check_shape(shape: Any, vertex_count: int | None) -> Iterator[Fault]:
    offsets = _offset_rows(shape.GetOffsetsAttr())
    indices = np.array(shape.GetPointIndicesAttr().Get() or (), np.int64)
    expected_count = len(indices) or vertex_count
    path = shape.GetOffsetsAttr().GetPath()
    inbetweens = list(shape.GetInbetweens())
    normal_offsets = [_offset_rows(shape.GetNormalOffsetsAttr())]
    normal_offsets += [_offset_rows(step.GetNormalOffsetsAttr()) for step in inbetweens]
    normal_count = max(map(len, normal_offsets))
    if not len(offsets) and normal_count:
        # A shape may change normals only.
        offsets = np.zeros(
            (normal_count if expected_count is None else expected_count, 3)
        )
    if expected_count is not None and len(offsets) != expected_count:
        count_source = "pointIndices" if len(indices) else "points"
        yield finding(
            "USD240",
            path,
            f"{len(offsets)} offsets for {expected_count} {count_source}",
        )
    yield from _check_indices(shape, indices, vertex_count)
    yield from _check_finite(shape.GetOffsetsAttr(), offsets)
    all_offsets = [
        offsets,
        *normal_offsets,
        *(_offset_rows(step.GetAttr()) for step in inbetweens),
    ]
    if len(offsets) and not any(rows.any() for rows in all_offsets):
        yield finding("RIG209", path, f"all {len(offsets)} offsets are 0")
    count = expected_count if expected_count is not None else len(offsets)
    yield from _check_normals(shape.GetNormalOffsetsAttr(), count)
    yield from _check_inbetweens(inbetweens, count)


def _check_indices(
    shape: Any, indices: IntArray, vertex_count: int | None
) -> Iterator[Fault]:
    path = shape.GetPointIndicesAttr().GetPath()
    last_index = np.iinfo(np.int64).max if vertex_count is None else vertex_count - 1
    out_of_range = indices[(indices < 0) | (indices > last_index)]
    if len(out_of_range):
        range_end = "" if vertex_count is None else f" to {last_index}"
        message = (
            f"{len(out_of_range)} of {len(indices)} are not in 0{range_end}, "
            f"the first is {out_of_range[0]}"
        )
        yield finding("USD241", path, message)
    elif len(np.unique(indices)) != len(indices):
        unique_indices, counts = np.unique(indices, return_counts=True)
        repeated_indices = unique_indices[counts > 1]
        message = (
            f"{len(repeated_indices)} of {len(indices)} are duplicates, "
            f"the first is {repeated_indices[0]}"
        )
        yield finding("USD241", path, message)


def _check_finite(attr: Any, rows: FloatArray) -> Iterator[Fault]:
    bad_indices = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad_indices):
        message = f"{len(bad_indices)} of {len(rows)} are not finite, "
        message += f"the first is {bad_indices[0]}"
        yield finding("USD243", attr.GetPath(), message)


def _check_normals(attr: Any, expected_count: int) -> Iterator[Fault]:
    rows = _offset_rows(attr)
    if attr and attr.HasAuthoredValue() and len(rows) not in {0, expected_count}:
        message = f"{len(rows)} normalOffsets for {expected_count} offsets"
        yield finding("USD242", attr.GetPath(), message)
    yield from _check_finite(attr, rows)


def _check_inbetweens(inbetweens: list[Any], expected_count: int) -> Iterator[Fault]:
    names_by_weight: dict[float, str] = {}
    for inbetween in inbetweens:
        attr, weight = inbetween.GetAttr(), inbetween.GetWeight()
        rows = _offset_rows(attr)
        normals_only = not len(rows) and len(
            _offset_rows(inbetween.GetNormalOffsetsAttr())
        )
        if len(rows) != expected_count and not normals_only:
            message = f"{len(rows)} offsets for {expected_count}"
            yield finding("USD240", attr.GetPath(), message)
        yield from _check_finite(attr, rows)
        yield from _check_normals(inbetween.GetNormalOffsetsAttr(), expected_count)
        if weight is None or not np.isfinite(weight) or weight in {0.0, 1.0}:
            weight_text = "no weight" if weight is None else f"weight {weight:g}"
            yield finding("USD244", attr.GetPath(), weight_text)
        elif weight in names_by_weight:
            message = f"weight {weight:g}, as {excerpt(names_by_weight[weight])}"
            yield finding("USD244", attr.GetPath(), message)
        else:
            names_by_weight[weight] = attr.GetName()
