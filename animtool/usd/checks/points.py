"""Checks on animated points and instancers: counts, values and extents.

A cache may be larger than memory, so samples are read and released one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from animtool.core.array_types import FloatArray
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, counted
from animtool.core.rules import finding
from animtool.usd.caches.reader import UNIT_TOLERANCE, PointReader, time_codes_of
from animtool.usd.checks.checked_stage import CheckedStage, SampledArray, samples_text
from animtool.usd.checks.extents import bounds_difference


def check_points(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check the points and velocities of every prim, in every sample."""
    for geometry in checked_stage.prims_of_type(UsdGeom.PointBased):
        attr = PointReader(geometry.GetPrim()).points_attr
        if not attr.HasAuthoredValue():
            continue
        points, bounds = _point_samples(checked_stage, attr)
        yield from _check_finite(checked_stage, attr, points, bounds)
        yield from _check_topology(checked_stage, geometry, attr, points)
        yield from _check_velocities(checked_stage, geometry, points)
        yield from _check_extent(checked_stage, geometry, points, bounds)


def _point_samples(
    checked_stage: CheckedStage, attr: Any
) -> tuple[SampledArray, FloatArray]:
    """Return point counts and bounds ``(F, 2, 3)`` of all samples, not the points."""
    times = checked_stage.times(attr)
    codes = time_codes_of(times)
    query = Usd.AttributeQuery(attr)
    counts = np.full(len(codes), -1, np.int64)
    bounds = np.full((len(codes), 2, 3), np.nan)
    for i, code in enumerate(codes):
        value = query.Get(code)
        if value is None:
            continue
        counts[i] = len(value)
        if len(value):
            rows = np.array(value, copy=False)
            bounds[i] = rows.min(axis=0), rows.max(axis=0)
    return SampledArray(np.array(times or [np.nan]), [], counts), bounds


def _check_finite(
    checked_stage: CheckedStage, attr: Any, array: SampledArray, bounds: FloatArray
) -> Iterator[Fault]:
    # min and max propagate both NaN and infinity.
    is_not_finite = ~np.isfinite(bounds).all(axis=(1, 2)) & (array.counts > 0)
    if is_not_finite.any():
        message = f"points are not finite {samples_text(array, is_not_finite)}"
        yield finding("USD265", attr.GetPath(), message)
    elif (array.counts >= 0).all():
        checked_stage.finite_paths.add(attr.GetPath())


def _check_topology(
    checked_stage: CheckedStage, geometry: Any, attr: Any, points: SampledArray
) -> Iterator[Fault]:
    prim = geometry.GetPrim()
    if prim.IsA(UsdGeom.Mesh):
        indices = UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr()
        if checked_stage.times(indices):
            return
        value = indices.Get()
        min_points = int(np.array(value).max(initial=-1)) + 1 if value else 0
        has_too_few = (points.counts < min_points) & (points.counts >= 0)
        if has_too_few.any():
            count = points.counts[np.flatnonzero(has_too_few)[0]]
            message = (
                f"{counted(count, 'point')} {samples_text(points, has_too_few)}, but "
                f"the faces refer to point {min_points - 1}"
            )
            yield finding("USD264", attr.GetPath(), message)
            return
    elif not prim.IsA(UsdGeom.Curves) or checked_stage.times(
        UsdGeom.Curves(prim).GetCurveVertexCountsAttr()
    ):
        return
    is_changed = points.counts != points.counts[0]
    if is_changed.any():
        count = points.counts[np.flatnonzero(is_changed)[0]]
        message = (
            f"{counted(count, 'point')} {samples_text(points, is_changed)}, but the "
            f"first sample has {points.counts[0]}"
        )
        yield finding("USD264", attr.GetPath(), message)


def _check_velocities(
    checked_stage: CheckedStage, geometry: Any, points: SampledArray
) -> Iterator[Fault]:
    attr = geometry.GetVelocitiesAttr()
    if not attr.HasAuthoredValue():
        return
    velocities, bounds = _point_samples(checked_stage, attr)
    yield from _check_finite(checked_stage, attr, velocities, bounds)
    index_by_time = {time: i for i, time in enumerate(points.times.tolist())}
    for i, time in enumerate(velocities.times.tolist()):
        expected_count = points.counts[index_by_time.get(time, 0)]
        if velocities.counts[i] not in {0, expected_count}:
            message = (
                f"{velocities.counts[i]} velocities for {expected_count} points "
                f"{samples_text(velocities, np.array([i]))}"
            )
            yield finding("USD266", attr.GetPath(), message)
            return


