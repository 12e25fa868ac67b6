"""Checks on extents, over all samples.

The extent of a SkelRoot with one skeleton is the bounds of its joints plus a constant
padding, so all samples are compared at once and USD computes only the outliers. For
other prims USD computes up to `MAX_COMPUTED_SAMPLES` samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdSkel

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import frame_label
from animtool.core.errors import Fault
from animtool.core.rules import finding
from animtool.usd.caches.reader import PointReader
from animtool.usd.checks.checked_stage import (
    AnyArray,
    CheckedStage,
    SampledArray,
    samples_text,
)
from animtool.usd.checks.skinned_bounds import (
    SkinnedBounds,
    find_overhang,
    spaced_indices,
    time_code_of,
)
from animtool.usd.layers.faults import (
    joint_parents,
    matrix_array,
    token_array,
    transform_attributes,
)
from animtool.usd.rigs.prims import decompose

# Tolerance relative to the diagonal; text files with four digits are within it.
EXTENT_TOLERANCE = 1e-3
# Maximum samples whose extents USD computes.
MAX_COMPUTED_SAMPLES = 50
BLOCK_FRAMES = 2048
# Attributes that determine the extent of instances, with their prototypes.
_INSTANCE_ATTRIBUTES = (
    "positions",
    "protoIndices",
    "orientations",
    "orientationsf",
    "scales",
)


def check_extents(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that prims have an extent equal to the one USD computes."""
    if checked_stage.has_only_overs:
        return
    for prim in checked_stage.prims:
        if not prim.IsA(UsdGeom.Boundable) or not prim.IsDefined():
            continue
        boundable = UsdGeom.Boundable(prim)
        source = extent_sources(checked_stage, prim)
        attr = boundable.GetExtentAttr()
        # A static rig may have its extent in the layer that animates it.
        if source is None or not (source or attr.HasAuthoredValue()):
            continue
        # The extent of an instance covers all motions of its rig.
        is_exempt = prim.IsInstance() or prim.IsAbstract()
        if is_exempt and attr.HasAuthoredValue():
            continue
        if not attr.HasAuthoredValue():
            yield finding(
                "USD250", prim.GetPath(), f"this {prim.GetTypeName()} has no extent"
            )
        elif not prim.IsA(UsdSkel.Root) or _has_joints(prim):
            # Without joints, USD computes a point at the origin, or infinite bounds.
            yield from _compare_extents(checked_stage, boundable, attr, source)


def extent_sources(checked_stage: CheckedStage, prim: Any) -> list[Any] | None:
    """Return the attributes that determine an extent; None if there are none.

    Also None if points or joints are not finite, since there is nothing to compare
    with.
    """
    if prim.IsA(UsdSkel.Root):
        descendants = list(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))
        skeletons = [
            descendant for descendant in descendants if descendant.IsA(UsdSkel.Skeleton)
        ]
        has_points = any(
            descendant.IsA(UsdGeom.PointBased) for descendant in descendants
        )
        if not skeletons or not (has_points or _has_joints(prim)):
            return None
        animations = [
            UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource()
            for skeleton in skeletons
        ]
        animation_schemas = [
            UsdSkel.Animation(animation) for animation in animations if animation
        ]
        return [
            attr
            for animation in animation_schemas
            if animation
            for attr in transform_attributes(animation).values()
        ]
    if prim.IsA(UsdGeom.PointBased):
        attr = PointReader(prim).points_attr
        # Extents of meshes with animated points are checked together with the points.
        has_sampled_points = prim.IsA(UsdGeom.Mesh) and bool(checked_stage.times(attr))
        return [attr] if attr.HasAuthoredValue() and not has_sampled_points else None
    if prim.IsA(UsdGeom.PointInstancer):
        return _instance_sources(checked_stage, UsdGeom.PointInstancer(prim))
    return None


