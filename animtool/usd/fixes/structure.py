"""Fixes for missing or invalid values, schemas, normals and extents."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt

from animtool.core.errors import Fault, counted
from animtool.usd.checks.extents import extent_sources, joined_bounds
from animtool.usd.checks.skinned_bounds import SkinnedBounds
from animtool.usd.checks.subject import StageSubject
from animtool.usd.fixes.target import (
    AnyArray,
    Change,
    Edit,
    FixTarget,
    NotFixableError,
    rewrite,
)
from animtool.usd.layers.faults import tokens
from animtool.usd.rigs.prims import upwards
from animtool.usd.rigs.rest_pose import relative_bind

# Of a sum: float32 weights cannot do better.
ROUNDING = 1e-6


def normalised(target: FixTarget, fault: Fault) -> Edit:
    """Normalize the weights of each point to a sum of one."""
    spec = target.attribute(fault)
    attr = target.stage.GetAttributeAtPath(fault.where)
    size = int(attr.GetMetadata("elementSize") or 1)
    indices = target.stage.GetAttributeAtPath(f"{fault.where}:indices")
    if indices and indices.HasAuthoredValue():
        raise NotFixableError("the weights are indexed")

    def edit() -> Change:
        points = total = 0

        def divided(arrays: list[AnyArray]) -> list[AnyArray]:
            nonlocal points, total
            new = []
            for array in arrays:
                rows = array.astype(np.float64).reshape(-1, size)
                sums = rows.sum(axis=1, keepdims=True)
                if not (sums > 0).all() or not np.isfinite(sums).all():
                    raise NotFixableError("a point has no weights")
                wrong = np.abs(sums - 1) > ROUNDING
                points, total = points + int(wrong.sum()), total + len(rows)
                rows = rows / np.where(wrong, sums, 1.0)
                new.append(rows.reshape(array.shape).astype(array.dtype))
            return new

        _, _, largest = rewrite(spec, divided)
        text = f"divides the weights of {points} of {counted(total, 'point')} "
        return Change(f"{text}by their sums", largest)

    return edit


def default_prim(target: FixTarget, _: Fault) -> Edit:
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


def binding_api(target: FixTarget, fault: Fault) -> Edit:
    """Apply SkelBindingAPI to a prim with skel properties."""
    prim = target.prim(fault)
    target.prim_spec(prim)

    def edit() -> Change:
        with Usd.EditContext(target.stage, target.layer):
            UsdSkel.BindingAPI.Apply(prim)
        return Change("applies SkelBindingAPI")

    return edit


def unit_scales(target: FixTarget, fault: Fault) -> Edit:
    """Author unit scales for an animation that lacks only scales."""
    prim = target.prim(fault)
    animation = UsdSkel.Animation(prim)
    others = (animation.GetTranslationsAttr(), animation.GetRotationsAttr())
    if not all(attr.HasAuthoredValue() for attr in others):
        raise NotFixableError("translations or rotations are missing, not scales alone")
    spec, count = target.prim_spec(prim), len(tokens(animation.GetJointsAttr()))

    def edit() -> Change:
        attribute = spec.attributes.get("scales") or Sdf.AttributeSpec(
            spec, "scales", Sdf.ValueTypeNames.Half3Array
        )
        attribute.default = Vt.Vec3hArray.FromNumpy(np.ones((count, 3), np.float16))
        return Change(f"writes scales of 1 for {counted(count, 'joint')}")

    return edit


def rest_from_bind(target: FixTarget, fault: Fault) -> Edit:
    """Author restTransforms from the bind transforms relative to the parents."""
    prim = target.prim(fault)
    skeleton = UsdSkel.Skeleton(prim)
    joints = tokens(skeleton.GetJointsAttr())
    if skeleton.GetRestTransformsAttr().HasAuthoredValue():
        raise NotFixableError(
            "the number of rest transforms differs from the number of joints"
        )
    rest = relative_bind(skeleton, joints)
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


def default_value(target: FixTarget, fault: Fault) -> Edit:
    """Replace equal time samples by a default."""
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


NAME = "extent"


def computed(target: FixTarget, fault: Fault) -> Edit:
    """Author `UsdGeom.Boundable.ComputeExtentFromPlugins` at every sample.

    That of a SkelRoot is widened where skinned points leave it.

    A value of another file is overridden here: that file may be right without the
    motion that this one adds.
    """
    prim = target.prim(fault)
    if not prim.IsA(UsdGeom.Boundable):
        raise NotFixableError("the prim has no extent")
    varies = any(above.HasVariantSets() for above in upwards(prim))
    if varies and _layer_spec(target, prim) is None:
        raise NotFixableError("a variant sets the motion; author it in each variant")

    def edit() -> Change:
        change = _author(target, prim)
        roots = (p for p in upwards(prim.GetParent()) if p.IsA(UsdSkel.Root))
        for root in roots:
            # What UsdSkel adds to the joints comes of the extents below.
            if root.GetAttribute(NAME).HasAuthoredValue():
                _author(target, root)
        return change

    return edit


def _author(target: FixTarget, prim: Any) -> Change:
    """Author the extent of a prim at every sample of its sources."""
    bounded, layer = UsdGeom.Boundable(prim), target.layer
    attr, subject = bounded.GetExtentAttr(), StageSubject(target.stage)
    sources = extent_sources(subject, prim) or []
    times = sorted({time for one in sources for time in subject.times(one)})
    codes = [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]
    before = [attr.Get(code) for code in codes]
    skinned = SkinnedBounds(prim) if prim.IsA(UsdSkel.Root) else None
    after = [_bounds(bounded, code, skinned) for code in codes]
    if before == after and attr.HasAuthoredValue():
        return _change(before, after)
    spec = _layer_spec(target, prim) or _over(target, prim)
    with Sdf.ChangeBlock():
        spec.ClearInfo("timeSamples")
        for time, value in zip(times, after, strict=False):
            layer.SetTimeSample(spec.path, time, value)
        if not times:
            spec.default = after[0]
    return _change(before, after)


def _layer_spec(target: FixTarget, prim: Any) -> Any:
    """Return the extent's root layer spec if it is the strongest opinion."""
    attr = prim.GetAttribute(NAME)
    stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime()) if attr else ()
    return stack[0] if stack and stack[0].layer == target.layer else None


