"""Checks on stage metadata, and on assets that its layers reference."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from pxr import Sdf, UsdGeom

from animtool.core.clock import frame_label, span_label
from animtool.core.errors import Fault, counted, excerpt
from animtool.core.rules import finding
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.layers.dependencies import unresolved_arcs
from animtool.usd.layers.faults import unit_and_axis_faults
from animtool.usd.rigs.prims import stored_data


def check_composition(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that all composition arcs resolve."""
    for location, text in unresolved_arcs(checked_stage.stage):
        yield finding("USD261", location, text[:300])


def check_assets(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that asset paths are relative and resolve."""
    for layer in checked_stage.stage.GetUsedLayers():
        absolute_paths = [
            asset
            for asset in layer.GetCompositionAssetDependencies()
            if _is_absolute(asset)
        ]
        for path in absolute_paths:
            prim_path = _referencing_prim(layer, path)
            message = f"{layer.GetDisplayName()} refers to {excerpt(path, 80)}"
            yield finding("USD262", prim_path, message)
    for attr in checked_stage.attributes:
        value_type = attr.GetTypeName()
        if value_type in {Sdf.ValueTypeNames.Asset, Sdf.ValueTypeNames.AssetArray}:
            yield from _check_asset_values(attr, attr.Get())


def _check_asset_values(attr: Any, value: Any) -> Iterator[Fault]:
    for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
        if _is_absolute(asset.path):
            message = f"it refers to {excerpt(asset.path, 80)}"
            yield finding("USD262", attr.GetPath(), message)
        # Pattern paths such as texture.<UDIM>.png are resolved by their readers.
        elif asset.path and not asset.resolvedPath and "<" not in asset.path:
            message = f"{excerpt(asset.path, 80)} does not exist"
            yield finding("USD263", attr.GetPath(), message)


def _is_absolute(path: str) -> bool:
    plain_path = path.removeprefix("file://")
    return (
        plain_path != path
        or PurePosixPath(plain_path).is_absolute()
        or PureWindowsPath(plain_path).is_absolute()
    )


def _referencing_prim(layer: Any, asset: str) -> str:
    """Return the prim that references an asset; / for a sublayer."""
    paths = ["/"]

    def visit(path: Any) -> None:
        spec = layer.GetPrimAtPath(path) if path.IsPrimPath() else None
        if spec is None:
            return
        for name in ("references", "payload"):
            arcs = spec.GetInfo(name)
            items = arcs.GetAddedOrExplicitItems() if arcs else ()
            if any(item.assetPath == asset for item in items):
                paths.append(str(path))

    if asset not in layer.subLayerPaths:
        layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return paths[-1]


ROOT_PATH = "/"
RATE_FIELDS = ("framesPerSecond", "timeCodesPerSecond")
# Length units with a name in UsdGeom [m].
COMMON_UNITS = tuple(
    getattr(UsdGeom.LinearUnits, name)
    for name in dir(UsdGeom.LinearUnits)
    if not name.startswith("_")
)
# Tolerance of time codes: smaller differences are rounding.
TIME_TOLERANCE = 1e-6


def check_rate_values(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that frame rates of layers are positive.

    Otherwise USD may hang when it looks up samples.
    """
    for layer in _composed_layers(checked_stage):
        for name in RATE_FIELDS:
            if not layer.pseudoRoot.HasInfo(name):
                continue
            rate = layer.pseudoRoot.GetInfo(name)
            if not (rate > 0 and math.isfinite(rate)):
                message = f"{name} of {layer.GetDisplayName()} is {rate:g}"
                yield finding("USD253", ROOT_PATH, message)


def _composed_layers(checked_stage: CheckedStage) -> Iterator[Any]:
    """Yield the composed layers, except value clips."""
    yield from checked_stage.stage.GetUsedLayers(includeClipLayers=False)


def check_rates(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that frame rates are authored and equal in all layers."""
    root = checked_stage.stage.GetRootLayer().pseudoRoot
    unauthored_rates = [name for name in RATE_FIELDS if not root.HasInfo(name)]
    if unauthored_rates and any(
        checked_stage.times(attr) or attr.ValueMightBeTimeVarying()
        for attr in checked_stage.attributes
    ):
        message = "the stage has motion, but its root layer has no "
        message += " and no ".join(unauthored_rates)
        yield finding("USD252", ROOT_PATH, message)
    yield from _check_layer_rates(checked_stage)


def _check_layer_rates(checked_stage: CheckedStage) -> Iterator[Fault]:
    root = checked_stage.stage.GetRootLayer()
    rate = root.timeCodesPerSecond
    for layer in _composed_layers(checked_stage):
        layer_rate = layer.timeCodesPerSecond
        if layer.anonymous or layer_rate == rate:
            continue
        times = layer.ListAllTimeSamples()
        if times:
            has_rate = layer.HasTimeCodesPerSecond() or layer.HasFramesPerSecond()
            rate_text = (
                f"has {layer_rate:g}"
                if has_rate
                else f"states none ({layer_rate:g} is assumed)"
            )
            message = (
                f"the stage has {rate:g} time codes per second, but "
                f"{layer.GetDisplayName()} {rate_text}, so its "
                f"{counted(len(times), 'sample time')} "
                f"{'is' if len(times) == 1 else 'are'} scaled by "
                f"{rate / layer_rate:.6g}"
            )
            yield finding("USD257", ROOT_PATH, message)


def check_range(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that the stage's range is valid and contains the samples."""
    stage = checked_stage.stage
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not (math.isfinite(start) and math.isfinite(end)):
        yield finding("USD254", ROOT_PATH, f"the range is {span_label(start, end)}")
        return
    names = ("startTimeCode", "endTimeCode")
    unauthored_names = [name for name in names if not stage.HasAuthoredMetadata(name)]
    if start > end and not unauthored_names:
        yield finding(
            "USD254",
            ROOT_PATH,
            f"startTimeCode ({frame_label(start)}) is after endTimeCode "
            f"({frame_label(end)})",
        )
        return
    spans = {
        str(attr.GetPath()): (times[0], times[-1])
        for attr in checked_stage.attributes
        if (times := checked_stage.times(attr))
        # Characters share such an animation with different time offsets.
        and not stored_data(attr.GetPrim()).get("shared")
    }
    if not spans:
        return
    first_sample = min(span[0] for span in spans.values())
    last_sample = max(span[1] for span in spans.values())
    if unauthored_names:
        message = (
            f"the stage has no {' and no '.join(unauthored_names)}, but samples from "
        )
        message += span_label(first_sample, last_sample)
        yield finding("USD255", ROOT_PATH, message)
        return
    # Motion blur samples lie within a frame of either end.
    paths_outside = [
        path
        for path, span in spans.items()
        if span[0] <= start - 1 + TIME_TOLERANCE or span[1] >= end + 1 - TIME_TOLERANCE
    ]
    if not paths_outside:
        yield from _check_off_frame_ends(
            checked_stage, start, end, (first_sample, last_sample)
        )
    else:
        first_code, last_code = spans[paths_outside[0]]
        suffix = ""
        if len(paths_outside) != 1:
            others = counted(len(paths_outside) - 1, "other attribute")
            suffix = f"; so do the samples of {others}"
        message = (
            f"samples run from {span_label(first_code, last_code)}, but the stage's "
            "range is "
        )
        message += f"{span_label(start, end)}{suffix}"
        yield finding("USD256", paths_outside[0], message)


def _check_off_frame_ends(
    checked_stage: CheckedStage,
    start: float,
    end: float,
    sample_span: tuple[float, float],
) -> Iterator[Fault]:
    """Yield a fault if the range starts or ends between frames without a sample."""
    codes_by_verb = {"starts": start, "ends": end}
    off_frame_codes = {
        verb: code
        for verb, code in codes_by_verb.items()
        if abs(code - round(code)) > TIME_TOLERANCE
    }
    if not off_frame_codes:
        return
    sample_times = {
        round(t, 6)
        for attr in checked_stage.attributes
        for t in checked_stage.times(attr)
    }
    unsampled_ends = [
        f"{verb} at {frame_label(code)}"
        for verb, code in off_frame_codes.items()
        if round(code, 6) not in sample_times
    ]
    if unsampled_ends:
        message = f"the range {' and '.join(unsampled_ends)}, but samples run from "
        yield finding("USD289", ROOT_PATH, message + span_label(*sample_span))


def check_units(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that unit and up axis are valid and equal in all sublayers.

    USD itself checks that they are authored.
    """
    stage: Any = checked_stage.stage
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    faults = list(unit_and_axis_faults(stage))
    yield from faults
    is_common = any(
        UsdGeom.LinearUnitsAre(unit, common_unit) for common_unit in COMMON_UNITS
    )
    if not (is_common or any("metersPerUnit" in fault.message for fault in faults)):
        yield finding("USD267", ROOT_PATH, f"metersPerUnit is {unit:g}")
    yield from _check_sublayer_units(stage)


def _check_sublayer_units(stage: Any) -> Iterator[Fault]:
    root = stage.GetRootLayer()
    for layer in stage.GetLayerStack(includeSessionLayers=False):
        for name in ("metersPerUnit", "upAxis"):
            if not (layer.pseudoRoot.HasInfo(name) and root.pseudoRoot.HasInfo(name)):
                continue
            root_value, layer_value = (
                x.pseudoRoot.GetInfo(name) for x in (root, layer)
            )
            if root_value != layer_value:
                message = (
                    f"{name} of the stage is {root_value}, but that of the sublayer "
                    f"{layer.GetDisplayName()} is {layer_value}"
                )
                yield finding("USD268", ROOT_PATH, message)