def _instance_sources(checked_stage: CheckedStage, instancer: Any) -> list[Any] | None:
    """Return the attributes that determine the extent of instances.

    Returns None for nested instancers: USD does not terminate if one contains itself.
    """
    prototypes = [
        checked_stage.stage.GetPrimAtPath(path)
        for path in instancer.GetPrototypesRel().GetForwardedTargets()
    ]
    if not all(prototypes) or any(
        descendant.IsA(UsdGeom.PointInstancer)
        for prim in prototypes
        for descendant in Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    ):
        return None
    attrs = [instancer.GetPrim().GetAttribute(name) for name in _INSTANCE_ATTRIBUTES]
    sources = [attr for attr in attrs if attr and attr.HasAuthoredValue()]
    return sources if instancer.GetPositionsAttr() in sources else None


def _has_joints(skel_root: Any) -> bool:
    """Return whether a Skeleton below a SkelRoot has joints."""
    return any(
        token_array(UsdSkel.Skeleton(prim).GetJointsAttr())
        for prim in Usd.PrimRange(skel_root, Usd.TraverseInstanceProxies())
        if prim.IsA(UsdSkel.Skeleton)
    )


def _compare_extents(
    checked_stage: CheckedStage, boundable: Any, attr: Any, source_attributes: list[Any]
) -> Iterator[Fault]:
    array = checked_stage.sampled_array(attr)
    is_wrong_count = array.counts != 2
    if is_wrong_count.any():
        count = array.counts[np.flatnonzero(is_wrong_count)[0]]
        message = f"the extent has {count} corners instead of 2, "
        message += samples_text(array, is_wrong_count)
        yield finding("USD251", attr.GetPath(), message)
        return
    extents = array.rows(2, 3)[1].astype(np.float64)
    animated_times = sorted(
        {
            time
            for attribute in source_attributes
            for time in checked_stage.times(attribute)
        }
    )
    sampled_extents = extents if array.is_animated else None
    times = array.times
    if sampled_extents is None:
        times = np.array(animated_times or [np.nan])
    bounds_from_joints = _joint_bounds(
        checked_stage, boundable, source_attributes, times
    )
    is_exact = sampled_extents is not None or not animated_times
    candidate_indices, outlier_indices = (
        spaced_indices(len(times), MAX_COMPUTED_SAMPLES),
        None,
    )
    if bounds_from_joints is not None:
        excess, _ = bounds_difference(extents, bounds_from_joints, must_equal=is_exact)
        outlier_indices = np.flatnonzero(~(excess <= 0))
        candidate_indices = np.sort(
            outlier_indices[np.argsort(-excess[outlier_indices])[:MAX_COMPUTED_SAMPLES]]
        )
    skinned_root = _SkinnedRoot(boundable)
    faulty_samples = []
    for i in candidate_indices.tolist():
        code = time_code_of(times[i])
        usd_extent = computed_extent(boundable, code)
        if usd_extent is None:
            return
        bounds = np.array(usd_extent, np.float64).reshape(1, 2, 3)
        if not np.isfinite(bounds).all():
            return
        if (bounds[0, 0] > bounds[0, 1]).all():
            # Without points USD computes empty bounds, and any extent is correct.
            continue
        extent = extents[i : i + 1] if sampled_extents is not None else extents
        excess, distance = bounds_difference(extent, bounds, must_equal=is_exact)
        if excess[0] > 0 and not skinned_root.is_valid_extent(code, extent, bounds):
            faulty_samples.append((i, distance[0]))
    if not faulty_samples:
        return
    faulty_indices = np.array([i for i, _ in faulty_samples])
    if outlier_indices is not None and len(faulty_samples) == len(candidate_indices):
        # The samples that USD computed have the largest deviations.
        faulty_indices = outlier_indices
    largest, negative_index = max((gap, -i) for i, gap in faulty_samples)
    sample_times = SampledArray(times, [], np.zeros(len(times), np.int64))
    or_more = (
        " or more"
        if outlier_indices is None and len(candidate_indices) < len(times)
        else ""
    )
    prefix = "the extent is off by" if is_exact else "the motion exceeds the extent by"
    message = (
        f"{prefix} {largest:.3g}{or_more} {samples_text(sample_times, faulty_indices)}"
    )
    if len(faulty_indices) > 1:
        message += f", and most at {frame_label(times[-negative_index])}"
    if skinned_root.bounds is not None:
        message += _overhang_text(boundable.GetPrim(), extents, times)
    yield finding("USD251", attr.GetPath(), message)


