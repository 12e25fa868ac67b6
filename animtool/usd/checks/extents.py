"""Checks on extents, over all samples.

The extent of a SkelRoot with one skeleton is the bounds of its joints plus a constant
padding, so all samples are compared at once and USD computes only the outliers. For
other prims USD computes `MAX_ASKED` samples.
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
from animtool.usd.checks.skinned_bounds import SkinnedBounds, overhang
from animtool.usd.checks.subject import AnyArray, SampledArray, StageSubject, at_samples
from animtool.usd.layers.faults import (
    joint_parents,
    matrix_array,
    tokens,
    transform_attributes,
)
from animtool.usd.rigs.prims import decompose

# Of the diagonal: text files with four digits are within.
TOLERANCE = 1e-3
# Where nothing but USD itself can tell.
MAX_ASKED = 50
BLOCK = 2048
# What the extent of copies follows, and their prototypes.
_PLACING = ("positions", "protoIndices", "orientations", "orientationsf", "scales")


def check_extents(subject: StageSubject) -> Iterator[Fault]:
    """Check that prims have an extent equal to the one USD computes."""
    if subject.alone:
        return
    for prim in subject.prims:
        if not prim.IsA(UsdGeom.Boundable) or not prim.IsDefined():
            continue
        bounded = UsdGeom.Boundable(prim)
        source = extent_sources(subject, prim)
        attr = bounded.GetExtentAttr()
        # A rig that does not move may have its extent in the layer that moves it.
        if source is None or not (source or attr.HasAuthoredValue()):
            continue
        # That of an instance holds whatever its rig is ever seen to do.
        inherited = prim.IsInstance() or prim.IsAbstract()
        if inherited and attr.HasAuthoredValue():
            continue
        if not attr.HasAuthoredValue():
            yield finding(
                "USD250", prim.GetPath(), f"this {prim.GetTypeName()} has none"
            )
        elif not prim.IsA(UsdSkel.Root) or _joints_below(prim):
            # Without joints, USD computes a point at the origin, or all of space.
            yield from _compare(subject, bounded, attr, source)


def extent_sources(subject: StageSubject, prim: Any) -> list[Any] | None:
    """Return the attributes that determine an extent; None if there are none.

    Where points or joints are no numbers, there is nothing to compare with.
    """
    if prim.IsA(UsdSkel.Root):
        below = list(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))
        skeletons = [each for each in below if each.IsA(UsdSkel.Skeleton)]
        has_points = any(each.IsA(UsdGeom.PointBased) for each in below)
        if not skeletons or not (has_points or _joints_below(prim)):
            return None
        animations = [
            UsdSkel.BindingAPI(each).GetInheritedAnimationSource() for each in skeletons
        ]
        sources = [UsdSkel.Animation(each) for each in animations if each]
        return [
            attr
            for each in sources
            if each
            for attr in transform_attributes(each).values()
        ]
    if prim.IsA(UsdGeom.PointBased):
        attr = PointReader(prim).attr
        # Points that move are checked as they are read, and a mesh's extent with them.
        sampled_points = prim.IsA(UsdGeom.Mesh) and bool(subject.times(attr))
        return [attr] if attr.HasAuthoredValue() and not sampled_points else None
    if prim.IsA(UsdGeom.PointInstancer):
        return _copied_sources(subject, UsdGeom.PointInstancer(prim))
    return None


def _copied_sources(subject: StageSubject, instancer: Any) -> list[Any] | None:
    """Return the attributes that determine the extent of instances.

    None of copies of copies: USD would go on for ever where these hold themselves.
    """
    copied = [
        subject.stage.GetPrimAtPath(path)
        for path in instancer.GetPrototypesRel().GetForwardedTargets()
    ]
    if not all(copied) or any(
        below.IsA(UsdGeom.PointInstancer)
        for prim in copied
        for below in Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    ):
        return None
    attrs = [instancer.GetPrim().GetAttribute(name) for name in _PLACING]
    sources = [attr for attr in attrs if attr and attr.HasAuthoredValue()]
    return sources if instancer.GetPositionsAttr() in sources else None


def _joints_below(root: Any) -> bool:
    """Return whether a Skeleton below a SkelRoot has joints."""
    return any(
        tokens(UsdSkel.Skeleton(prim).GetJointsAttr())
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies())
        if prim.IsA(UsdSkel.Skeleton)
    )


def _compare(
    subject: StageSubject, bounded: Any, attr: Any, source: list[Any]
) -> Iterator[Fault]:
    sampled = subject.sampled(attr)
    wrong = sampled.counts != 2
    if wrong.any():
        count = sampled.counts[np.flatnonzero(wrong)[0]]
        message = f"{count} corners instead of 2, {at_samples(sampled, wrong)}"
        yield finding("USD251", attr.GetPath(), message)
        return
    extents = sampled.rows(2, 3)[1].astype(np.float64)
    moving = sorted({time for one in source for time in subject.times(one)})
    authored = extents if sampled.animated else None
    times = sampled.times if authored is not None else np.array(moving or [np.nan])
    expected = _joint_bounds(subject, bounded, source, times)
    exact = authored is not None or not moving
    suspects, flagged = _chosen(len(times)), None
    if expected is not None:
        beyond, _ = bounds_difference(extents, expected, exact=exact)
        flagged = np.flatnonzero(~(beyond <= 0))
        suspects = np.sort(flagged[np.argsort(-beyond[flagged])[:MAX_ASKED]])
    skinned = _SkinnedRoot(bounded)
    bad = []
    for i in suspects.tolist():
        code = Usd.TimeCode.Default() if np.isnan(times[i]) else Usd.TimeCode(times[i])
        computed = _computed(bounded, code)
        if computed is None:
            return
        bounds = np.array(computed, np.float64).reshape(1, 2, 3)
        if not np.isfinite(bounds).all():
            return
        if (bounds[0, 0] > bounds[0, 1]).all():
            # Of no points: USD computes the bounds of nothing, and none is wrong.
            continue
        mine = extents[i : i + 1] if authored is not None else extents
        beyond, off = bounds_difference(mine, bounds, exact=exact)
        if beyond[0] > 0 and not skinned.holds(code, mine, bounds):
            bad.append((i, off[0]))
    if not bad:
        return
    frames = np.array([i for i, _ in bad])
    if flagged is not None and len(bad) == len(suspects):
        # Those that USD was asked about are the farthest off of all.
        frames = flagged
    worst, when = max((gap, -i) for i, gap in bad)
    sampled_at = SampledArray(times, [], np.zeros(len(times), np.int64))
    more = " or more" if flagged is None and len(suspects) < len(times) else ""
    lead = "off by" if exact else "what moves exceeds it by"
    message = f"{lead} {worst:.3g}{more} {at_samples(sampled_at, frames)}"
    if len(frames) > 1:
        message += f", most at {frame_label(times[-when])}"
    if skinned.bounds is not None:
        message += _overhang_text(bounded.GetPrim(), extents, times)
    yield finding("USD251", attr.GetPath(), message)


class _SkinnedRoot:
    """Skinned points of a SkelRoot, read only if its extent is unexpected."""

    def __init__(self, bounded: Any) -> None:
        self._prim = bounded.GetPrim()

    @cached_property
    def bounds(self) -> SkinnedBounds | None:
        """Bounds of its points; None for other prims."""
        return SkinnedBounds(self._prim) if self._prim.IsA(UsdSkel.Root) else None

    def holds(self, code: Any, extent: FloatArray, computed: FloatArray) -> bool:
        """Return whether an extent is USD's, widened by points outside it."""
        posed = None if self.bounds is None else self.bounds.at(code)
        if posed is None:
            return False
        widened = joined_bounds(computed[0], posed)[None]
        return bool(bounds_difference(extent, widened, exact=True)[0][0] <= 0)


