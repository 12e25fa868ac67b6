"""Samples glTF animations as rig motion at arbitrary times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.record import dataclass
from animtool.formats.characters.stream import build_sampled_stream
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import Animation, GltfTrack, interpolate_tracks
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.rig import GltfRig, find_baked_nodes
from animtool.formats.gltf.timing import GltfFrames
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream

# Times this close to a key, relative to the time, equal the key in float32.
KEY_TIME_TOLERANCE = 1.5 * float(np.finfo(np.float32).eps)
# Frames per block of a stream (30 MB for 60 joints), and per chunk evaluated at once.
BLOCK_FRAMES, CHUNK_FRAMES = 16384, 512


@dataclass(frozen=True, slots=True, eq=False)
class RigTrack:
    """A track of a file, and the joint or shape of the rig that it animates."""

    row: int  # index of the joint or shape
    track: GltfTrack
    factor: float = 1.0  # factor from the track's values to the rig's


@dataclass(slots=True, eq=False)
class GltfSampler:
    """Samples an animation as motion of a rig at arbitrary times."""

    # Static values of each channel ``(rows, width)``.
    rest_values: dict[TargetPath, FloatArray]
    tracks: dict[TargetPath, list[RigTrack]]
    has_scale: bool  # whether any joint has a scale
    _segments_by_keys: dict[int, tuple[IntArray | slice, FloatArray]] = field(
        default_factory=dict
    )

    @property
    def values_per_frame(self) -> int:
        """Number of animated values per frame."""
        widths = {TargetPath.ROTATION: 4, TargetPath.WEIGHTS: 1}
        return sum(widths.get(p, 3) * len(t) for p, t in self.tracks.items())

    def sample(self, times: FloatArray) -> Motion:
        """Return the motion at times ``(F,)`` [s]."""
        self._segments_by_keys.clear()
        channels = {path: self._channel(path, times) for path in self.rest_values}
        shape_count = len(self.rest_values[TargetPath.WEIGHTS])
        return Motion(
            channels[TargetPath.TRANSLATION],
            channels[TargetPath.ROTATION],
            channels[TargetPath.SCALE] if self.has_scale else None,
            channels[TargetPath.WEIGHTS] if shape_count else None,
        )

    def _channel(self, path: TargetPath, times: FloatArray) -> Channel:
        rest_values, rig_tracks = self.rest_values[path], self.tracks[path]
        rows = np.array([rig_track.row for rig_track in rig_tracks], np.int64)
        if path is TargetPath.ROTATION and rig_tracks:
            keys_by_row = [self._consecutive_keys(r.track, times) for r in rig_tracks]
            channel_keys = [r for r in keys_by_row if r is not None]
            if len(channel_keys) == len(keys_by_row):
                values = _kernels.unpack_rotations(channel_keys, None)
                return Channel(rest_values, rows, values)
        values = np.empty((len(times), len(rig_tracks), rest_values.shape[1]))
        track_groups = _group_tracks(rig_tracks)
        factors = np.array([rig_track.factor for rig_track in rig_tracks])[:, None]
        has_scale = bool((factors != 1.0).any())
        # A chunk stays in the processor's cache.
        for first in range(0, len(times) if rig_tracks else 0, CHUNK_FRAMES):
            chunk = slice(first, min(first + CHUNK_FRAMES, len(times)))
            for columns in track_groups:
                tracks = [rig_tracks[k].track for k in columns]
                values[chunk, columns] = self._track_values(tracks, times, chunk)
            if has_scale:
                values[chunk] *= factors
            if path is TargetPath.ROTATION:
                _normalize_rows(values[chunk])
                _align_signs(values[chunk], values[first - 1] if first else None)
        return Channel(rest_values, rows, values)

    def _cached_segments(
        self, key_times: FloatArray, times: FloatArray
    ) -> tuple[IntArray | slice, FloatArray]:
        """Return `_find_segments`, computed once per array of key times."""
        if id(key_times) not in self._segments_by_keys:
            self._segments_by_keys[id(key_times)] = _find_segments(key_times, times)
        return self._segments_by_keys[id(key_times)]

    def _consecutive_keys(
        self, track: GltfTrack, times: FloatArray
    ) -> npt.NDArray[np.float32] | None:
        """Return the track's values at times that are consecutive keys of the track.

        Returns None for other times, and for files that do not store floats.
        """
        if track.values.dtype != np.float32 or len(track.times) == 1:
            return None
        key_indices, _ = self._cached_segments(track.times, times)
        if not isinstance(key_indices, slice):
            return None
        return np.require(track.values[key_indices], "f4", ["C", "A"])

    def _track_values(
        self, tracks: list[GltfTrack], times: FloatArray, chunk: slice
    ) -> FloatArray:
        """Return values ``(F, N, W)`` of a group of tracks at a chunk of the times.

        Rotations are not normalized.
        """
        key_times = tracks[0].times
        if len(key_times) == 1:
            return np.stack([track.sample(times[chunk]) for track in tracks], axis=1)
        key_indices, fractions = self._cached_segments(key_times, times)
        if isinstance(key_indices, slice):
            first_key = key_indices.start
            chunk_keys = slice(first_key + chunk.start, first_key + chunk.stop)
            return np.stack([track.values[chunk_keys] for track in tracks], axis=1)
        if fractions is _TIMES_ON_KEYS:
            return np.stack([t.values[key_indices[chunk]] for t in tracks], axis=1)
        return interpolate_tracks(tracks, key_indices[chunk], fractions[chunk])


def _group_tracks(rig_tracks: list[RigTrack]) -> list[list[int]]:
    """Return groups of the indices of tracks with equal key times and interpolation."""
    groups: dict[tuple[int, str], list[int]] = {}
    for k, rig_track in enumerate(rig_tracks):
        group_key = id(rig_track.track.times), str(rig_track.track.interpolation)
        groups.setdefault(group_key, []).append(k)
    return list(groups.values())


@dataclass(frozen=True, slots=True, eq=False)
class NativeKeys:
    """The keys of an animation as stored in the file, for writing them again."""

    sampler: GltfSampler
    frames: GltfFrames
    last_time: float


_TIMES_ON_KEYS = np.zeros(0)


def _find_segments(
    key_times: FloatArray, times: FloatArray
) -> tuple[IntArray | slice, FloatArray]:
    """Return the index of the key before each time, and times snapped to nearby keys.

    If all times are keys or outside the keys, the times are `_TIMES_ON_KEYS` and the
    indices are those of the keys.
    """
    last_index = len(key_times) - 1
    key_indices = np.searchsorted(key_times, times, "right") - 1
    key_indices = np.clip(key_indices, 0, last_index)
    next_indices = np.minimum(key_indices + 1, last_index)
    tolerance = KEY_TIME_TOLERANCE * np.abs(times)
    is_near_next = np.abs(key_times[next_indices] - times) <= tolerance
    key_indices = np.where(is_near_next, next_indices, key_indices)
    is_on_key = np.abs(key_times[key_indices] - times) <= tolerance
    is_on_key |= (times <= key_times[0]) | (times >= key_times[-1])
    if is_on_key.all():
        if len(key_indices) == 1 or (np.diff(key_indices) == 1).all():
            first_index = int(key_indices[0])
            return slice(first_index, first_index + len(key_indices)), _TIMES_ON_KEYS
        return np.asarray(key_indices), _TIMES_ON_KEYS
    snapped_times = np.where(is_on_key, key_times[key_indices], times)
    return np.minimum(key_indices, last_index - 1), snapped_times


def _normalize_rows(rotations: FloatArray) -> None:
    """Normalise rotations ``(F, J, 4)`` in place."""
    squared_lengths = np.einsum("fjc,fjc->fj", rotations, rotations)
    np.divide(rotations, np.sqrt(squared_lengths)[:, :, None], out=rotations)


def _align_signs(rotations: FloatArray, previous: FloatArray | None) -> None:
    """Make quaternion signs continuous over time, in place.

    ``previous`` are the rotations before the first frame ``(J, 4)``; None makes w
    positive.
    """
    dots = np.einsum("fjc,fjc->fj", rotations[1:], rotations[:-1])
    signs = rotations[0, :, 3]
    if previous is not None:
        signs = np.einsum("jc,jc->j", rotations[0], previous)
    if signs.min(initial=0.0) < 0 or dots.min(initial=0.0) < 0:
        rotations[:] = so3.align_signs(rotations, previous)


def build_sampler(
    gltf: Gltf, gltf_rig: GltfRig, animation: Animation | None
) -> GltfSampler:
    """Return the sampler of a rig's animation; None samples the rest pose."""
    rig = gltf_rig.rig
    rest = {
        TargetPath.TRANSLATION: rig.rest_translations.copy(),
        TargetPath.ROTATION: rig.rest_rotations.copy(),
        TargetPath.SCALE: gltf_rig.remaining_scales.copy(),
        TargetPath.WEIGHTS: _rest_weights(gltf, gltf_rig),
    }
    tracks: dict[TargetPath, list[RigTrack]] = {path: [] for path in rest}
    gltf_tracks = animation.tracks if animation else ()
    for path, rig_track in _rig_tracks(gltf, gltf_rig, gltf_tracks):
        track = rig_track.track
        if _is_constant(track):
            value = track.sample(track.times[:1])[0] * rig_track.factor
            rest[path][rig_track.row] = value
        else:
            tracks[path].append(rig_track)
    for channel_tracks in tracks.values():
        channel_tracks.sort(key=lambda rig_track: rig_track.row)
    has_scale = bool(tracks[TargetPath.SCALE] or (rest[TargetPath.SCALE] != 1.0).any())
    return GltfSampler(rest, tracks, has_scale)