class _SkinnedRoot:
    """Skinned points of a SkelRoot, read only if its extent is unexpected."""

    def __init__(self, boundable: Any) -> None:
        self._prim = boundable.GetPrim()

    @cached_property
    def bounds(self) -> SkinnedBounds | None:
        """Bounds of the skinned points; None if the prim is not a SkelRoot."""
        return SkinnedBounds(self._prim) if self._prim.IsA(UsdSkel.Root) else None

    def is_valid_extent(
        self, code: Any, extent: FloatArray, usd_extent: FloatArray
    ) -> bool:
        """Return whether an extent is USD's, extended to contain all skinned points."""
        point_bounds = None if self.bounds is None else self.bounds.at_time(code)
        if point_bounds is None:
            return False
        expected_bounds = bounds_union(usd_extent[0], point_bounds)[None]
        return bool(
            bounds_difference(extent, expected_bounds, must_equal=True)[0][0] <= 0
        )


def bounds_union(first_bounds: AnyArray, second_bounds: AnyArray) -> AnyArray:
    """Return the union of two bounds ``(2, 3)``.

    >>> bounds_union(np.array([[0.0], [2.0]]), np.array([[1.0], [3.0]])).tolist()
    [[0.0], [3.0]]
    """
    lowest, highest = (
        np.minimum(first_bounds[0], second_bounds[0]),
        np.maximum(first_bounds[1], second_bounds[1]),
    )
    return np.stack([lowest, highest])


def _overhang_text(root: Any, extents: FloatArray, times: FloatArray) -> str:
    """Return as text how far and when skinned points exceed a SkelRoot's extents."""
    overhang = find_overhang(root, extents, times.tolist())
    # Overhangs within rounding do not count, as in `bounds_difference`.
    max_magnitude = float(np.abs(extents).max(initial=0.0))
    if overhang is None or overhang[0] <= 1e-6 * (1 + max_magnitude):
        return "; no skinned point exceeds it"
    largest_distance, code, has_same_joints = overhang
    time_text = "" if np.isnan(code) else f" at time code {frame_label(code)}"
    or_more = "" if has_same_joints else " or more"
    return f"; skinned points exceed it by {largest_distance:.4g}{or_more}{time_text}"


def bounds_difference(
    extents: FloatArray, bounds: FloatArray, *, must_equal: bool
) -> tuple[FloatArray, FloatArray]:
    """Return by how much bounds exceed extents, less a tolerance and in full ``(F,)``.

    The first is at most 0 within the tolerance. Both inputs are ``(F, 2, 3)``. With
    ``must_equal``, extents that are too large differ as well.
    """
    gaps = np.stack([extents[:, 0] - bounds[:, 0], bounds[:, 1] - extents[:, 1]])
    distances = (np.abs(gaps) if must_equal else gaps).max(axis=(0, 2))
    sizes = np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)
    magnitudes = np.abs(bounds).max(axis=(1, 2))
    return distances - EXTENT_TOLERANCE * sizes - 1e-6 * (1 + magnitudes), distances


def computed_extent(boundable: Any, code: Any) -> Any:
    """Return the extent USD computes; None if it cannot, as for a broken Skeleton."""
    try:
        return UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, code)
    except Tf.ErrorException:
        return None