def joined_bounds(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the union of two bounds ``(2, 3)``.

    >>> joined_bounds(np.array([[0.0], [2.0]]), np.array([[1.0], [3.0]])).tolist()
    [[0.0], [3.0]]
    """
    low, high = np.minimum(first[0], second[0]), np.maximum(first[1], second[1])
    return np.stack([low, high])


def _overhang_text(root: Any, extents: FloatArray, times: FloatArray) -> str:
    """Describe how far skinned points leave the extents of a SkelRoot, and when."""
    over = overhang(root, extents, times.tolist())
    # What rounding moves is no overhang, as of `bounds_difference`.
    reach = float(np.abs(extents).max(initial=0.0))
    if over is None or over[0] <= 1e-6 * (1 + reach):
        return "; no skinned point exceeds it"
    most, when, of_all = over
    at = "" if np.isnan(when) else f" at time code {frame_label(when)}"
    more = "" if of_all else " or more"
    return f"; skinned points exceed it by {most:.4g}{more}{at}"


def bounds_difference(
    extents: FloatArray, bounds: FloatArray, *, exact: bool
) -> tuple[FloatArray, FloatArray]:
    """Return how far extents differ from bounds: beyond the tolerance, and in total.

    The first is at most 0 where they are within it.

    ``extents`` ``(F, 2, 3)``, ``bounds`` ``(F, 2, 3)``.
    """
    gaps = np.stack([extents[:, 0] - bounds[:, 0], bounds[:, 1] - extents[:, 1]])
    off = (np.abs(gaps) if exact else gaps).max(axis=(0, 2))
    sizes = np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)
    reach = np.abs(bounds).max(axis=(1, 2))
    return off - TOLERANCE * sizes - 1e-6 * (1 + reach), off


def _computed(bounded: Any, code: Any) -> Any:
    """Return the extent USD computes; None if it cannot, as for a broken Skeleton."""
    try:
        return UsdGeom.Boundable.ComputeExtentFromPlugins(bounded, code)
    except Tf.ErrorException:
        return None


def _chosen(count: int) -> IntArray:
    """Return up to `MAX_ASKED` evenly spaced indices below a count."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_ASKED)).astype(np.int64))


def _joint_bounds(
    subject: StageSubject, bounded: Any, source: list[Any], times: FloatArray
) -> FloatArray | None:
    """Return the joint bounds of a one-skeleton SkelRoot per sample ``(F, 2, 3)``.

    None where only USD can tell: more skeletons or one that is placed, attributes
    sampled at other times, values that other checks refuse.
    """
    root = bounded.GetPrim()
    if len(source) != 3 or not root.IsA(UsdSkel.Root) or len(times) <= MAX_ASKED:
        return None
    skeletons = [p for p in Usd.PrimRange(root) if p.IsA(UsdSkel.Skeleton)]
    if len(skeletons) != 1 or skeletons[0].GetParent() != root:
        return None
    if UsdGeom.Xformable(skeletons[0]).GetXformOpOrderAttr().Get():
        return None
    skeleton = UsdSkel.Skeleton(skeletons[0])
    locals_ = _locals(subject, skeleton, source, times)
    if locals_ is None:
        return None
    joints = tokens(skeleton.GetJointsAttr())
    bounds = _bounds(joint_parents(joints), *locals_)
    code = Usd.TimeCode(times[0])
    first = _computed(bounded, code)
    if first is None:
        return None
    pad = np.array(first, np.float64).reshape(2, 3) - bounds[0]
    padded: FloatArray = bounds + pad
    return padded


def _locals(
    subject: StageSubject, skeleton: Any, source: list[Any], times: FloatArray
) -> tuple[AnyArray, AnyArray, AnyArray] | None:
    """Return local translations, rotations and scales ``(F or 1, J, …)``."""
    joints = tokens(skeleton.GetJointsAttr())
    parents = joint_parents(joints)
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    animated = tokens(UsdSkel.Animation(source[0].GetPrim()).GetJointsAttr())
    columns = np.array(
        [joints.index(n) if n in joints else -1 for n in animated], np.int64
    )
    complete = (
        len(animated) == len(joints) and (columns == np.arange(len(joints))).all()
    )
    if (parents >= np.arange(len(joints))).any() or (columns < 0).any():
        return None
    if not complete and len(rest) != len(joints):
        return None
    resting = () if complete else decompose(rest)
    parts = []
    for part, (attr, width) in enumerate(zip(source, (3, 4, 3), strict=True)):
        sampled = subject.sampled(attr)
        if (sampled.counts != len(animated)).any() or not len(sampled.times):
            return None
        if sampled.animated and not np.array_equal(sampled.times, times):
            return None
        values = sampled.rows(len(animated), width)[1]
        if not np.isfinite(values).all():
            return None
        if not complete:
            filled = np.repeat(resting[part][None], len(values), axis=0)
            filled[:, columns] = values
            values = filled
        parts.append(values)
    return parts[0], parts[1], parts[2]


def _bounds(
    parents: IntArray, moves: AnyArray, rotations: AnyArray, sizes: AnyArray
) -> FloatArray:
    """Return the bounds of the joint origins ``(F, 2, 3)``."""
    count = max(len(moves), len(rotations), len(sizes))
    bounds = np.zeros((count, 2, 3))
    plain = bool((sizes == 1).all())
    for begin in range(0, count, BLOCK):
        part = slice(begin, min(begin + BLOCK, count))
        frames = part.stop - begin
        t, r, s = (_block(values, part, frames) for values in (moves, rotations, sizes))
        positions = np.zeros((frames, len(parents), 3))
        linear = np.zeros((frames, len(parents), 3, 3))
        scales = None if plain else s
        _kernels.forward_kinematics(parents, t, r, scales, positions, linear)
        bounds[part, 0] = positions.min(axis=1)
        bounds[part, 1] = positions.max(axis=1)
    return bounds


def _block(values: AnyArray, part: slice, frames: int) -> FloatArray:
    rows = values[part] if len(values) > 1 else np.repeat(values, frames, axis=0)
    return np.ascontiguousarray(rows, np.float64)
