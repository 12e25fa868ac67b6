"""Writes a take as a glTF animation: sampled, reduced, or with its clip's keys."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np

from animtool.clip.keyed_curve import clip_of, matches_curve
from animtool.clip.reduction.points import SHELL_DISTANCE, joint_bounds
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.record import dataclass
from animtool.formats.gltf.glb import GlbBuilder
from animtool.formats.gltf.sampler_keys import (
    SamplerKeys,
    convert_clip_keys,
    convert_native_keys,
    reduce_keys,
)
from animtool.formats.gltf.sampling import NativeKeys
from animtool.formats.gltf.write_rig import RigIndices
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig

# A static value this close to that of the node needs no channel.
STATIC_TOLERANCE = 1e-9
WEIGHT_TOLERANCE = 1e-3  # of reduced weights [1]
_CHUNK_FRAMES = 256


@dataclass(slots=True)
class _AnimationBuilder:
    """Builds the samplers and channels of an animation."""

    builder: GlbBuilder
    samplers: list[dict[str, Any]] = field(default_factory=list)
    channels: list[dict[str, Any]] = field(default_factory=list)
    # Node, path and keys of each animated property.
    tracks: list[tuple[int, str, SamplerKeys]] = field(default_factory=list)
    # By the id of times: the times, which keeps the id unique, and their accessor.
    time_accessors: dict[int, tuple[FloatArray, int]] = field(default_factory=dict)

    def add_times(self, times: FloatArray) -> int:
        """Return the accessor of key times, which are stored once."""
        if id(times) not in self.time_accessors:
            rows = times.astype(np.float32)[:, None]
            accessor = self.builder.add_accessor(rows, has_bounds=True)
            self.time_accessors[id(times)] = times, accessor
        return self.time_accessors[id(times)][1]

    def extend_to(self, end: float) -> bool:
        """Return whether keys reach a time [s]; a static track is extended to it."""
        if any(keys.times[-1] >= end for *_, keys in self.tracks):
            return True
        for track_index, (node, path, keys) in enumerate(self.tracks):
            if len(keys.times) == 1:
                times = np.array([keys.times[0], end])
                extended_keys = SamplerKeys(times, np.repeat(keys.values, 2, axis=0))
                self.tracks[track_index] = (node, path, extended_keys)
                return True
        return False

    def write(self) -> None:
        """Write the samplers and channels of all added keys."""
        for node, path, keys in self.tracks:
            rows = keys.accessor_rows(is_scalar=path == "weights")
            rows = rows.astype(np.float32, copy=False)
            sampler: dict[str, Any] = {
                "input": self.add_times(keys.times),
                "output": self.builder.add_accessor(rows),
            }
            if keys.interpolation != "LINEAR":
                sampler["interpolation"] = keys.interpolation
            target = {"node": node, "path": path}
            self.channels.append({"sampler": len(self.samplers), "target": target})
            self.samplers.append(sampler)


def write_clip(
    builder: GlbBuilder,
    take: Take,
    name: str,
    rig_indices: RigIndices,
    scales: FloatArray,
    tolerance: float | None,
) -> list[Fault]:
    """Write a take as an animation; return notices about lost data.

    The first frame is time 0. A static value has a channel with one key if it differs
    from the node's. A take that still equals its source clip is written with the clip's
    keys; other takes have a key per frame or, with a tolerance, the keys that linear
    interpolation needs.

    Args:
        builder: Builder of the file.
        take: The take, Y up.
        name: Name of the animation.
        rig_indices: Indices of the rig in the file.
        scales: Scales of the nodes ``(J, 3)``.
        tolerance: Largest error of a joint position [m]; None writes a key per frame.
    """
    clock = take.clock
    seconds = (clock.times - float(clock.start)) / float(clock.fps)
    animation = _AnimationBuilder(builder)
    source_keys = {} if tolerance is not None else _source_keys(take)
    tolerances = {} if tolerance is None else _key_tolerances(take.rig, tolerance)
    motion, rig = take.motion, take.rig
    channels: list[tuple[str, Channel | None, FloatArray]] = [
        ("translation", motion.translations, rig.rest_translations),
        ("rotation", motion.rotations, rig.rest_rotations),
        ("scale", motion.scales, scales),
    ]
    for path, channel, rest_values in channels:
        if channel is None:
            continue
        samples = _samples_by_row(channel, converts_to_float32=tolerance is None)
        for j in range(len(rig.joints)):
            values = samples.get(j, channel.rest[j][None])
            keys = _joint_keys(path, values, rest_values[j], seconds)
            if keys is not None and len(keys.times) > 1:
                if (j, path) in source_keys:
                    keys = source_keys[j, path]
                elif tolerances:
                    keys = reduce_keys(keys, float(tolerances[path][j]))
            if keys is not None:
                animation.tracks.append((rig_indices.joints[j], path, keys))
    lost_notices = _write_weights(
        animation, take, rig_indices, seconds, source_keys, tolerance
    )
    duration = float(seconds[-1])
    if tolerance is None and matches_curve(take):
        native_keys = getattr(take.curve, "native_keys", None)
        duration = (
            native_keys.last_time if isinstance(native_keys, NativeKeys) else duration
        )
    if not animation.extend_to(duration):
        # glTF requires a channel: a static key keeps the name and duration of the clip.
        _add_static_key(animation, take, rig_indices, seconds[:1])
        animation.extend_to(duration)
    animation.write()
    animation_json = {
        "name": name,
        "channels": animation.channels,
        "samplers": animation.samplers,
        # The reader restores the frames from these.
        "extras": {"animtool": {"fps": str(clock.fps), "start": str(clock.start)}},
    }
    builder.add("animations", animation_json)
    return lost_notices


def _source_keys(take: Take) -> dict[tuple[int, str], SamplerKeys]:
    """Return the keys that a take was read with; empty if it has changed since."""
    start = take.clock.start
    if not matches_curve(take):
        return {}
    native_keys = getattr(take.curve, "native_keys", None)
    if isinstance(native_keys, NativeKeys):
        return convert_native_keys(native_keys, start)
    clip = clip_of(take)
    return {} if clip is None else convert_clip_keys(clip, take, start)


def _add_static_key(
    animation: _AnimationBuilder, take: Take, rig_indices: RigIndices, times: FloatArray
) -> None:
    """Add a static key for the first joint property without keys."""
    rig = take.rig
    keyed_paths = {(node, path) for node, path, _ in animation.tracks}
    rest_values_by_path = {
        "translation": rig.rest_translations,
        "rotation": rig.rest_rotations,
    }
    for path, rest_values in rest_values_by_path.items():
        for node, rest_value in zip(rig_indices.joints, rest_values, strict=True):
            if (node, path) not in keyed_paths:
                animation.tracks.append((node, path, _single_key(rest_value, times)))
                return
    if not rig.joints:
        key = _single_key(np.zeros(3), times)
        animation.tracks.append((0, "translation", key))


def _single_key(value: FloatArray, times: FloatArray) -> SamplerKeys:
    return SamplerKeys(times[:1], value.reshape(1, -1))


def _samples_by_row(
    channel: Channel, *, converts_to_float32: bool
) -> dict[int, FloatArray]:
    """Return the samples of each animated joint ``(F, K)``.

    ``converts_to_float32`` converts them to the type that files store.
    """
    values = channel.values
    if not len(values):
        return {}
    dtype = np.float32 if converts_to_float32 else np.float64
    joint_samples = _joints_first(values, dtype)
    return dict(zip(channel.animated.tolist(), joint_samples, strict=True))


def _joints_first(values: FloatArray, dtype: type[np.floating[Any]]) -> Any:
    """Return samples ``(F, J, K)`` as ``(J, F, K)`` of a dtype.

    The samples of a joint are copied as one element, in chunks of frames that stay in
    the processor's cache.
    """
    frame_count, joint_count, width = values.shape
    joint_dtype = np.dtype((np.void, width * np.dtype(dtype).itemsize))
    joint_samples = np.empty((joint_count, frame_count), joint_dtype)
    for first in range(0, frame_count, _CHUNK_FRAMES):
        rows = np.ascontiguousarray(values[first : first + _CHUNK_FRAMES], dtype)
        joint_samples[:, first : first + _CHUNK_FRAMES] = rows.view(joint_dtype)[
            :, :, 0
        ].T
    return joint_samples.view(dtype).reshape(joint_count, frame_count, width)


def _joint_keys(
    path: str, values: FloatArray, rest_value: FloatArray, seconds: FloatArray
) -> SamplerKeys | None:
    """Return the keys of a joint's samples; None if equal to the node's value."""
    first_value = values[0]
    # Most animated joints differ in the last frame, which is compared first.
    is_last_changed = len(values) > 1 and (values[-1] != first_value).any()
    if is_last_changed or (len(values) > 1 and (values != first_value).any()):
        return SamplerKeys(seconds, values)
    difference = np.abs(first_value - rest_value).max()
    if path == "rotation":
        difference = min(difference, np.abs(first_value + rest_value).max())
    return None if difference <= STATIC_TOLERANCE else _single_key(first_value, seconds)


def _key_tolerances(rig: Rig, tolerance: float) -> dict[str, FloatArray]:
    """Return the key tolerances of all joints ``(J,)`` by path: [m], [rad] or [1]."""
    bounds = joint_bounds(rig, tolerance, {})
    bounds_per_reach = bounds / np.maximum(SHELL_DISTANCE, _joint_reaches(rig))
    return {
        "translation": bounds,
        "rotation": bounds_per_reach,
        "scale": bounds_per_reach,
    }


def _joint_reaches(rig: Rig) -> FloatArray:
    """Return the length of the longest joint chain below each joint ``(J,)`` [m]."""
    reaches = np.zeros(len(rig.joints))
    lengths = np.linalg.norm(rig.rest_translations, axis=1)
    for j in range(len(rig.joints) - 1, -1, -1):
        parent = rig.joints[j].parent
        if parent >= 0:
            reaches[parent] = max(reaches[parent], reaches[j] + lengths[j])
    return reaches


def _write_weights(
    animation: _AnimationBuilder,
    take: Take,
    rig_indices: RigIndices,
    seconds: FloatArray,
    source_keys: dict[tuple[int, str], SamplerKeys],
    tolerance: float | None,
) -> list[Fault]:
    """Write morph target weights of each mesh."""
    weights = take.motion.weights
    if weights is None:
        return []
    shape_names = [shape.name for shape in take.rig.shapes]
    dense_weights = weights.dense()[:, :, 0]
    json_root = animation.builder.json
    for node, shapes in rig_indices.targets.items():
        shape_indices = [shape_names.index(shape) for shape in shapes]
        values = dense_weights[:, shape_indices]
        mesh = json_root["meshes"][json_root["nodes"][node]["mesh"]]
        if (values == values[:1]).all():
            if np.abs(values[0] - mesh["weights"]).max() > STATIC_TOLERANCE:
                key = _single_key(values[0], seconds)
                animation.tracks.append((node, "weights", key))
            continue
        keys = SamplerKeys(seconds, values)
        if tolerance is not None:
            keys = reduce_keys(keys, WEIGHT_TOLERANCE)
        track_keys = _combine_weights(
            [source_keys.get((row, "weights")) for row in shape_indices], values
        )
        animation.tracks.append((node, "weights", track_keys or keys))
    unwritten_names = [
        shape_names[row]
        for row in weights.animated.tolist()
        if shape_names[row] not in rig_indices.shapes
    ]
    if not unwritten_names:
        return []
    message = f"weights of shapes without a mesh are skipped: {listed(unwritten_names)}"
    return [Fault("GLT117", message, severity=Severity.NOTE)]


def _static_keys(timed_keys: SamplerKeys, value: float) -> SamplerKeys:
    """Return keys with a constant value at the times of other keys."""
    values = np.full((len(timed_keys.times), 1), value)
    slopes = None if timed_keys.in_slopes is None else np.zeros_like(values)
    return SamplerKeys(
        timed_keys.times, values, timed_keys.interpolation, slopes, slopes
    )


def _merge_weights(weight_keys: list[SamplerKeys]) -> SamplerKeys | None:
    """Merge linear or stepped weights at the union of key times; None for others."""
    interpolation = weight_keys[0].interpolation
    if interpolation == "CUBICSPLINE" or any(
        keys.interpolation != interpolation for keys in weight_keys
    ):
        return None
    times = np.unique(np.concatenate([keys.times for keys in weight_keys]))
    columns = []
    for keys in weight_keys:
        values = keys.values[:, 0]
        if interpolation == "STEP":
            key_indices = np.searchsorted(keys.times, times, "right") - 1
            columns.append(values[np.clip(key_indices, 0, None)])
        else:
            columns.append(np.interp(times, keys.times, values))
    return SamplerKeys(times, np.stack(columns, axis=1), interpolation)


def _combine_weights(
    weight_keys: list[SamplerKeys | None], samples: FloatArray
) -> SamplerKeys | None:
    """Return the keys of all weights as one track; None if glTF cannot store it.

    ``samples`` ``(F, S)`` are the weights over frames; static weights use the key times
    of the others.
    """
    first_keys = next((keys for keys in weight_keys if keys is not None), None)
    if first_keys is None:
        return None
    is_static = (samples == samples[:1]).all(axis=0).tolist()
    all_keys = []
    for k, keys in enumerate(weight_keys):
        if keys is None and not is_static[k]:
            return None
        all_keys.append(keys or _static_keys(first_keys, float(samples[0, k])))
    has_same_times = all(
        keys.interpolation == first_keys.interpolation
        and np.array_equal(keys.times, first_keys.times)
        for keys in all_keys
    )
    if not has_same_times:
        return _merge_weights(all_keys)

    def stack_columns(name: str) -> FloatArray | None:
        rows = [getattr(track, name) for track in all_keys]
        return None if rows[0] is None else np.concatenate(rows, axis=1)

    values = stack_columns("values")
    assert values is not None
    return SamplerKeys(
        first_keys.times,
        values,
        first_keys.interpolation,
        stack_columns("in_slopes"),
        stack_columns("out_slopes"),
    )