def _joint_bounds(
    checked_stage: CheckedStage, boundable: Any, sources: list[Any], times: FloatArray
) -> FloatArray | None:
    """Return the joint bounds of a one-skeleton SkelRoot per sample ``(F, 2, 3)``.

    None if only USD can compute them: several skeletons, one with a transform, samples
    at other times, or values that other checks refuse.
    """
    root = boundable.GetPrim()
    if (
        len(sources) != 3
        or not root.IsA(UsdSkel.Root)
        or len(times) <= MAX_COMPUTED_SAMPLES
    ):
        return None
    skeletons = [prim for prim in Usd.PrimRange(root) if prim.IsA(UsdSkel.Skeleton)]
    if len(skeletons) != 1 or skeletons[0].GetParent() != root:
        return None
    if UsdGeom.Xformable(skeletons[0]).GetXformOpOrderAttr().Get():
        return None
    skeleton = UsdSkel.Skeleton(skeletons[0])
    transforms = _local_transforms(checked_stage, skeleton, sources, times)
    if transforms is None:
        return None
    joints = token_array(skeleton.GetJointsAttr())
    bounds = _origin_bounds(joint_parents(joints), *transforms)
    first_extent = computed_extent(boundable, Usd.TimeCode(times[0]))
    if first_extent is None:
        return None
    padding = np.array(first_extent, np.float64).reshape(2, 3) - bounds[0]
    padded_bounds: FloatArray = bounds + padding
    return padded_bounds


def _local_transforms(
    checked_stage: CheckedStage, skeleton: Any, sources: list[Any], times: FloatArray
) -> tuple[AnyArray, AnyArray, AnyArray] | None:
    """Return local translations, rotations and scales ``(F or 1, J, …)``."""
    joints = token_array(skeleton.GetJointsAttr())
    parents = joint_parents(joints)
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    animated_joints = token_array(
        UsdSkel.Animation(sources[0].GetPrim()).GetJointsAttr()
    )
    columns = np.array(
        [joints.index(n) if n in joints else -1 for n in animated_joints], np.int64
    )
    has_same_joints = (
        len(animated_joints) == len(joints)
        and (columns == np.arange(len(joints))).all()
    )
    if (parents >= np.arange(len(joints))).any() or (columns < 0).any():
        return None
    if not has_same_joints and len(rest) != len(joints):
        return None
    rest_components = () if has_same_joints else decompose(rest)
    components = []
    for component, (attr, width) in enumerate(zip(sources, (3, 4, 3), strict=True)):
        array = checked_stage.sampled_array(attr)
        if (array.counts != len(animated_joints)).any() or not len(array.times):
            return None
        if array.is_animated and not np.array_equal(array.times, times):
            return None
        values = array.rows(len(animated_joints), width)[1]
        if not np.isfinite(values).all():
            return None
        if not has_same_joints:
            all_joints = np.repeat(
                rest_components[component][None], len(values), axis=0
            )
            all_joints[:, columns] = values
            values = all_joints
        components.append(values)
    return components[0], components[1], components[2]


def _origin_bounds(
    parents: IntArray,
    translations: AnyArray,
    rotations: AnyArray,
    joint_scales: AnyArray,
) -> FloatArray:
    """Return the bounds of the joint origins ``(F, 2, 3)``."""
    total_frames = max(len(translations), len(rotations), len(joint_scales))
    bounds = np.zeros((total_frames, 2, 3))
    is_unscaled = bool((joint_scales == 1).all())
    for begin in range(0, total_frames, BLOCK_FRAMES):
        block = slice(begin, min(begin + BLOCK_FRAMES, total_frames))
        frame_count = block.stop - begin
        t, r, s = (
            _frame_block(values, block, frame_count)
            for values in (translations, rotations, joint_scales)
        )
        positions = np.zeros((frame_count, len(parents), 3))
        linear = np.zeros((frame_count, len(parents), 3, 3))
        scales = None if is_unscaled else s
        _kernels.forward_kinematics(parents, t, r, scales, positions, linear)
        bounds[block, 0] = positions.min(axis=1)
        bounds[block, 1] = positions.max(axis=1)
    return bounds


def _frame_block(values: AnyArray, block: slice, frame_count: int) -> FloatArray:
    block_values = (
        values[block] if len(values) > 1 else np.repeat(values, frame_count, axis=0)
    )
    return np.ascontiguousarray(block_values, np.float64)
