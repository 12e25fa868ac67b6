"""Checks on stage metadata, and on assets that its layers reference."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from pxr import Pcp, Sdf, UsdGeom

from animtool.core.clock import frame_label, span_label
from animtool.core.errors import Fault, excerpt
from animtool.core.rules import finding
from animtool.usd.checks.subject import StageSubject
from animtool.usd.layers.faults import units_and_axis
from animtool.usd.rigs.prims import stored_data


def check_composition(subject: StageSubject) -> Iterator[Fault]:
    """Check that all composition arcs resolve."""
    reported = set()
    for error in subject.stage.GetCompositionErrors():
        text = re.sub(r"@[^@]*/([^@/]+)@", r"@\1@", " ".join(str(error).split()))
        where = "/"
        if not isinstance(error, Pcp.ErrorInvalidSublayerPath):
            where = str(error.rootSite.path) or "/"
        if (where, text) not in reported:
            reported.add((where, text))
            yield finding("USD261", where, text[:300])


def check_assets(subject: StageSubject) -> Iterator[Fault]:
    """Check that asset paths are relative and resolve."""
    for layer in subject.stage.GetUsedLayers():
        wrong = [p for p in layer.GetCompositionAssetDependencies() if _absolute(p)]
        for path in wrong:
            owner = _owner(layer, path)
            message = f"{layer.GetDisplayName()} refers to {excerpt(path, 80)}"
            yield finding("USD262", owner, message)
    for attr in subject.attributes:
        kind = attr.GetTypeName()
        if kind in {Sdf.ValueTypeNames.Asset, Sdf.ValueTypeNames.AssetArray}:
            yield from _values(attr, attr.Get())


def _values(attr: Any, value: Any) -> Iterator[Fault]:
    for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
        if _absolute(asset.path):
            message = f"it refers to {excerpt(asset.path, 80)}"
            yield finding("USD262", attr.GetPath(), message)
        # Pattern paths such as texture.<UDIM>.png are resolved by their reader.
        elif asset.path and not asset.resolvedPath and "<" not in asset.path:
            message = f"{excerpt(asset.path, 80)} does not exist"
            yield finding("USD263", attr.GetPath(), message)


def _absolute(path: str) -> bool:
    bare = path.removeprefix("file://")
    return (
        bare != path
        or PurePosixPath(bare).is_absolute()
        or PureWindowsPath(bare).is_absolute()
    )


def _owner(layer: Any, asset: str) -> str:
    """Return the prim that references an asset; / for a sublayer."""
    paths = ["/"]

    def look(path: Any) -> None:
        spec = layer.GetPrimAtPath(path) if path.IsPrimPath() else None
        if spec is None:
            return
        for name in ("references", "payload"):
            arcs = spec.GetInfo(name)
            items = arcs.GetAddedOrExplicitItems() if arcs else ()
            if any(item.assetPath == asset for item in items):
                paths.append(str(path))

    if asset not in layer.subLayerPaths:
        layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return paths[-1]


ROOT = "/"
RATES = ("framesPerSecond", "timeCodesPerSecond")
# [m], of those that UsdGeom names.
COMMON_UNITS = tuple(
    getattr(UsdGeom.LinearUnits, name)
    for name in dir(UsdGeom.LinearUnits)
    if not name.startswith("_")
)
# Of a time code: less is rounding.
SAME_TIME = 1e-6


def check_rate_values(subject: StageSubject) -> Iterator[Fault]:
    """Check that frame rates of layers are positive.

    Where one is not, USD may never return from a question about samples.
    """
    for layer in _layers(subject):
        for name in RATES:
            if not layer.pseudoRoot.HasInfo(name):
                continue
            rate = layer.pseudoRoot.GetInfo(name)
            if not (rate > 0 and math.isfinite(rate)):
                message = f"{name} of {layer.GetDisplayName()} is {rate:g}"
                yield finding("USD253", ROOT, message)


def _layers(subject: StageSubject) -> Iterator[Any]:
    """Yield the composed layers, except value clips."""
    yield from subject.stage.GetUsedLayers(includeClipLayers=False)


def check_rates(subject: StageSubject) -> Iterator[Fault]:
    """Check that frame rates are authored and equal in all layers."""
    root = subject.stage.GetRootLayer().pseudoRoot
    missing = [name for name in RATES if not root.HasInfo(name)]
    if missing and any(
        subject.times(attr) or attr.ValueMightBeTimeVarying()
        for attr in subject.attributes
    ):
        message = f"no {' and no '.join(missing)}, but there is motion"
        yield finding("USD252", ROOT, message)
    yield from _retimed(subject)


def _retimed(subject: StageSubject) -> Iterator[Fault]:
    root = subject.stage.GetRootLayer()
    rate = root.timeCodesPerSecond
    for layer in _layers(subject):
        layer_rate = layer.timeCodesPerSecond
        if layer.anonymous or layer_rate == rate:
            continue
        times = layer.ListAllTimeSamples()
        if times:
            stated = layer.HasTimeCodesPerSecond() or layer.HasFramesPerSecond()
            says = (
                f"has {layer_rate:g}"
                if stated
                else f"states none, so {layer_rate:g} is assumed"
            )
            message = (
                f"the stage has {rate:g} time codes per second, "
                f"{layer.GetDisplayName()} {says}: its {len(times)} sample times are "
                f"scaled by {rate / layer_rate:.6g}"
            )
            yield finding("USD257", ROOT, message)


def check_range(subject: StageSubject) -> Iterator[Fault]:
    """Check that the stage's range is valid and contains the samples."""
    stage = subject.stage
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not (math.isfinite(start) and math.isfinite(end)):
        yield finding("USD254", ROOT, f"the range is {span_label(start, end)}")
        return
    names = ("startTimeCode", "endTimeCode")
    missing = [name for name in names if not stage.HasAuthoredMetadata(name)]
    if start > end and not missing:
        yield finding(
            "USD254", ROOT, f"start {frame_label(start)}, end {frame_label(end)}"
        )
        return
    spans = {
        str(attr.GetPath()): (times[0], times[-1])
        for attr in subject.attributes
        if (times := subject.times(attr)) and not _is_shared(attr.GetPrim())
    }
    if not spans:
        return
    first = min(span[0] for span in spans.values())
    last = max(span[1] for span in spans.values())
    if missing:
        message = (
            f"no {' and no '.join(missing)}; samples are at {span_label(first, last)}"
        )
        yield finding("USD255", ROOT, message)
        return
    # Samples of motion blur lie within a frame of either end.
    out = [
        path
        for path, span in spans.items()
        if span[0] <= start - 1 + SAME_TIME or span[1] >= end + 1 - SAME_TIME
    ]
    if not out:
        yield from _between_frames(subject, start, end, (first, last))
    else:
        begin, finish = spans[out[0]]
        more = "" if len(out) == 1 else f", as are those of {len(out) - 1} more"
        message = (
            f"samples are at {span_label(begin, finish)}, but the stage's range is "
        )
        message += f"{span_label(start, end)}{more}"
        yield finding("USD256", out[0], message)


