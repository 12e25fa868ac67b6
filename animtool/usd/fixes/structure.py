"""Fixes for missing or invalid values, schemas, normals and extents."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from animtool.core.errors import Fault, counted
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.checks.extents import bounds_union, computed_extent, extent_sources
from animtool.usd.checks.skinned_bounds import SkinnedBounds
from animtool.usd.fixes.target import (
    Change,
    Edit,
    FixTarget,
    NotFixableError,
    replace_arrays,
    stored_arrays,
)
from animtool.usd.layers.faults import token_array
from animtool.usd.layers.finite import rounded_outwards
from animtool.usd.rigs.prims import self_and_ancestors
from animtool.usd.rigs.rest_pose import local_bind_transforms

# Tolerance of weight sums in float32.
SUM_ROUNDING = 1e-6


def normalize_weights(target: FixTarget, fault: Fault) -> Edit:
    """Normalize the weights of each point to a sum of one."""
    spec = target.attribute(fault)
    attr = target.stage.GetAttributeAtPath(fault.where)
    element_size = int(attr.GetMetadata("elementSize") or 1)
    indices = target.stage.GetAttributeAtPath(f"{fault.where}:indices")
    if indices and indices.HasAuthoredValue():
        raise NotFixableError("the weights are indexed")

    def edit() -> Change:
        changed_points = point_count = 0
        new_arrays = []
        for array in stored_arrays(spec):
            rows = array.astype(np.float64).reshape(-1, element_size)
            weight_sums = rows.sum(axis=1, keepdims=True)
            if not (weight_sums > 0).all() or not np.isfinite(weight_sums).all():
                raise NotFixableError("a point has no weights")
            is_not_normalized = np.abs(weight_sums - 1) > SUM_ROUNDING
            changed_points += int(is_not_normalized.sum())
            point_count += len(rows)
            rows = rows / np.where(is_not_normalized, weight_sums, 1.0)
            new_arrays.append(rows.reshape(array.shape).astype(array.dtype))
        _, largest_change = replace_arrays(spec, new_arrays)
        text = (
            f"divides the weights of {changed_points} of "
            f"{counted(point_count, 'point')} by their sums"
        )
        return Change(text, largest_change)

    return edit


def set_default_prim(target: FixTarget, _: Fault) -> Edit:
    """Set the only root prim as defaultPrim."""
    if target.layer.HasDefaultPrim():
        raise NotFixableError("the default prim is missing from the stage")
    roots = target.stage.GetPseudoRoot().GetAllChildren()
    if len(roots) != 1:
        raise NotFixableError(f"{counted(len(roots), 'root prim')} to choose from")
    name = roots[0].GetName()

    def edit() -> Change:
        target.layer.defaultPrim = name
        return Change(f"sets defaultPrim to {name}")

    return edit


def apply_binding_api(target: FixTarget, fault: Fault) -> Edit:
    """Apply SkelBindingAPI to a prim with skel properties."""
    prim = target.prim(fault)
    target.prim_spec(prim)

    def edit() -> Change:
        with Usd.EditContext(target.stage, target.layer):
            UsdSkel.BindingAPI.Apply(prim)
        return Change("applies SkelBindingAPI")

    return edit


def author_unit_scales(target: FixTarget, fault: Fault) -> Edit:
    """Author unit scales for an animation that lacks only scales."""
    prim = target.prim(fault)
    animation = UsdSkel.Animation(prim)
    other_attributes = (animation.GetTranslationsAttr(), animation.GetRotationsAttr())
    if not all(attr.HasAuthoredValue() for attr in other_attributes):
        raise NotFixableError("translations or rotations are missing, not scales alone")
    spec, count = target.prim_spec(prim), len(token_array(animation.GetJointsAttr()))

    def edit() -> Change:
        attribute = spec.attributes.get("scales") or Sdf.AttributeSpec(
            spec, "scales", Sdf.ValueTypeNames.Half3Array
        )
        attribute.default = Vt.Vec3hArray.FromNumpy(np.ones((count, 3), np.float16))
        return Change(f"writes scales of 1 for {counted(count, 'joint')}")

    return edit


def author_rest_from_bind(target: FixTarget, fault: Fault) -> Edit:
    """Author restTransforms computed from bindTransforms."""
    prim = target.prim(fault)
    skeleton = UsdSkel.Skeleton(prim)
    joints = token_array(skeleton.GetJointsAttr())
    if skeleton.GetRestTransformsAttr().HasAuthoredValue():
        raise NotFixableError(
            "the number of rest transforms differs from the number of joints"
        )
    rest = local_bind_transforms(skeleton, joints)
    if rest is None:
        raise NotFixableError("there are no bind transforms to compute them from")
    spec = target.prim_spec(prim)

    def edit() -> Change:
        attribute = spec.attributes.get("restTransforms") or Sdf.AttributeSpec(
            spec,
            "restTransforms",
            Sdf.ValueTypeNames.Matrix4dArray,
            Sdf.VariabilityUniform,
        )
        attribute.default = Vt.Matrix4dArray.FromNumpy(rest)
        return Change(f"writes restTransforms of {counted(len(joints), 'joint')}")

    return edit


def replace_by_default(target: FixTarget, fault: Fault) -> Edit:
    """Replace equal time samples by a default value."""
    spec = target.attribute(fault)
    layer, path = spec.layer, spec.path
    times = layer.ListTimeSamplesForPath(path)
    values = [layer.QueryTimeSample(path, time) for time in times]
    if not values or spec.HasDefaultValue():
        raise NotFixableError("it has a default and samples")
    if any(value != values[0] for value in values):
        raise NotFixableError("its samples differ")

    def edit() -> Change:
        spec.default = values[0]
        spec.ClearInfo("timeSamples")
        return Change(f"makes a default of {counted(len(times), 'equal sample')}")

    return edit


EXTENT = "extent"


def author_computed_extent(target: FixTarget, fault: Fault) -> Edit:
    """Author `UsdGeom.Boundable.ComputeExtentFromPlugins` at every sample.

    The extent of a SkelRoot is widened to contain its skinned points. An extent
    authored in another file is overridden, since that file lacks this motion.
    """
    prim = target.prim(fault)
    if not prim.IsA(UsdGeom.Boundable):
        raise NotFixableError("the prim has no extent")
    has_variants = any(
        ancestor.HasVariantSets() for ancestor in self_and_ancestors(prim)
    )
    if has_variants and _extent_spec(target, prim) is None:
        raise NotFixableError("a variant sets the motion; author it in each variant")

    def edit() -> Change:
        change = _author_extent(target, prim)
        roots = (
            ancestor
            for ancestor in self_and_ancestors(prim.GetParent())
            if ancestor.IsA(UsdSkel.Root)
        )
        for root in roots:
            # UsdSkel pads joint bounds by the extents of the meshes below.
            if root.GetAttribute(EXTENT).HasAuthoredValue():
                _author_extent(target, root)
        return change

    return edit


def _author_extent(target: FixTarget, prim: Any) -> Change:
    """Author the extent of a prim at every sample of its sources."""
    boundable, layer = UsdGeom.Boundable(prim), target.layer
    attr, checked_stage = boundable.GetExtentAttr(), CheckedStage(target.stage)
    sources = extent_sources(checked_stage, prim) or []
    times = sorted({time for source in sources for time in checked_stage.times(source)})
    codes = [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]
    old_extents = [attr.Get(code) for code in codes]
    skinned_bounds = SkinnedBounds(prim) if prim.IsA(UsdSkel.Root) else None
    new_extents = [_extent_with_skin(boundable, code, skinned_bounds) for code in codes]
    if old_extents == new_extents and attr.HasAuthoredValue():
        return _extent_change(old_extents, new_extents)
    spec = _extent_spec(target, prim) or _create_extent_spec(target, prim)
    with Sdf.ChangeBlock():
        spec.ClearInfo("timeSamples")
        for time, value in zip(times, new_extents, strict=False):
            layer.SetTimeSample(spec.path, time, value)
        if not times:
            spec.default = new_extents[0]
    return _extent_change(old_extents, new_extents)


def _extent_spec(target: FixTarget, prim: Any) -> Any:
    """Return the root layer's extent spec if it is the strongest opinion, else None."""
    attr = prim.GetAttribute(EXTENT)
    stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime()) if attr else ()
    return stack[0] if stack and stack[0].layer == target.layer else None