def _over(target: FixTarget, prim: Any) -> Any:
    spec = Sdf.CreatePrimInLayer(target.layer, prim.GetPath())
    attribute = spec.attributes.get(NAME)
    return attribute or Sdf.AttributeSpec(spec, NAME, Sdf.ValueTypeNames.Float3Array)


def _bounds(bounded: Any, code: Any, skinned: SkinnedBounds | None) -> Any:
    """Return the extent USD computes, widened by skinned points outside it."""
    try:
        extent = UsdGeom.Boundable.ComputeExtentFromPlugins(bounded, code)
    except Tf.ErrorException:
        extent = None
    if extent is None or len(extent) != 2 or not np.isfinite(np.array(extent)).all():
        raise NotFixableError("USD cannot compute it")
    posed = None if skinned is None else skinned.at(code)
    if posed is None:
        return Vt.Vec3fArray(extent)
    # Outwards, so that rounding leaves no point outside.
    ends = np.array([[-np.inf], [np.inf]], np.float32)
    outside = np.nextafter(posed.astype(np.float32), ends, dtype=np.float32)
    wide = joined_bounds(np.array(extent, np.float32), outside)
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(wide, np.float32))


def _change(before: list[Any], after: list[Any]) -> Change:
    pairs = [
        np.abs(np.array(old, np.float64) - np.array(new, np.float64)).max()
        for old, new in zip(before, after, strict=True)
        if old is not None and len(old) == 2
    ]
    text = f"computes the extent at {counted(len(after), 'sample')}"
    return Change(text, float(max(pairs)) if pairs else None)