def _check_extent(
    checked_stage: CheckedStage, geometry: Any, points: SampledArray, bounds: FloatArray
) -> Iterator[Fault]:
    """Compare the bounds of a mesh's animated points with its extent."""
    prim, attr = geometry.GetPrim(), geometry.GetExtentAttr()
    if (
        not points.is_animated
        or not prim.IsA(UsdGeom.Mesh)
        or checked_stage.has_only_overs
    ):
        return
    if not attr.HasAuthoredValue():
        message = f"this {prim.GetTypeName()} has no extent, but its points move"
        yield finding("USD250", prim.GetPath(), message)
        return
    array = checked_stage.sampled_array(attr)
    if (array.counts != 2).any():
        message = "the extent does not have two corners "
        message += samples_text(array, array.counts != 2)
        yield finding("USD251", attr.GetPath(), message)
        return
    extents = array.rows(2, 3)[1].astype(np.float64)
    if array.is_animated:
        # Between samples, an extent keeps the value of the previous sample.
        previous_sample = np.searchsorted(array.times, points.times, side="right") - 1
        extents = extents[np.clip(previous_sample, 0, None)]
    excess, distance = bounds_difference(extents, bounds, must_equal=array.is_animated)
    if (excess > 0).any():
        worst_sample = int(np.nanargmax(np.where(excess > 0, distance, 0.0)))
        message = (
            f"the extent is off by {distance[worst_sample]:.3g} "
            f"{samples_text(points, excess > 0)}"
        )
        if np.count_nonzero(excess > 0) > 1:
            message += f", and most at {frame_label(points.times[worst_sample])}"
        yield finding("USD251", attr.GetPath(), message)


# Arrays with an entry per instance.
_INSTANCE_ARRAYS = (
    *("positions", "orientations", "orientationsf", "scales"),
    *("velocities", "angularVelocities", "ids"),
)


def check_instancers(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check every PointInstancer: prototypes, lengths, numbers, unit orientations."""
    for instancer in checked_stage.prims_of_type(UsdGeom.PointInstancer):
        prim = instancer.GetPrim()
        indices = checked_stage.sampled_array(instancer.GetProtoIndicesAttr())
        yield from _check_prototypes(checked_stage, instancer, indices)
        for name in _INSTANCE_ARRAYS:
            attr = prim.GetAttribute(name)
            if not attr or not attr.HasAuthoredValue():
                continue
            array = checked_stage.sampled_array(attr)
            yield from _check_lengths(attr, array, indices)
            if name != "ids":
                yield from _check_numbers(
                    attr, array, must_be_unit=name.startswith("orientations")
                )


def _check_prototypes(
    checked_stage: CheckedStage, instancer: Any, indices: SampledArray
) -> Iterator[Fault]:
    relationship = instancer.GetPrototypesRel()
    targets = relationship.GetForwardedTargets()
    missing_targets = [t for t in targets if not checked_stage.stage.GetPrimAtPath(t)]
    if missing_targets and not checked_stage.has_only_overs:
        yield finding(
            "USD287",
            relationship.GetPath(),
            f"prim {missing_targets[0]} does not exist",
        )
    path = instancer.GetPath()
    ancestors = [target for target in targets if path.HasPrefix(target)]
    if ancestors:
        message = f"{ancestors[0]} contains the instances themselves"
        yield finding("USD287", relationship.GetPath(), message)
    index_ranges = [
        (int(np.min(array)), int(np.max(array))) if count > 0 else (0, -1)
        for array, count in zip(indices.arrays, indices.counts, strict=True)
    ]
    lowest, highest = np.array(index_ranges, np.int64).reshape(-1, 2).T
    is_out_of_range = (lowest < 0) | (highest >= len(targets))
    if is_out_of_range.any() and not (checked_stage.has_only_overs and not targets):
        first_invalid_range = index_ranges[int(np.argmax(is_out_of_range))]
        index = (
            first_invalid_range[0]
            if first_invalid_range[0] < 0
            else first_invalid_range[1]
        )
        message = (
            f"{index} is outside the {len(targets)} prototypes "
            f"{samples_text(indices, is_out_of_range)}"
        )
        yield finding("USD287", instancer.GetProtoIndicesAttr().GetPath(), message)


def _check_lengths(
    attr: Any, array: SampledArray, indices: SampledArray
) -> Iterator[Fault]:
    """Compare array lengths with protoIndices at each sample."""
    if not len(indices.counts):
        return
    previous_samples = np.zeros(len(array.counts), np.int64)
    if indices.is_animated and array.is_animated:
        previous_samples = np.searchsorted(indices.times, array.times, side="right") - 1
    expected_counts = indices.counts[np.clip(previous_samples, 0, None)]
    is_optional = not attr.GetName().startswith("positions")
    is_mismatched = (array.counts != expected_counts) & ~(
        is_optional & (array.counts <= 0)
    )
    if is_mismatched.any():
        i = int(np.argmax(is_mismatched))
        samples = samples_text(array, is_mismatched)
        message = f"{array.counts[i]} for {expected_counts[i]} instances {samples}"
        yield finding("USD269", attr.GetPath(), message)


def _check_numbers(
    attr: Any, samples: SampledArray, *, must_be_unit: bool
) -> Iterator[Fault]:
    is_non_finite, is_not_unit = np.zeros((2, len(samples.counts)), bool)
    for i, array in enumerate(samples.arrays):
        values = np.array(array, np.float64) if samples.counts[i] > 0 else np.zeros(0)
        is_non_finite[i] = not np.isfinite(values).all()
        if must_be_unit and not is_non_finite[i] and len(values):
            lengths = np.linalg.norm(values.reshape(-1, 4), axis=1)
            is_not_unit[i] = bool((np.abs(lengths - 1) > UNIT_TOLERANCE).any())
    if is_non_finite.any():
        message = (
            f"{attr.GetName()} are not finite {samples_text(samples, is_non_finite)}"
        )
        yield finding("USD265", attr.GetPath(), message)
    if is_not_unit.any():
        message = (
            f"a quaternion is not of length 1 {samples_text(samples, is_not_unit)}"
        )
        yield finding("USD288", attr.GetPath(), message)
