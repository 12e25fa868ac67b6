"""Reads glTF animations, and interpolates their keys."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Severity, counted, excerpt
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import Node
from animtool.formats.gltf.accessors import FLOAT_COMPONENT, Accessors, check_finite
from animtool.formats.gltf.animation_targets import (
    ChannelTarget,
    TargetPath,
    read_channel_target,
)
from animtool.formats.gltf.json_items import JsonItem
from animtool.formats.gltf.meshes import I8, I16, U8, U16, GltfMesh, check_bounds
from animtool.formats.gltf.nodes import UNIT_TOLERANCE
from animtool.maths import so3

# Tolerance for the length of quantized quaternion keys, which are coarse [1].
UNIT_TOLERANCES = {I8: 2e-2, U8: 2e-2, I16: UNIT_TOLERANCE, U16: UNIT_TOLERANCE}
SMALL_INTEGERS = (I8, U8, I16, U16)


class SamplerInterpolation(StrEnum):
    """How a sampler interpolates between its keys."""

    LINEAR = "LINEAR"
    STEP = "STEP"
    CUBIC = "CUBICSPLINE"


@dataclass(frozen=True, slots=True, eq=False)
class GltfTrack:
    """Times, values and slopes of the keys of one animated property."""

    node: int  # the animated node; -1 if a mesh is animated
    # The mesh whose weights are animated, on all nodes; -1 if a node is animated.
    mesh: int
    path: TargetPath  # the animated property
    weight_index: int  # index of a single animated weight; -1 for all weights
    interpolation: SamplerInterpolation  # interpolation between keys
    times: FloatArray  # key times, ascending ``(K,)`` [s]
    values: FloatArray  # ``(K, W)``; in the stored type if floats
    # Slopes into each key of cubic splines ``(K, W)`` [1/s].
    in_slopes: FloatArray | None = None
    # Slopes out of each key of cubic splines ``(K, W)`` [1/s].
    out_slopes: FloatArray | None = None

    def sample(self, times: FloatArray) -> FloatArray:
        """Return values at times ``(F, W)``, constant outside the keys.

        Rotations are unit quaternions.
        """
        values = self.values
        if len(self.times) == 1:
            values = _normalize_rotations(values, self.path)
            return np.repeat(values, len(times), axis=0)
        segment = np.searchsorted(self.times, times, "right") - 1
        segment = np.clip(segment, 0, len(self.times) - 2)
        return interpolate_tracks([self], segment, times)[:, 0]


def interpolate_tracks(
    tracks: Sequence[GltfTrack], segments: IntArray, times: FloatArray
) -> FloatArray:
    """Return values ``(F, N, W)`` of N tracks within segments of their keys.

    ``tracks`` have the same path, key times and interpolation; ``segments`` is the key
    before each time.
    """
    first_track, path = tracks[0], tracks[0].path
    start_times, end_times = (
        first_track.times[segments],
        first_track.times[segments + 1],
    )
    duration = (end_times - start_times)[:, None, None]
    fraction = np.clip((times - start_times)[:, None, None] / duration, 0.0, 1.0)
    start_values = np.stack([track.values[segments] for track in tracks], axis=1)
    end_values = np.stack([track.values[segments + 1] for track in tracks], axis=1)
    if first_track.interpolation is SamplerInterpolation.STEP:
        values = np.where(fraction < 1.0, start_values, end_values)
        return _normalize_rotations(values, path)
    if first_track.interpolation is SamplerInterpolation.CUBIC:
        all_out_slopes = [t.out_slopes for t in tracks if t.out_slopes is not None]
        all_in_slopes = [t.in_slopes for t in tracks if t.in_slopes is not None]
        out_slopes = np.stack([slopes[segments] for slopes in all_out_slopes], axis=1)
        in_slopes = np.stack([slopes[segments + 1] for slopes in all_in_slopes], axis=1)
        values = _hermite(
            start_values, out_slopes, in_slopes, end_values, fraction, duration
        )
        return _normalize_rotations(values, path)
    if path is TargetPath.ROTATION:
        return so3.slerp(
            _normalize_rotations(start_values, path),
            _normalize_rotations(end_values, path),
            fraction[:, :, 0],
        )
    differences = end_values.astype(np.float64) - start_values
    return np.asarray(start_values + differences * fraction)


def _hermite(
    start_values: FloatArray,
    out_slope: FloatArray,
    in_slope: FloatArray,
    end_values: FloatArray,
    fraction: FloatArray,
    duration: FloatArray,
) -> FloatArray:
    """Return values of cubic Hermite segments, from slopes [1/s]."""
    t = fraction
    t_squared, t_cubed = t * t, t * t * t
    return np.asarray(
        (2 * t_cubed - 3 * t_squared + 1) * start_values
        + duration * (t_cubed - 2 * t_squared + t) * out_slope
        + (3 * t_squared - 2 * t_cubed) * end_values
        + duration * (t_cubed - t_squared) * in_slope
    )


def _normalize_rotations(values: FloatArray, path: TargetPath) -> FloatArray:
    """Return rotations as unit quaternions, and values of other paths unchanged."""
    rotations = np.asarray(values, np.float64)
    if path is not TargetPath.ROTATION:
        return rotations
    lengths = np.linalg.norm(rotations, axis=-1, keepdims=True)
    if not lengths.all():
        # Between opposite cubic keys the quaternion may be zero, and has no rotation.
        rotations = np.where(lengths == 0.0, so3.IDENTITY, rotations)
        lengths = np.where(lengths == 0.0, 1.0, lengths)
    return np.asarray(rotations / lengths)


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """Name, tracks and extras of an animation of the file."""

    name: str | None
    tracks: tuple[GltfTrack, ...]
    extras: dict[str, Any]
    pointer: str

    @property
    def span(self) -> tuple[float, float]:
        """Times of first and last key [s]; 0 if there are no keys."""
        if not self.tracks:
            return 0.0, 0.0
        first = min(float(track.times[0]) for track in self.tracks)
        return first, max(float(track.times[-1]) for track in self.tracks)


class _SamplerReader:
    """Reads the samplers of an animation; samplers with the same times share them."""

    def __init__(self, item: JsonItem, accessors: Accessors) -> None:
        self.items = item.children("samplers")
        self.accessors = accessors
        self.accessor_pairs = [self._read_accessor_pair(s) for s in self.items]
        self._key_times_by_accessor: dict[int, tuple[FloatArray, bool]] = {}

    def _read_accessor_pair(self, item: JsonItem) -> tuple[int, int]:
        indices = []
        for key in ("input", "output"):
            index = item.required_index(key, len(self.accessors.by_index), "accessor")
            self.accessors.warn_about_stride(index, item.pointer_to(key))
            indices.append(index)
        return indices[0], indices[1]

    def interpolation(self, index: int) -> SamplerInterpolation:
        """Return the interpolation of a sampler."""
        item = self.items[index]
        name = item.text("interpolation") or "LINEAR"
        try:
            return SamplerInterpolation(name)
        except ValueError:
            item.fail("interpolation", f"unknown interpolation {excerpt(name)}")

    def key_times(self, index: int) -> tuple[FloatArray, bool]:
        """Return the key times of a sampler, and whether they ascend.

        Warn about stated bounds that differ from the times.
        """
        item, accessor_index = self.items[index], self.accessor_pairs[index][0]
        if accessor_index not in self._key_times_by_accessor:
            accessor = self.accessors.by_index[accessor_index]
            if accessor is None or not accessor.has_type("SCALAR", FLOAT_COMPONENT):
                item.fail("input", "times must be float scalars", "GLT011")
            times = self.accessors.floats(accessor_index)[:, 0]
            has_bounds = not accessor.item.values.keys().isdisjoint({"min", "max"})
            if self.accessors.has_data(accessor_index) or not has_bounds:
                pointer = item.pointer_to("input")
                check_bounds(accessor.item, times[:, None], required_by=pointer)
            self._key_times_by_accessor[accessor_index] = (
                times,
                bool((np.diff(times) > 0).all()),
            )
        return self._key_times_by_accessor[accessor_index]


def read_animations(
    json_root: JsonItem,
    accessors: Accessors,
    nodes: Sequence[Node],
    meshes: Sequence[GltfMesh],
) -> tuple[Animation, ...]:
    """Return the animations of a file, with checked keys."""
    return tuple(
        _read_animation(item, accessors, nodes, meshes)
        for item in json_root.children("animations")
    )


def _read_animation(
    item: JsonItem,
    accessors: Accessors,
    nodes: Sequence[Node],
    meshes: Sequence[GltfMesh],
) -> Animation:
    for key in ("channels", "samplers"):
        if key not in item.values:
            item.fail_missing(key)
    samplers = _SamplerReader(item, accessors)
    tracks: list[GltfTrack] = []
    pointers_by_target: dict[tuple[int, int, str, int], str] = {}
    ignored_targets: dict[str, None] = {}
    for channel in item.children("channels"):
        target = read_channel_target(channel, nodes, meshes, ignored_targets)
        index = channel.required_index("sampler", len(samplers.items), "sampler")
        if target is None:
            continue
        target_key = (target.node, target.mesh, str(target.path), target.weight_index)
        if target_key in pointers_by_target:
            message = (
                f"two channels of the animation have the same target {target.path}"
            )
            pointer = f"{pointers_by_target[target_key]}/target"
            channel.diagnostics.fail(
                "GLT012", pointer, message, "remove one of the channels"
            )
        pointers_by_target[target_key] = channel.pointer
        tracks.append(_read_track(channel, target, samplers, index))
    if ignored_targets:
        names = ", ".join(ignored_targets)
        message = f"channels of unsupported targets are ignored: {names}"
        item.diagnostics.warn("GLT108", item.pointer, message, severity=Severity.NOTE)
    extras = item.values.get("extras")
    return Animation(
        item.text("name"),
        tuple(tracks),
        extras if isinstance(extras, dict) else {},
        item.pointer,
    )


def _read_track(
    channel: JsonItem, target: ChannelTarget, samplers: _SamplerReader, index: int
) -> GltfTrack:
    """Return the keys of a channel, checked and repaired."""
    item = samplers.items[index]
    diagnostics = item.diagnostics
    interpolation = samplers.interpolation(index)
    times, is_ascending = samplers.key_times(index)
    values = _read_values(channel, target, samplers, index)
    is_cubic = interpolation is SamplerInterpolation.CUBIC
    expected_count = len(times) * target.width * (3 if is_cubic else 1)
    if values.size != expected_count:
        message = (
            f"there are {values.size} numbers for {len(times)} keys of {target.width}"
        )
        if is_cubic:
            message += ", with a tangent before and after each"
        diagnostics.fail("GLT011", channel.pointer_to("sampler"), message)
    key_rows = values.reshape(len(times), -1, target.width)
    if target.path is TargetPath.ROTATION:
        _check_unit_length(key_rows[:, 1 if is_cubic else 0], channel, samplers, index)
    if not is_ascending:
        input_accessor = samplers.accessor_pairs[index][0]
        has_times = samplers.accessors.has_data(input_accessor)
        times, key_rows = _sort_keys(times, key_rows, item, has_times=has_times)
    if is_cubic and len(times) == 1:
        message = "a cubic spline needs at least two keys; its only key is held"
        diagnostics.warn("GLT107", item.pointer_to("interpolation"), message)
    if times[0] < 0:
        message = f"the first key is at {times[0]:.6g} s, before time 0; it is kept"
        diagnostics.warn("GLT107", item.pointer_to("input"), message)
    keys = key_rows[:, 1 if is_cubic else 0]
    return GltfTrack(
        target.node,
        target.mesh,
        target.path,
        target.weight_index,
        interpolation,
        times,
        keys,
        key_rows[:, 0].astype(np.float64) if is_cubic else None,
        key_rows[:, 2].astype(np.float64) if is_cubic else None,
    )


def _read_values(
    channel: JsonItem, target: ChannelTarget, samplers: _SamplerReader, index: int
) -> Any:
    item, accessor_index = samplers.items[index], samplers.accessor_pairs[index][1]
    accessors = samplers.accessors
    accessor = accessors.by_index[accessor_index]
    element_type = "VEC4" if target.path is TargetPath.ROTATION else "SCALAR"
    component_types: tuple[int, ...] = (FLOAT_COMPONENT, *SMALL_INTEGERS)
    if target.path in {TargetPath.TRANSLATION, TargetPath.SCALE}:
        element_type, component_types = "VEC3", (FLOAT_COMPONENT,)
    if accessor is None or not accessor.has_type(element_type, *component_types):
        type_text = "an unknown type" if accessor is None else accessor.element_type
        message = f"{target.path} cannot have values of {type_text} in these components"
        item.diagnostics.fail("GLT011", channel.pointer_to("sampler"), message)
    # Non-finite rotations are detected by their length; slopes have none.
    is_cubic = samplers.interpolation(index) is SamplerInterpolation.CUBIC
    must_be_finite = is_cubic or target.path is not TargetPath.ROTATION
    stored_values = accessors.numbers(accessor_index, must_be_finite=must_be_finite)
    if accessor.component_type == FLOAT_COMPONENT:
        return stored_values
    if target.path is TargetPath.VISIBLE:
        return (stored_values != 0).astype(np.float64)
    numbers = accessors.floats(accessor_index)
    if not accessor.is_normalized:
        # Integers of these paths are normalized even if the accessor does not state it.
        max_integer = np.iinfo(stored_values.dtype).max
        numbers = np.maximum(numbers / max_integer, -1.0)
    return numbers


def _sort_keys(
    times: FloatArray, key_rows: Any, item: JsonItem, *, has_times: bool
) -> tuple[FloatArray, Any]:
    """Return keys sorted by time; of keys at the same time, only the first is kept.

    ``has_times`` says whether the file has the times; otherwise they are all 0.
    """
    time_order = np.argsort(times, kind="stable")
    diagnostics, pointer = item.diagnostics, item.pointer_to("input")
    if (np.diff(times) < 0).any():
        message = "key times are out of order; the keys are sorted"
        hint = "export the file again if the motion looks wrong"
        diagnostics.warn("GLT107", pointer, message, hint)
    times, key_rows = times[time_order], key_rows[time_order]
    duplicate_indices = np.flatnonzero(np.diff(times) == 0)
    if len(duplicate_indices):
        if has_times:
            next_rows = key_rows[duplicate_indices + 1]
            if (key_rows[duplicate_indices] != next_rows).any():
                duplicate_time = float(times[duplicate_indices[0]])
                message = f"two keys at {duplicate_time:.6g} s have different values"
                hint = "remove one of them, or move it to another time"
                diagnostics.fail("GLT012", pointer, message, hint)
            count = len(duplicate_indices)
            message = f"{counted(count, 'duplicate key')} "
            message += f"{'is' if count == 1 else 'are'} removed"
            diagnostics.warn("GLT107", pointer, message)
        unique_indices = np.setdiff1d(np.arange(len(times)), duplicate_indices + 1)
        times, key_rows = times[unique_indices], key_rows[unique_indices]
    return times, key_rows


def _check_unit_length(
    keys: Any, channel: JsonItem, samplers: _SamplerReader, index: int
) -> None:
    """Warn about quaternions that are not unit length; raise for zero length."""
    accessor_index = samplers.accessor_pairs[index][1]
    accessor = samplers.accessors.get(accessor_index)
    tolerance = UNIT_TOLERANCES.get(accessor.component_type, UNIT_TOLERANCE)
    float32_keys = np.require(keys, np.float32, ["C", "A"])
    min_square, max_square = _kernels.squared_lengths(float32_keys)
    if math.isnan(max_square):
        check_finite(keys, accessor)
        # Their squares exceed the range of float32.
        squared_lengths = np.square(keys, dtype=np.float64).sum(axis=1)
        min_square, max_square = (
            float(squared_lengths.min()),
            float(squared_lengths.max()),
        )
    if min_square <= 0.0:
        message = "a rotation key is a quaternion of length 0"
        samplers.items[index].diagnostics.fail("GLT010", accessor.pointer, message)
    if max(1.0 - min_square, max_square - 1.0) > 2 * tolerance:
        message = "rotation keys are not unit quaternions (lengths "
        message += f"{min_square**0.5:.6g} to {max_square**0.5:.6g}); they are "
        message += "normalised"
        hint = "export the file again if the rotations look wrong"
        channel.diagnostics.warn("GLT103", channel.pointer_to("sampler"), message, hint)