def _is_constant(track: GltfTrack) -> bool:
    """Return whether a track always has the same value."""
    if len(track.times) == 1:
        return True
    values = track.values
    if any(
        slope is not None and slope.any()
        for slope in (track.in_slopes, track.out_slopes)
    ):
        return False
    return bool((values[-1] == values[0]).all() and (values == values[:1]).all())


def _rest_weights(gltf: Gltf, gltf_rig: GltfRig) -> FloatArray:
    """Return the shape weights of the rest pose ``(S, 1)``."""
    weights = np.zeros((len(gltf_rig.shape_sources), 1))
    for row, (node, target) in enumerate(gltf_rig.shape_sources):
        node_weights = gltf.nodes[node].weights
        if node_weights is None:
            node_weights = gltf.meshes[gltf.nodes[node].mesh].weights
        weights[row] = node_weights[target]
    return weights


def _rig_tracks(
    gltf: Gltf, gltf_rig: GltfRig, tracks: Sequence[GltfTrack]
) -> list[tuple[TargetPath, RigTrack]]:
    """Return the tracks that animate joints and shapes of a rig, each with its path."""
    is_baked = find_baked_nodes(gltf)
    rig_tracks: list[tuple[TargetPath, RigTrack]] = []
    weight_tracks: list[GltfTrack] = []
    for track in tracks:
        if track.path is TargetPath.WEIGHTS:
            weight_tracks.append(track)
            continue
        joint = int(gltf_rig.joint_of_node[track.node])
        if joint < 0 or track.path is TargetPath.VISIBLE:
            continue
        if track.path is TargetPath.SCALE and is_baked[track.node]:
            continue
        factor = 1.0
        if track.path is TargetPath.TRANSLATION:
            parent = gltf.nodes[track.node].parent
            factor = 1.0 if parent < 0 else float(gltf_rig.baked_scales[parent])
            factor *= gltf_rig.rig.meters_per_unit
        rig_tracks.append((track.path, RigTrack(joint, track, factor)))
    return rig_tracks + _weight_tracks(gltf, gltf_rig, weight_tracks)


