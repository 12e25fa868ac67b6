"""Extents as USD computes them, at every sample of what they follow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt

from animtool.errors import Fault, counted
from animtool.usd.checks.extents import extent_sources
from animtool.usd.checks.subject import Subject
from animtool.usd.fixes.target import Change, Edit, NotFixableError, Target

NAME = "extent"


def computed(target: Target, fault: Fault) -> Edit:
    """Write `UsdGeom.Boundable.ComputeExtentFromPlugins` at every sample.

    A value of another file is overridden here: that file may be right without the
    motion that this one adds.
    """
    prim = target.prim(fault)
    if not prim.IsA(UsdGeom.Boundable):
        raise NotFixableError("the prim has no extent")
    if _own_spec(target, prim) is None and _varies(prim):
        raise NotFixableError("a variant decides what moves; author it in each variant")

    def edit() -> Change:
        change = _author(target, prim)
        for root in _roots_above(prim):
            # What UsdSkel adds to the joints comes of the extents below.
            if root.GetAttribute(NAME).HasAuthoredValue():
                _author(target, root)
        return change

    return edit


def _author(target: Target, prim: Any) -> Change:
    """Write the extent of a prim at every sample of what it follows."""
    bounded, layer = UsdGeom.Boundable(prim), target.layer
    attr, subject = bounded.GetExtentAttr(), Subject(target.stage)
    sources = extent_sources(subject, prim) or []
    times = sorted({time for one in sources for time in subject.times(one)})
    codes = [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]
    before = [attr.Get(code) for code in codes]
    after = [_bounds(bounded, code) for code in codes]
    if before == after and attr.HasAuthoredValue():
        return _change(before, after)
    spec = _own_spec(target, prim) or _over(target, prim)
    with Sdf.ChangeBlock():
        spec.ClearInfo("timeSamples")
        for time, value in zip(times, after, strict=False):
            layer.SetTimeSample(spec.path, time, value)
        if not times:
            spec.default = after[0]
    return _change(before, after)


def _roots_above(prim: Any) -> Iterator[Any]:
    """Yield the SkelRoots that a prim is in, the nearest first."""
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        if above.IsA(UsdSkel.Root):
            yield above
        above = above.GetParent()


def _own_spec(target: Target, prim: Any) -> Any:
    """Return the extent's spec in the root layer where it is the strongest."""
    attr = prim.GetAttribute(NAME)
    stack = attr.GetPropertyStack(Usd.TimeCode.EarliestTime()) if attr else ()
    return stack[0] if stack and stack[0].layer == target.layer else None


def _varies(prim: Any) -> bool:
    while prim and not prim.IsPseudoRoot():
        if prim.HasVariantSets():
            return True
        prim = prim.GetParent()
    return False


def _over(target: Target, prim: Any) -> Any:
    spec = Sdf.CreatePrimInLayer(target.layer, prim.GetPath())
    held = spec.attributes.get(NAME)
    return held or Sdf.AttributeSpec(spec, NAME, Sdf.ValueTypeNames.Float3Array)


def _bounds(bounded: Any, code: Any) -> Any:
    try:
        found = UsdGeom.Boundable.ComputeExtentFromPlugins(bounded, code)
    except Tf.ErrorException:
        found = None
    if found is None or len(found) != 2 or not np.isfinite(np.array(found)).all():
        raise NotFixableError("USD cannot compute it")
    return Vt.Vec3fArray(found)


def _change(before: list[Any], after: list[Any]) -> Change:
    pairs = [
        np.abs(np.array(old, np.float64) - np.array(new, np.float64)).max()
        for old, new in zip(before, after, strict=True)
        if old is not None and len(old) == 2
    ]
    text = f"computes the extent at {counted(len(after), 'sample')}"
    return Change(text, float(max(pairs)) if pairs else None)
