"""A SkelAnimation on a stage as a take."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, FormatError, Severity, excerpt, listed
from animtool.maths import so3
from animtool.rates import rate_from_float
from animtool.rig.parts import AttachKind, Shape
from animtool.rig.skeleton import Rig
from animtool.take import Channel, Clock, Motion, Take, TakeStream
from animtool.units import unit_name
from animtool.usd.layers import usd_errors
from animtool.usd.library import TakeSet, find_take_set, select_take, take_range
from animtool.usd.placement import MOST_NAMED, character_paths
from animtool.usd.rig_prims import (
    SkeletonRig,
    array_value,
    composition_notices,
    decompose,
    find_skeletons,
    open_stage,
    others_notice,
    prim_below,
    rig_from_tokens,
    skeleton_rig,
    up_axis,
)

__all__ = ["read_usd"]

# Time codes are doubles of fractions such as 1001 + 1/5: this finds them again.
LARGEST_STEP_DENOMINATOR = 10_000
# Sub-frame samples about each frame make a grid finer than the samples; beyond this
# it is no grid but a curve's own keys.
FINEST_GRID = 8
UNIT_SCALE_TOLERANCE = 1e-6
# More frames than any take of unevenly spaced keys: there, a key has gone astray.
MOST_FRAMES = 100_000


def read_usd(
    path: Path | str, *, prim_path: str | None = None, take: str | None = None
) -> TakeStream:
    """Read the animation of a character on a stage, or of an animation layer alone.

    Joints that the animation lacks are at rest. A SkelRoot (or a prim below it) that
    moves carries the roots along; one that only stands somewhere does not: where a
    character is placed is no part of its take. A layer without its rig has no rest
    pose: its joints rest at their first sample.

    Args:
        path: A USD file.
        prim_path: The character, where the stage has several.
        take: Which take of a clip library; None is the one that it selects.

    Raises:
        FormatError: The file cannot be read, holds no skeletal animation, or one
            that UsdSkel would ignore.
        OptionError: ``prim_path`` is no path, or there is no such take (USD031).
    """
    path = Path(path)
    with usd_errors(path):
        return _read_stage(open_stage(path), path, prim_path, take)


def _read_stage(
    stage: Any, path: Path, prim_path: str | None, take: str | None
) -> TakeStream:
    below = prim_below(stage, prim_path)
    takes = _takes(stage, below)
    if take is not None:
        takes = select_take(takes, take, str(path))
    stream = _read_selected(stage, path, below)
    if takes is not None:
        stream.details["takes"] = list(takes.names)
        stream.details["take"] = takes.selected
    return stream


def _takes(stage: Any, below: str) -> TakeSet | None:
    """Return the takes that the character has to choose from."""
    skeletons = find_skeletons(stage, below)
    if skeletons:
        return find_take_set(skeletons[0].GetPrim())
    # An animation layer alone has only overs.
    start = stage.GetPrimAtPath(below)
    prims = Usd.PrimRange(start, Usd.PrimAllPrimsPredicate) if start else ()
    return next((found for prim in prims if (found := find_take_set(prim))), None)


def _read_selected(stage: Any, path: Path, below: str) -> TakeStream:
    skeletons = find_skeletons(stage, below)
    if skeletons:
        skeleton = skeleton_rig(skeletons[0], path)
        animation = _bound_animation(skeletons[0])
        prim = skeletons[0].GetPrim()
    else:
        animation = _first_animation(stage, below)
        if animation is None:
            message = f"holds no Skeleton and no SkelAnimation below {below}"
            there = character_paths(stage)
            hint = f"characters: {listed(there, MOST_NAMED)}" if there else None
            raise FormatError(Fault("USD008", message, str(path), (), hint))
        skeleton = _rig_of_animation(animation, path, stage)
        prim = None
    if animation is None:
        stream = _resting(skeleton, stage, path)
    else:
        stream = _read(stage, path, skeleton, animation, prim)
    if prim is None:
        stream.notices += _lost_motion(animation, str(path))
    else:
        _join_stored(stream, skeletons[0], skeleton, path)
    stream.notices += others_notice(
        skeletons, str(path), "--prim-path names one (in bake, --source-prim)"
    )
    stream.notices += composition_notices(stage, str(path))
    return stream


def _join_stored(
    stream: TakeStream, skeleton: Any, found: SkeletonRig, path: Path
) -> None:
    """Give the take's rig what the Skeleton's customData says of it beyond USD."""
    data = skeleton.GetPrim().GetCustomDataByKey("animtool") or {}
    if not data.get("rig"):
        return
    from animtool.usd.stored_rig import joined_rig

    joined, notices = joined_rig(
        stream.rig,
        data,
        found.tokens,
        array_value(skeleton.GetRestTransformsAttr()),
        array_value(skeleton.GetBindTransformsAttr()),
        path,
    )
    names = [shape.name for shape in joined.shapes]
    places = np.array([names.index(s.name) for s in stream.rig.shapes], np.int64)
    stream.blocks = _among(stream.blocks, places, len(names))
    # Meshes and curves stay where they are, and with them cloth and strands.
    held = {AttachKind.CLOTH, AttachKind.STRANDS}
    attach = tuple(entry for entry in joined.attach if entry.kind not in held)
    stream.rig = replace(joined, meshes=(), attach=attach)
    stream.notices += notices


def _among(blocks: Iterator[Motion], places: IntArray, count: int) -> Iterator[Motion]:
    """Yield blocks whose weights stand at some places among others, which are 0."""
    for block in blocks:
        old = block.weights
        if old is None:
            yield block
            continue
        rest = np.zeros((count, 1))
        rest[places] = old.rest
        animated = places[old.animated]
        order = np.argsort(animated)
        weights = Channel(rest, animated[order], old.values[:, order])
        yield replace(block, weights=weights)


def _bound_animation(skeleton: Any) -> Any:
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return None
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    query = cache.GetSkelQuery(skeleton)
    source = query.GetAnimQuery() if query else None
    if source:
        return UsdSkel.Animation(source.GetPrim())
    # An animation that UsdSkel cannot use is bound all the same: reading says why.
    binding = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
    return UsdSkel.Animation(binding) if binding else None


def _first_animation(stage: Any, below: str) -> Any:
    start = stage.GetPrimAtPath(below)
    # An animation layer alone has only overs above its animation.
    everything = Usd.PrimAllPrimsPredicate
    prims = list(Usd.PrimRange(start, everything)) if start else []
    bound = [
        stage.GetPrimAtPath(target)
        for prim in prims
        if (binding := prim.GetRelationship("skel:animationSource"))
        for target in binding.GetTargets()
    ]
    for prim in (*bound, *prims):
        if prim and prim.IsA(UsdSkel.Animation):
            return UsdSkel.Animation(prim)
    return None


def _lost_motion(animation: Any, where: str) -> list[Fault]:
    """Say so where a layer alone moves a SkelRoot, whose rig is elsewhere."""
    parent = animation.GetPrim().GetParent()
    order = parent.GetAttribute("xformOpOrder")
    if not order or not order.HasAuthoredValue():
        return []
    message = f"{parent.GetPath()} carries the root's motion, which is left out"
    hint = "read a stage that holds the rig too"
    return [Fault("USD113", message, where, (), hint, Severity.WARNING)]


def _rig_of_animation(animation: Any, path: Path, stage: Any) -> SkeletonRig:
    tokens = [str(token) for token in array_value(animation.GetJointsAttr())]
    where = f"{path}<{animation.GetPath()}>"
    if not tokens:
        raise FormatError(Fault("USD002", "the SkelAnimation has no joints", where))
    matrices = np.tile(np.eye(4), (len(tokens), 1, 1))
    first = Usd.TimeCode.EarliestTime()
    positions = array_value(animation.GetTranslationsAttr(), first)
    if len(positions) == len(tokens):
        matrices[:, 3, :3] = np.array(positions)
    return rig_from_tokens(
        tokens,
        matrices,
        path.stem,
        where,
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        {},
    )


def _resting(skeleton: SkeletonRig, stage: Any, path: Path) -> TakeStream:
    """Return a rig without animation: one frame, at rest."""
    rig = skeleton.rig
    motion = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
        _scales(skeleton.rest_scales[None]),
    )
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    start = _fraction(stage.GetStartTimeCode())
    stream = TakeStream.of(Take(rig, Clock(fps, start, Fraction(1), 1), motion))
    stream.details = _details(stage, skeleton)
    stream.details["animation"] = None
    if not stage.HasAuthoredMetadata("startTimeCode"):
        stream.start = None
    message = "no animation is bound to the skeleton; it is read at rest"
    stream.notices.append(
        Fault("USD103", message, str(path), severity=Severity.WARNING)
    )
    return stream


@dataclass(frozen=True, slots=True)
class _Grid:
    """Evenly spaced time codes that hold every sample."""

    start: Fraction
    step: Fraction
    count: int
    even: bool


@dataclass(frozen=True, slots=True)
class _Span:
    """First frame, and the last where the take or its stage states one."""

    first: Fraction
    last: Fraction | None


def _span(stage: Any, animation: Any) -> _Span:
    own = take_range(animation)
    if own is not None:
        return _Span(*own)
    stated = stage.HasAuthoredTimeCodeRange()
    last = _fraction(stage.GetEndTimeCode()) if stated else None
    return _Span(_fraction(stage.GetStartTimeCode()), last)


def _grid(times: list[float], span: _Span, where: str) -> _Grid:
    if not times and span.last is not None:
        # Nothing moves, for as long as the take or its stage lasts.
        still = min(max(0, math.floor(span.last - span.first)), MOST_FRAMES) + 1
        return _Grid(span.first, Fraction(1), still, True)
    if len(times) < 2:
        start = _fraction(times[0]) if times else span.first
        return _Grid(start, Fraction(1), 1, True)
    exact = [_fraction(time) for time in times]
    gaps = {b - a for a, b in pairwise(exact)}
    step = _common_divisor(gaps)
    count = int((exact[-1] - exact[0]) / step) + 1
    if count > FINEST_GRID * len(times):
        first, last = math.floor(exact[0]), math.ceil(exact[-1])
        if last - first > MOST_FRAMES:
            message = f"{len(times)} samples spread over {last - first} time codes"
            raise FormatError(Fault("USD016", message, where, (), "a stray sample?"))
        return _Grid(Fraction(first), Fraction(1), last - first + 1, False)
    # Samples within a frame before the first serve its motion blur.
    start = span.first
    early = (start - exact[0]) / step
    if exact[0] < start < exact[0] + 1 and early.denominator == 1 and early < count:
        return _Grid(start, step, count - int(early), len(gaps) == 1)
    return _Grid(exact[0], step, count, len(gaps) == 1)


def _fraction(time: float) -> Fraction:
    return Fraction(time).limit_denominator(LARGEST_STEP_DENOMINATOR)


def _common_divisor(gaps: set[Fraction]) -> Fraction:
    """Return the largest step that every gap is a multiple of."""
    denominator = math.lcm(*(gap.denominator for gap in gaps))
    return Fraction(math.gcd(*(int(gap * denominator) for gap in gaps)), denominator)


def _read(
    stage: Any, path: Path, skeleton: SkeletonRig, animation: Any, prim: Any
) -> TakeStream:
    where = f"{path}<{animation.GetPath()}>"
    rig, notices = skeleton.rig, []
    tokens = [str(token) for token in array_value(animation.GetJointsAttr())]
    index = {token: i for i, token in enumerate(skeleton.tokens)}
    places = np.array([index.get(token, -1) for token in tokens], np.int64)
    unknown = [token for token, place in zip(tokens, places, strict=True) if place < 0]
    if unknown:
        message = f"joint {excerpt(unknown[0])} is not in the Skeleton"
        hint = f"{len(unknown)} such are left out"
        notices.append(Fault("USD104", message, where, (), hint, Severity.WARNING))
    attributes = {
        "translations": animation.GetTranslationsAttr(),
        "rotations": animation.GetRotationsAttr(),
        "scales": animation.GetScalesAttr(),
    }
    for name, attr in attributes.items():
        if not attr.HasAuthoredValue():
            message = f"{name} has no value"
            hint = "UsdSkel ignores an animation that lacks one of the three"
            raise FormatError(Fault("USD012", message, where, (), hint))
    movers = _movers(prim)
    weights = animation.GetBlendShapeWeightsAttr()
    shapes = _shapes(animation)
    sampled = [*attributes.values(), *([weights] if shapes else [])]
    times = {t for attr in sampled for t in attr.GetTimeSamples()}
    times |= {time for mover in movers for time in mover.GetTimeSamples()}
    grid = _grid(sorted(times), _span(stage, animation), where)
    if not grid.even:
        message = (
            f"samples are unevenly spaced; read every {float(grid.step):g} time codes"
        )
        notices.append(Fault("USD105", message, where, severity=Severity.NOTE))
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    clock = Clock(fps, grid.start, grid.step, grid.count)
    codes = clock.times.tolist()
    known = places >= 0

    def values(name: str, rest: FloatArray) -> FloatArray:
        attr, width = attributes[name], rest.shape[1]
        rows = _values(attr, codes, len(tokens), width, where)
        whole = np.repeat(rest[None], len(codes), axis=0)
        whole[:, places[known]] = rows[:, known]
        return whole

    meters = rig.meters_per_unit
    translations = values("translations", rig.rest_translations / meters) * meters
    rotations = values("rotations", rig.rest_rotations)
    rotations = so3.align_signs(so3.normalize(rotations))
    scales = values("scales", skeleton.rest_scales)
    if movers:
        matrices = _carriers(prim, codes)
        notices += _carry_roots(rig, matrices, translations, rotations, scales, where)
    motion = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(rotations),
        _scales(scales),
        _weights(weights, codes, len(shapes), where) if shapes else None,
    )
    rig = replace(rig, shapes=tuple(Shape(name) for name in shapes))
    stream = TakeStream.of(Take(rig, clock, motion))
    stream.notices.extend(notices)
    stream.details = _details(stage, skeleton)
    stream.details["animation"] = str(animation.GetPath())
    return stream


def _scales(dense: FloatArray) -> Channel | None:
    return None if (dense == 1.0).all() else Channel.from_dense(dense)


def _shapes(animation: Any) -> list[str]:
    """Return the shapes that an animation has weights of."""
    if not animation.GetBlendShapeWeightsAttr().HasAuthoredValue():
        return []
    return [str(token) for token in array_value(animation.GetBlendShapesAttr())]


def _weights(attr: Any, codes: list[float], shapes: int, where: str) -> Channel:
    rows = _values(attr, codes, shapes, 1, where, of="shape")
    return Channel.from_dense(np.repeat(rows, len(codes) // len(rows), axis=0))


def _values(
    attr: Any,
    codes: list[float],
    count: int,
    width: int,
    where: str,
    *,
    of: str = "joint",
) -> FloatArray:
    """Return samples ``(F, J, K)``; F is 1 where the attribute does not change."""
    changes = attr.GetNumTimeSamples() > 1
    when = (
        [Usd.TimeCode(c) for c in codes] if changes else [Usd.TimeCode.EarliestTime()]
    )
    rows = np.empty((len(when), count, width))
    for i, time in enumerate(when):
        value = array_value(attr, time)
        if len(value) != count:
            message = f"{attr.GetName()} has {len(value)} values for {count} {of}s"
            hint = f"time code {time.GetValue():g}; UsdSkel falls back to rest"
            raise FormatError(Fault("USD013", message, where, (), hint))
        rows[i] = np.array(value, np.float64).reshape(count, width)
    if not np.isfinite(rows).all():
        frame, joint, _ = np.argwhere(~np.isfinite(rows))[0]
        message = f"{attr.GetName()} is not finite"
        hint = f"time code {when[frame].GetValue():g}, {of} {joint}"
        raise FormatError(Fault("USD014", message, where, (), hint))
    return rows


def _movers(skeleton: Any) -> list[Any]:
    """Return the prims from the SkelRoot to the Skeleton, if one of them moves."""
    chain: list[Any] = []
    prim = skeleton
    while prim and prim.GetPath().pathElementCount:
        chain.append(UsdGeom.Xformable(prim))
        if prim.IsA(UsdSkel.Root):
            break
        prim = prim.GetParent()
    moves = any(mover and mover.TransformMightBeTimeVarying() for mover in chain)
    return [mover for mover in chain if mover] if moves else []


def _carriers(skeleton: Any, codes: list[float]) -> FloatArray:
    """Return the Skeleton's transforms above its SkelRoot's parent ``(F, 4, 4)``."""
    above = UsdSkel.Root.Find(skeleton).GetPrim().GetParent()
    matrices = []
    for code in codes:
        cache = UsdGeom.XformCache(Usd.TimeCode(code))
        world = cache.GetLocalToWorldTransform(skeleton)
        matrices.append(world * cache.GetLocalToWorldTransform(above).GetInverse())
    return np.array(matrices)


def _carry_roots(
    rig: Rig,
    matrices: FloatArray,
    translations: FloatArray,
    rotations: FloatArray,
    scales: FloatArray,
    where: str,
) -> list[Fault]:
    """Give the roots the motion of what carries them, in place."""
    if not np.isfinite(matrices).all():
        raise FormatError(
            Fault("USD014", "the SkelRoot's transform is not finite", where)
        )
    moves, turns, sizes = decompose(matrices)
    for root in rig.roots:
        sized = sizes * translations[:, root]
        translations[:, root] = so3.rotate(turns, sized) + moves * rig.meters_per_unit
        rotations[:, root] = so3.multiply(turns, rotations[:, root])
        scales[:, root] *= sizes
    rotations[:] = so3.align_signs(rotations)
    # Rounding of the matrices is no scale.
    near = np.abs(scales - 1.0) < UNIT_SCALE_TOLERANCE
    scales[near] = 1.0
    if np.ptp(sizes, axis=-1).max() <= UNIT_SCALE_TOLERANCE:
        return []
    message = "the SkelRoot is scaled by different factors along its axes"
    hint = "joints that turn under it are not read exactly"
    return [Fault("USD109", message, where, (), hint, Severity.WARNING)]


def _details(stage: Any, skeleton: SkeletonRig) -> dict[str, object]:
    return {
        "format": "USD",
        "layers": len(stage.GetUsedLayers()),
        "units": unit_name(skeleton.rig.meters_per_unit),
    }