def _weight_tracks(
    gltf: Gltf, gltf_rig: GltfRig, tracks: Sequence[GltfTrack]
) -> list[tuple[TargetPath, RigTrack]]:
    """Return the tracks of shapes; tracks of nodes override those of meshes."""
    track_by_row: dict[int, GltfTrack] = {}
    for track in sorted(tracks, key=lambda t: (t.node < 0, t.weight_index < 0)):
        for row, (node, target) in enumerate(gltf_rig.shape_sources):
            gltf_node = gltf.nodes[node]
            is_animated = track.node == node
            if track.node < 0:
                is_animated = track.mesh == gltf_node.mesh and gltf_node.weights is None
            if is_animated and track.weight_index in {-1, target}:
                track_by_row.setdefault(row, _single_weight_track(track, target))
    return [(TargetPath.WEIGHTS, RigTrack(r, t)) for r, t in track_by_row.items()]


def _single_weight_track(track: GltfTrack, target: int) -> GltfTrack:
    """Return the keys of one weight of a track."""
    if track.weight_index >= 0 or track.values.shape[1] == 1:
        return track
    column = slice(target, target + 1)
    return replace(
        track,
        weight_index=target,
        values=track.values[:, column],
        in_slopes=None if track.in_slopes is None else track.in_slopes[:, column],
        out_slopes=None if track.out_slopes is None else track.out_slopes[:, column],
    )


def build_stream(
    gltf_rig: GltfRig, sampler: GltfSampler, frames: GltfFrames
) -> TakeStream:
    """Return an animation as a stream, sampled block by block."""
    clock = Clock(frames.fps, frames.first_frame, Fraction(1), frames.count)

    def sample(codes: FloatArray) -> Motion:
        return sampler.sample(frames.seconds(codes))

    return build_sampled_stream(gltf_rig.rig, clock, sample, BLOCK_FRAMES)


def animates_rig(gltf_rig: GltfRig, animation: Animation) -> bool:
    """Return whether an animation moves the rig."""
    shape_nodes = {node for node, _ in gltf_rig.shape_sources}
    return any(
        t.mesh >= 0 or gltf_rig.joint_of_node[t.node] >= 0 or t.node in shape_nodes
        for t in animation.tracks
    )


def count_animated_joints(gltf_rig: GltfRig, animation: Animation) -> int:
    """Return how many joints of a rig have tracks in an animation."""
    tracks = (track for track in animation.tracks if track.mesh < 0)
    joints = {int(gltf_rig.joint_of_node[track.node]) for track in tracks}
    return len(joints - {-1})
