"""glTF animations: samplers, targets, and interpolation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Severity, excerpt
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import Node
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.accessors import FLOAT, Accessors, check_finite
from animtool.formats.gltf.animation_targets import (
    ChannelTarget,
    TargetPath,
    channel_target,
)
from animtool.formats.gltf.json_items import JsonItem
from animtool.formats.gltf.meshes import (
    I8,
    I16,
    U8,
    U16,
    MeshEntry,
    check_bounds,
)
from animtool.formats.gltf.nodes import UNIT_TOLERANCE
from animtool.maths import so3

# Tolerance for the length of quantized quaternion keys, which are coarse [1].
UNIT_TOLERANCES = {I8: 2e-2, U8: 2e-2, I16: UNIT_TOLERANCE, U16: UNIT_TOLERANCE}
SMALL_INTEGERS = (I8, U8, I16, U16)


class SamplerInterpolation(StrEnum):
    """Interpolation between keys."""

    LINEAR = "LINEAR"
    STEP = "STEP"
    CUBIC = "CUBICSPLINE"


@dataclass(frozen=True, slots=True, eq=False)
class GltfTrack:
    """Keys of one property.

    Attributes:
        node: The animated node; -1 if a mesh is animated.
        mesh: The mesh whose weights are animated, on all nodes; -1 if a node is
            animated.
        path: The animated property.
        weight_index: Index of a single animated weight; -1 for all weights.
        interpolation: Interpolation between keys.
        times: Key times, ascending ``(K,)`` [s].
        values: ``(K, W)``; in the stored type if floats.
        ins: Slopes into each key of cubic splines ``(K, W)`` [1/s].
        outs: Slopes out of each key of cubic splines ``(K, W)`` [1/s].
    """

    node: int
    mesh: int
    path: TargetPath
    weight_index: int
    interpolation: SamplerInterpolation
    times: FloatArray
    values: FloatArray
    ins: FloatArray | None = None
    outs: FloatArray | None = None

    def at(self, times: FloatArray) -> FloatArray:
        """Return values at times ``(F, W)``, constant outside the keys.

        Rotations are unit quaternions.
        """
        values = self.values
        if len(self.times) == 1:
            return np.repeat(
                _normalize_rotations(values, self.path), len(times), axis=0
            )
        segment = np.clip(
            np.searchsorted(self.times, times, "right") - 1, 0, len(self.times) - 2
        )
        return self.interpolate(segment, times)

    def interpolate(self, segment: IntArray, times: FloatArray) -> FloatArray:
        """Return values at times, each in the segment after a given key."""
        return interpolate([self], segment, times)[:, 0]


def interpolate(
    tracks: Sequence[GltfTrack], segment: IntArray, times: FloatArray
) -> FloatArray:
    """Return values ``(F, N, W)`` of N tracks within segments of their keys.

    ``tracks`` have the same path, key times and interpolation; ``segment`` is the key
    before each time.
    """
    first, path = tracks[0], tracks[0].path
    t0, t1 = first.times[segment], first.times[segment + 1]
    length = (t1 - t0)[:, None, None]
    fraction = np.clip((times - t0)[:, None, None] / length, 0.0, 1.0)
    a = np.stack([track.values[segment] for track in tracks], axis=1)
    b = np.stack([track.values[segment + 1] for track in tracks], axis=1)
    if first.interpolation is SamplerInterpolation.STEP:
        return _normalize_rotations(np.where(fraction < 1.0, a, b), path)
    if first.interpolation is SamplerInterpolation.CUBIC:
        outs = [track.outs[segment] for track in tracks if track.outs is not None]
        ins = [track.ins[segment + 1] for track in tracks if track.ins is not None]
        out, into = np.stack(outs, axis=1), np.stack(ins, axis=1)
        return _normalize_rotations(_hermite(a, out, into, b, fraction, length), path)
    if path is TargetPath.ROTATION:
        return so3.slerp(
            _normalize_rotations(a, path),
            _normalize_rotations(b, path),
            fraction[:, :, 0],
        )
    return np.asarray(a + (b.astype(np.float64) - a) * fraction)


def _hermite(
    a: FloatArray,
    out_slope: FloatArray,
    in_slope: FloatArray,
    b: FloatArray,
    fraction: FloatArray,
    length: FloatArray,
) -> FloatArray:
    """Return values of cubic segments with slopes per second."""
    t = fraction
    t2, t3 = t * t, t * t * t
    return np.asarray(
        (2 * t3 - 3 * t2 + 1) * a
        + length * (t3 - 2 * t2 + t) * out_slope
        + (3 * t2 - 2 * t3) * b
        + length * (t3 - t2) * in_slope
    )


def _normalize_rotations(values: FloatArray, path: TargetPath) -> FloatArray:
    """Return rotations normalised; other values unchanged."""
    rows = np.asarray(values, np.float64)
    if path is not TargetPath.ROTATION:
        return rows
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    if not length.all():
        # Between opposite cubic keys the quaternion may be zero: any rotation is
        # correct.
        rows = np.where(length == 0.0, so3.IDENTITY, rows)
        length = np.where(length == 0.0, 1.0, length)
    return np.asarray(rows / length)


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """An animation: the tracks of a clip."""

    name: str | None
    tracks: tuple[GltfTrack, ...]
    extras: dict[str, Any]
    where: str

    @property
    def span(self) -> tuple[float, float]:
        """Times of first and last key [s]; 0 without keys."""
        if not self.tracks:
            return 0.0, 0.0
        first = min(float(track.times[0]) for track in self.tracks)
        return first, max(float(track.times[-1]) for track in self.tracks)


class _SamplerReader:
    """Samplers of an animation; each input is read once."""

    def __init__(self, item: JsonItem, accessors: Accessors) -> None:
        self.items = item.children("samplers")
        self.accessors = accessors
        self.ends = [self._sampler_ends(sampler) for sampler in self.items]
        self.checked: set[int] = set()

    def _sampler_ends(self, item: JsonItem) -> tuple[int, int]:
        count = len(self.accessors.entries)
        ends = []
        for key in ("input", "output"):
            index = item.index(key, count, "accessor")
            if index < 0:
                item.missing(key)
            self.accessors.check_packed(index, item.at(key))
            ends.append(index)
        return ends[0], ends[1]

    def interpolation(self, index: int) -> SamplerInterpolation:
        """Return the interpolation of a sampler."""
        item = self.items[index]
        name = item.text("interpolation") or "LINEAR"
        try:
            return SamplerInterpolation(name)
        except ValueError:
            item.fail("interpolation", f"unknown interpolation {excerpt(name)}")

    def times(self, index: int) -> FloatArray:
        """Return the key times of a sampler, checked to be finite."""
        item, accessor = self.items[index], self.ends[index][0]
        entry = self.accessors.entries[accessor]
        if entry is None or not entry.is_of("SCALAR", FLOAT):
            item.fail("input", "times must be float scalars", "GLT011")
        times = self.accessors.floats(accessor)[:, 0]
        if accessor not in self.checked:
            self.checked.add(accessor)
            stated_bounds = {"min", "max"} & entry.item.values.keys()
            if self.accessors.has_data(accessor) or not stated_bounds:
                check_bounds(entry.item, times[:, None], missing=item.at("input"))
        return times


def read_animations(
    root: JsonItem,
    accessors: Accessors,
    nodes: Sequence[Node],
    meshes: Sequence[MeshEntry],
) -> tuple[Animation, ...]:
    """Return the animations of a file, with checked keys."""
    return tuple(
        _read_animation(item, accessors, nodes, meshes)
        for item in root.children("animations")
    )


def _read_animation(
    item: JsonItem,
    accessors: Accessors,
    nodes: Sequence[Node],
    meshes: Sequence[MeshEntry],
) -> Animation:
    for key in ("channels", "samplers"):
        if key not in item.values:
            item.missing(key)
    samplers = _SamplerReader(item, accessors)
    tracks: list[GltfTrack] = []
    targets: dict[tuple[int, int, str, int], str] = {}
    times: dict[int, tuple[FloatArray, bool]] = {}
    left_out: dict[str, None] = {}
    for channel in item.children("channels"):
        candidate = channel_target(channel, nodes, meshes, left_out)
        index = channel.index("sampler", len(samplers.items), "sampler")
        if index < 0:
            channel.missing("sampler")
        if candidate is None:
            continue
        target = candidate
        target_key = (target.node, target.mesh, str(target.path), target.weight_index)
        if target_key in targets:
            message = f"two channels of the animation move {target.path}"
            channel.notes.fail("GLT012", f"{targets[target_key]}/target", message)
        targets[target_key] = channel.pointer
        tracks.append(_read_track(channel, target, samplers, index, times))
    if left_out:
        names = ", ".join(left_out)
        message = f"channels of unsupported targets are ignored: {names}"
        item.notes.warn("GLT108", item.pointer, message, severity=Severity.NOTE)
    extras = item.values.get("extras")
    return Animation(
        item.text("name"),
        tuple(tracks),
        extras if isinstance(extras, dict) else {},
        item.pointer,
    )


def _read_track(
    channel: JsonItem,
    target: ChannelTarget,
    samplers: _SamplerReader,
    index: int,
    cache: dict[int, tuple[FloatArray, bool]],
) -> GltfTrack:
    """Return the keys of a channel, checked and repaired.

    ``cache`` has times by accessor, and whether they ascend.
    """
    item = samplers.items[index]
    notes = item.notes
    interpolation = samplers.interpolation(index)
    source = samplers.ends[index][0]
    if source not in cache:
        key_times = samplers.times(index)
        cache[source] = key_times, bool((np.diff(key_times) > 0).all())
    times, ascending = cache[source]
    values = _read_values(channel, target, samplers, index)
    cubic = interpolation is SamplerInterpolation.CUBIC
    rows = values.size
    row_count = len(times) * target.width * (3 if cubic else 1)
    if rows != row_count:
        message = f"{rows} numbers for {len(times)} keys of {target.width}"
        if cubic:
            message += ", with a tangent before and after each"
        notes.fail("GLT011", channel.at("sampler"), message)
    table = values.reshape(len(times), -1, target.width)
    if target.path is TargetPath.ROTATION:
        _check_unit(table[:, 1 if cubic else 0], channel, samplers, index)
    if not ascending:
        has_times = samplers.accessors.has_data(source)
        times, table = _sorted_keys(times, table, item, has_times=has_times)
    if cubic and len(times) == 1:
        message = "a cubic spline has two keys at least: its one key is held"
        notes.warn("GLT107", item.at("interpolation"), message)
    if times[0] < 0:
        message = f"the first key is at {times[0]:.6g} s, before time 0: it is kept"
        notes.warn("GLT107", item.at("input"), message)
    keys = table[:, 1 if cubic else 0]
    return GltfTrack(
        target.node,
        target.mesh,
        target.path,
        target.weight_index,
        interpolation,
        times,
        keys,
        table[:, 0].astype(np.float64) if cubic else None,
        table[:, 2].astype(np.float64) if cubic else None,
    )


def _read_values(
    channel: JsonItem, target: ChannelTarget, samplers: _SamplerReader, index: int
) -> Any:
    item, accessor = samplers.items[index], samplers.ends[index][1]
    accessors = samplers.accessors
    entry = accessors.entries[accessor]
    kinds, components = {"SCALAR"}, {FLOAT}
    if target.path in {TargetPath.TRANSLATION, TargetPath.SCALE}:
        kinds = {"VEC3"}
    elif target.path is TargetPath.ROTATION:
        kinds, components = {"VEC4"}, {FLOAT, *SMALL_INTEGERS}
    elif target.path is TargetPath.WEIGHTS:
        components = {FLOAT, *SMALL_INTEGERS}
    else:
        components = {FLOAT, *SMALL_INTEGERS}
    if entry is None or entry.kind not in kinds or entry.component not in components:
        kind = "an unknown type" if entry is None else entry.kind
        message = f"{target.path} cannot have values of {kind} in these components"
        item.notes.fail("GLT011", channel.at("sampler"), message)
    # Non-finite rotations are detected by their length; slopes have none.
    cubic = samplers.interpolation(index) is SamplerInterpolation.CUBIC
    finite = cubic or target.path is not TargetPath.ROTATION
    raw = accessors.numbers(accessor, finite=finite)
    if entry.component == FLOAT:
        return raw
    if target.path is TargetPath.VISIBLE:
        return (raw != 0).astype(np.float64)
    numbers = accessors.floats(accessor)
    if not entry.normalized:
        # Integers of these paths are normalized, even if the accessor does not say so.
        limit = np.iinfo(raw.dtype).max
        numbers = np.maximum(numbers / limit, -1.0)
    return numbers


def _sorted_keys(
    times: FloatArray, table: Any, item: JsonItem, *, has_times: bool
) -> tuple[FloatArray, Any]:
    """Return keys sorted by time; only the first of several at one time.

    ``has_times`` says whether the file has the times; otherwise they are all 0.
    """
    order = np.argsort(times, kind="stable")
    notes, where = item.notes, item.at("input")
    if (np.diff(times) < 0).any():
        notes.warn("GLT107", where, "times are out of order: the keys are sorted")
    times, table = times[order], table[order]
    duplicates = np.flatnonzero(np.diff(times) == 0)
    if len(duplicates):
        if has_times and (table[duplicates] != table[duplicates + 1]).any():
            at = float(times[duplicates[0]])
            message = f"two keys at {at:.6g} s have different values"
            notes.fail("GLT012", where, message)
        message = f"{len(duplicates)} equal keys with the time of another are removed"
        if has_times:
            notes.warn("GLT107", where, message)
        unique = np.setdiff1d(np.arange(len(times)), duplicates + 1)
        times, table = times[unique], table[unique]
    return times, table


def _check_unit(
    keys: Any, channel: JsonItem, samplers: _SamplerReader, index: int
) -> None:
    """Warn about quaternions off unit length; raise for zero length."""
    accessor = samplers.ends[index][1]
    entry = samplers.accessors.get(accessor)
    tolerance = UNIT_TOLERANCES.get(entry.component, UNIT_TOLERANCE)
    shortest, longest = _kernels.squared_lengths(
        np.require(keys, np.float32, ["C", "A"])
    )
    if math.isnan(longest):
        check_finite(keys, entry)
        # Squares out of the range of float32.
        squares = np.square(keys, dtype=np.float64).sum(axis=1)
        shortest, longest = float(squares.min()), float(squares.max())
    if shortest <= 0.0:
        message = "a rotation key has length 0"
        samplers.items[index].notes.fail("GLT010", entry.where, message)
    if max(1.0 - shortest, longest - 1.0) > 2 * tolerance:
        message = (
            f"rotation keys have lengths from {shortest**0.5:.6g} to {longest**0.5:.6g}"
        )
        notes: FileNotices = samplers.items[index].notes
        notes.warn("GLT103", channel.at("sampler"), f"{message}: they are normalised")