def _between_frames(
    subject: StageSubject, start: float, end: float, samples: tuple[float, float]
) -> Iterator[Fault]:
    """Yield a fault if the range starts or ends where no sample is."""
    ends = {"starts": start, "ends": end}
    off = {
        verb: code for verb, code in ends.items() if abs(code - round(code)) > SAME_TIME
    }
    if not off:
        return
    sampled = {round(t, 6) for attr in subject.attributes for t in subject.times(attr)}
    unsampled = [
        f"{verb} at {frame_label(code)}"
        for verb, code in off.items()
        if round(code, 6) not in sampled
    ]
    if unsampled:
        message = f"the range {' and '.join(unsampled)}, but samples are at "
        yield finding("USD289", ROOT, message + span_label(*samples))


def _is_shared(prim: Any) -> bool:
    """Return whether sharers of an animation start at different offsets."""
    return bool(stored_data(prim).get("shared"))


def check_units(subject: StageSubject) -> Iterator[Fault]:
    """Check that unit and up axis are valid and equal in all sublayers.

    That they are stated, USD checks.
    """
    stage: Any = subject.stage
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    faults = list(units_and_axis(stage))
    yield from faults
    common = any(UsdGeom.LinearUnitsAre(unit, one) for one in COMMON_UNITS)
    if not (common or any("metersPerUnit" in fault.message for fault in faults)):
        yield finding("USD267", ROOT, f"metersPerUnit is {unit:g}")
    yield from _other_units(stage)


def _other_units(stage: Any) -> Iterator[Fault]:
    root = stage.GetRootLayer()
    for layer in stage.GetLayerStack(includeSessionLayers=False):
        for name in ("metersPerUnit", "upAxis"):
            if not (layer.pseudoRoot.HasInfo(name) and root.pseudoRoot.HasInfo(name)):
                continue
            mine, theirs = (x.pseudoRoot.GetInfo(name) for x in (root, layer))
            if mine != theirs:
                message = (
                    f"{name} of the stage is {mine}, but that of the sublayer "
                    f"{layer.GetDisplayName()} is {theirs}"
                )
                yield finding("USD268", ROOT, message)