def _create_extent_spec(target: FixTarget, prim: Any) -> Any:
    spec = Sdf.CreatePrimInLayer(target.layer, prim.GetPath())
    attribute = spec.attributes.get(EXTENT)
    return attribute or Sdf.AttributeSpec(spec, EXTENT, Sdf.ValueTypeNames.Float3Array)


def _extent_with_skin(
    boundable: Any, code: Any, skinned_bounds: SkinnedBounds | None
) -> Any:
    """Return the extent that USD computes, widened to contain the skinned points."""
    extent = computed_extent(boundable, code)
    if extent is None or len(extent) != 2 or not np.isfinite(np.array(extent)).all():
        raise NotFixableError("USD cannot compute it")
    point_bounds = None if skinned_bounds is None else skinned_bounds.at_time(code)
    if point_bounds is None:
        return Vt.Vec3fArray(extent)
    union = bounds_union(np.array(extent, np.float32), rounded_outwards(point_bounds))
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(union, np.float32))


def _extent_change(old_values: list[Any], new_values: list[Any]) -> Change:
    changes = [
        np.abs(np.array(old_value, np.float64) - np.array(new_value, np.float64)).max()
        for old_value, new_value in zip(old_values, new_values, strict=True)
        if old_value is not None and len(old_value) == 2
    ]
    text = f"computes the extent at {counted(len(new_values), 'sample')}"
    return Change(text, float(max(changes)) if changes else None)
