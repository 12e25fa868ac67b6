"""Checks on value clips: files, mappings, gaps and manifests."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import Sdf, Usd

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, excerpt, listed
from animtool.core.rules import finding
from animtool.usd.checks.checked_stage import CheckedStage


def check_value_clips(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check every clip set of every prim."""
    for prim in checked_stage.prims:
        if not prim.HasAuthoredMetadata("clips"):
            continue
        clips = Usd.ClipsAPI(prim)
        for name, clip_set in clips.GetClips().items():
            if isinstance(clip_set, dict):
                location = f"{prim.GetPath()}.clips:{name}"
                yield from _check_clip_set(prim, name, clip_set, location)


def _check_clip_set(
    prim: Any, name: str, clip_set: dict[str, Any], location: str
) -> Iterator[Fault]:
    is_template = "templateAssetPath" in clip_set and "assetPaths" not in clip_set
    if is_template:
        yield from _check_template(prim, name, clip_set, location)
    layers = []
    for asset in clip_set.get("assetPaths", ()):
        layer = _open_layer(prim, asset)
        if layer is None:
            message = f"clip {excerpt(asset.path, 80)} does not exist"
            yield finding("USD276", location, message)
        layers.append(layer)
    if not is_template:
        yield from _check_active(clip_set, len(layers), location)
    yield from _check_times(clip_set, location)
    target = str(clip_set.get("primPath", ""))
    readable_layers = [layer for layer in layers if layer is not None]
    if not (Sdf.Path.IsValidPathString(target) and Sdf.Path(target).IsAbsolutePath()):
        message = f"primPath is {excerpt(target)}, not the path of a prim"
        yield finding("USD277", location, message)
        return
    if readable_layers and not any(
        layer.GetPrimAtPath(target) for layer in readable_layers
    ):
        yield finding("USD277", location, f"no clip has primPath {target}")
        return
    yield from _check_manifest(prim, clip_set, target, readable_layers, location)
    yield from _check_spans(clip_set, target, layers, location)


def _open_layer(prim: Any, asset: Any) -> Any:
    """Open a layer by asset path, relative to the layer that authors the clips."""
    for spec in prim.GetPrimStack():
        if spec.HasInfo("clips"):
            path = asset.resolvedPath or Sdf.ComputeAssetPathRelativeToLayer(
                spec.layer, asset.path
            )
            layer = Sdf.Layer.FindOrOpen(path) if path else None
            if layer is not None:
                return layer
    return None


def _parse_time_pairs(clip_set: dict[str, Any], key: str) -> FloatArray:
    return np.array(clip_set.get(key) or (), np.float64).reshape(-1, 2)


def _check_active(
    clip_set: dict[str, Any], count: int, location: str
) -> Iterator[Fault]:
    active_pairs = _parse_time_pairs(clip_set, "active")
    if not len(active_pairs):
        yield finding("USD277", location, f"no active for {counted(count, 'clip')}")
        return
    unknown_clips = [
        n for n in active_pairs[:, 1] if not (0 <= n < count and n == math.floor(n))
    ]
    if unknown_clips:
        message = f"active refers to clip {unknown_clips[0]:g} of {count}"
        yield finding("USD277", location, message)
    if (np.diff(active_pairs[:, 0]) <= 0).any():
        yield finding("USD277", location, "the times of active do not ascend")
    idle_clips = sorted(
        set(range(count)) - {int(n) for n in active_pairs[:, 1] if math.isfinite(n)}
    )
    if idle_clips and not unknown_clips:
        message = f"clips that are never active: {listed(idle_clips)}"
        yield finding("USD278", location, message)


def _check_times(clip_set: dict[str, Any], location: str) -> Iterator[Fault]:
    times = _parse_time_pairs(clip_set, "times")
    if not np.isfinite(times).all() or (np.diff(times[:, 0]) < 0).any():
        yield finding("USD277", location, "the stage times of times do not ascend")


def _check_template(
    prim: Any, name: str, clip_set: dict[str, Any], location: str
) -> Iterator[Fault]:
    """Compare the clips of a template with the existing files."""
    start, end, stride = (
        float(clip_set.get(f"template{key}", math.nan))
        for key in ("StartTime", "EndTime", "Stride")
    )
    template = str(clip_set["templateAssetPath"])
    if not (math.isfinite(start + end + stride) and stride > 0):
        message = "templateStartTime, templateEndTime or templateStride is not a number"
        yield finding("USD277", location, message)
        return
    expected_count = math.floor((end - start) / stride + 1e-9) + 1
    count = len(Usd.ClipsAPI(prim).ComputeClipAssetPaths(name))
    if count == 0:
        message = (
            f"none of the {expected_count} clips of {excerpt(template, 80)} exists"
        )
        yield finding("USD276", location, message)
    elif count < expected_count:
        message = (
            f"{expected_count - count} of {expected_count} clips of "
            f"{excerpt(template, 80)} are "
        )
        yield finding("USD278", location, message + "not there")


def _sampled_properties(layer: Any, target: str) -> set[str]:
    """Return relative paths of the sampled properties of a prim and its descendants."""
    names = set()

    def visit(path: Any) -> None:
        if path.IsPropertyPath() and layer.GetNumTimeSamplesForPath(path):
            names.add(str(path)[len(target) :])

    layer.Traverse(Sdf.Path(target), visit)
    return names


def _check_manifest(
    prim: Any, clip_set: dict[str, Any], target: str, layers: list[Any], location: str
) -> Iterator[Fault]:
    asset = clip_set.get("manifestAssetPath")
    if asset is None or not asset.path:
        if layers:
            message = "there is no manifest, so every clip is opened to find attributes"
            yield finding("USD279", location, message)
        return
    manifest = _open_layer(prim, asset)
    if manifest is None:
        message = f"the manifest {excerpt(asset.path, 80)} does not exist"
        yield finding("USD276", location, message)
        return
    sampled_properties = set().union(
        *(_sampled_properties(layer, target) for layer in layers)
    )
    undeclared_names = sorted(
        p for p in sampled_properties if not manifest.GetPropertyAtPath(target + p)
    )
    if undeclared_names:
        message = (
            f"the manifest lacks {counted(len(undeclared_names), 'attribute')} of the "
            "clips: "
        )
        message += listed(undeclared_names)
        yield finding("USD279", location, message)


def _check_spans(
    clip_set: dict[str, Any], target: str, layers: list[Any], location: str
) -> Iterator[Fault]:
    """Check that all clips sample the same properties."""
    clip_properties = [
        None if layer is None else _sampled_properties(layer, target)
        for layer in layers
    ]
    all_properties = set().union(*(p for p in clip_properties if p is not None))
    if clip_set.get("interpolateMissingClipValues"):
        return
    for clip_index, names in enumerate(clip_properties):
        missing_names = sorted(all_properties - names) if names is not None else []
        if missing_names:
            message = f"clip {clip_index} has no samples of {listed(missing_names)}"
            yield finding("USD278", location, message)
            return
