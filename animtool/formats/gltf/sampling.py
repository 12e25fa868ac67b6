"""glTF animations sampled as rig motion at any times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.record import dataclass
from animtool.formats.characters.stream import sampled_stream
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import Animation, GltfTrack, between
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.rig import GltfRig, folded_nodes
from animtool.formats.gltf.timing import GltfFrames
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream

# A time this near to a key, by its size, is the key: float32 holds no other.
NEAR = 1.5 * float(np.finfo(np.float32).eps)
# Frames of a block, of which 60 joints take 30 MB, and of a piece of one.
BLOCK, PIECE = 16384, 512


@dataclass(frozen=True, slots=True, eq=False)
class MovingRow:
    """A track and the channel row that it animates."""

    row: int
    track: GltfTrack
    factor: float = 1.0  # of its values, as the rig has them


@dataclass(slots=True, eq=False)
class GltfSampler:
    """Sampler of an animation's rig motion at any times."""

    rest: dict[TargetPath, FloatArray]  # of each channel ``(rows, width)``
    moving: dict[TargetPath, list[MovingRow]]
    scaled: bool  # whether there is a scale
    _grids: dict[int, tuple[IntArray | slice, FloatArray]] = field(default_factory=dict)

    @property
    def numbers(self) -> int:
        """Count of animated numbers per frame."""
        counts = {TargetPath.ROTATION: 4, TargetPath.WEIGHTS: 1}
        return sum(
            counts.get(path, 3) * len(tracks) for path, tracks in self.moving.items()
        )

    def at(self, times: FloatArray) -> Motion:
        """Return the motion at times ``(F,)`` [s]."""
        self._grids.clear()
        channels = {path: self._channel(path, times) for path in self.rest}
        shapes = len(self.rest[TargetPath.WEIGHTS])
        return Motion(
            channels[TargetPath.TRANSLATION],
            channels[TargetPath.ROTATION],
            channels[TargetPath.SCALE] if self.scaled else None,
            channels[TargetPath.WEIGHTS] if shapes else None,
        )

    def _channel(self, path: TargetPath, times: FloatArray) -> Channel:
        rest, moving = self.rest[path], self.moving[path]
        rows = np.array([one.row for one in moving], np.int64)
        if path is TargetPath.ROTATION and moving:
            keys = [self._keys(one.track, times) for one in moving]
            packed = [each for each in keys if each is not None]
            if len(packed) == len(keys):
                return Channel(rest, rows, _kernels.unpack_rotations(packed, None))
        values = np.empty((len(times), len(moving), rest.shape[1]))
        groups = _groups(moving)
        factors = np.array([one.factor for one in moving])[:, None]
        scaled = bool((factors != 1.0).any())
        # A piece stays in the processor's cache.
        for at in range(0, len(times) if moving else 0, PIECE):
            part = slice(at, min(at + PIECE, len(times)))
            for columns in groups:
                tracks = [moving[k].track for k in columns]
                values[part, columns] = self._values(tracks, times, part)
            if scaled:
                values[part] *= factors
            if path is TargetPath.ROTATION:
                _unit(values[part])
                _continue(values[part], values[at - 1] if at else None)
        return Channel(rest, rows, values)

    def _grid(
        self, keys: FloatArray, times: FloatArray
    ) -> tuple[IntArray | slice, FloatArray]:
        """Return `segments`, cached for tracks with the same keys."""
        if id(keys) not in self._grids:
            self._grids[id(keys)] = segments(keys, times)
        return self._grids[id(keys)]

    def _keys(
        self, track: GltfTrack, times: FloatArray
    ) -> npt.NDArray[np.float32] | None:
        """Return a track's keys if the times are successive keys of it.

        None where the times are others, or the file does not have floats.
        """
        if track.values.dtype != np.float32 or len(track.times) == 1:
            return None
        low, _ = self._grid(track.times, times)
        if not isinstance(low, slice):
            return None
        return np.require(track.values[low], "f4", ["C", "A"])

    def _values(
        self, tracks: list[GltfTrack], times: FloatArray, part: slice
    ) -> FloatArray:
        """Return values ``(F, N, W)`` of a group of tracks at some times.

        Rotations may have any length.
        """
        keys = tracks[0].times
        if len(keys) == 1:
            return np.stack([track.at(times[part]) for track in tracks], axis=1)
        low, fractions = self._grid(keys, times)
        if isinstance(low, slice):
            at = slice(low.start + part.start, low.start + part.stop)
            return np.stack([track.values[at] for track in tracks], axis=1)
        if fractions is _ON_KEYS:
            return np.stack([track.values[low[part]] for track in tracks], axis=1)
        return between(tracks, low[part], fractions[part])


def _groups(moving: list[MovingRow]) -> list[list[int]]:
    """Group columns of tracks with common key times and interpolation."""
    groups: dict[tuple[int, str], list[int]] = {}
    for k, one in enumerate(moving):
        key = id(one.track.times), str(one.track.interpolation)
        groups.setdefault(key, []).append(k)
    return list(groups.values())


@dataclass(frozen=True, slots=True, eq=False)
class NativeKeys:
    """Tracks of an animation, its start frame, and its last key [s]."""

    sampler: GltfSampler
    frames: GltfFrames
    last: float


_ON_KEYS = np.zeros(0)


def segments(
    keys: FloatArray, times: FloatArray
) -> tuple[IntArray | slice, FloatArray]:
    """Return the key before each time; times near a key are set to the key.

    Where all of them are keys, or outside of these, the times are `_ON_KEYS` and the
    indices those of the keys.
    """
    last = len(keys) - 1
    low = np.searchsorted(keys, times, "right") - 1
    low = np.clip(low, 0, last)
    after = np.minimum(low + 1, last)
    room = NEAR * np.abs(times)
    to_next = np.abs(keys[after] - times) <= room
    low = np.where(to_next, after, low)
    near = np.abs(keys[low] - times) <= room
    near |= (times <= keys[0]) | (times >= keys[-1])
    if near.all():
        if len(low) == 1 or (np.diff(low) == 1).all():
            return slice(int(low[0]), int(low[0]) + len(low)), _ON_KEYS
        return np.asarray(low), _ON_KEYS
    snapped = np.where(near, keys[low], times)
    return np.minimum(low, last - 1), snapped


def _unit(rotations: FloatArray) -> None:
    """Normalise rotations ``(F, J, 4)`` in place."""
    squares = np.einsum("fjc,fjc->fj", rotations, rotations)
    np.divide(rotations, np.sqrt(squares)[:, :, None], out=rotations)


def _continue(rotations: FloatArray, before: FloatArray | None) -> None:
    """Make quaternion signs continuous over time, in place.

    before: the rotations before the first ``(J, 4)``; None begins with w above 0.
    """
    dots = np.einsum("fjc,fjc->fj", rotations[1:], rotations[:-1])
    flat = rotations[0, :, 3]
    first = flat if before is None else np.einsum("jc,jc->j", rotations[0], before)
    if first.min(initial=0.0) < 0 or dots.min(initial=0.0) < 0:
        rotations[:] = so3.align_signs(rotations, before)


def sampler_of(
    gltf: Gltf, gltf_rig: GltfRig, animation: Animation | None
) -> GltfSampler:
    """Return the sampler of a rig's animation; None is at rest."""
    rig = gltf_rig.rig
    rest = {
        TargetPath.TRANSLATION: rig.rest_translations.copy(),
        TargetPath.ROTATION: rig.rest_rotations.copy(),
        TargetPath.SCALE: gltf_rig.scales.copy(),
        TargetPath.WEIGHTS: rest_weights(gltf, gltf_rig),
    }
    moving: dict[TargetPath, list[MovingRow]] = {path: [] for path in rest}
    even = folded_nodes(gltf)
    for path, one in _rows(gltf, gltf_rig, animation.tracks if animation else (), even):
        if _is_static(one.track):
            value = one.track.at(one.track.times[:1])[0] * one.factor
            rest[path][one.row] = value
        else:
            moving[path].append(one)
    for rows in moving.values():
        rows.sort(key=lambda one: one.row)
    scaled = bool(moving[TargetPath.SCALE]) or bool(
        (rest[TargetPath.SCALE] != 1.0).any()
    )
    return GltfSampler(rest, moving, scaled)


def _is_static(track: GltfTrack) -> bool:
    """Return whether a track's value never changes."""
    slopes = [part for part in (track.ins, track.outs) if part is not None]
    if len(track.times) == 1:
        return True
    values = track.values
    if any(part.any() for part in slopes):
        return False
    return bool((values[-1] == values[0]).all() and (values == values[:1]).all())


def rest_weights(gltf: Gltf, gltf_rig: GltfRig) -> FloatArray:
    """Return the shape weights without an animation ``(S, 1)``."""
    weights = np.zeros((len(gltf_rig.shapes), 1))
    for row, (node, target) in enumerate(gltf_rig.shapes):
        node_weights = gltf.nodes[node].weights
        mesh_weights = gltf.meshes[gltf.nodes[node].mesh].weights
        weights[row] = (
            mesh_weights[target] if node_weights is None else node_weights[target]
        )
    return weights


def _rows(
    gltf: Gltf, gltf_rig: GltfRig, tracks: Sequence[GltfTrack], even: BoolArray
) -> list[tuple[TargetPath, MovingRow]]:
    """Return the channel rows that tracks animate."""
    rows: list[tuple[TargetPath, MovingRow]] = []
    of_meshes: list[GltfTrack] = []
    for track in tracks:
        if track.path is TargetPath.WEIGHTS:
            of_meshes.append(track)
            continue
        joint = int(gltf_rig.joints[track.node])
        if joint < 0 or track.path is TargetPath.VISIBLE:
            continue
        if track.path is TargetPath.SCALE and even[track.node]:
            continue
        factor = 1.0
        if track.path is TargetPath.TRANSLATION:
            above = gltf.nodes[track.node].parent
            factor = 1.0 if above < 0 else float(gltf_rig.folded[above])
            factor *= gltf_rig.rig.meters_per_unit
        rows.append((track.path, MovingRow(joint, track, factor)))
    rows += _weight_rows(gltf, gltf_rig, of_meshes)
    return rows


def _weight_rows(
    gltf: Gltf, gltf_rig: GltfRig, tracks: Sequence[GltfTrack]
) -> list[tuple[TargetPath, MovingRow]]:
    """Return animated shapes; tracks of nodes come before those of meshes."""
    by_row: dict[int, GltfTrack] = {}
    for track in sorted(tracks, key=lambda one: (one.node < 0, one.part < 0)):
        for row, (node, target) in enumerate(gltf_rig.shapes):
            entry = gltf.nodes[node]
            by_mesh = track.mesh == entry.mesh and entry.weights is None
            if (track.node == node or (track.node < 0 and by_mesh)) and (
                track.part in {-1, target}
            ):
                by_row.setdefault(row, _one_weight(track, target))
    return [
        (TargetPath.WEIGHTS, MovingRow(row, track)) for row, track in by_row.items()
    ]


def _one_weight(track: GltfTrack, target: int) -> GltfTrack:
    """Return the keys of one weight of a track."""
    if track.part >= 0 or track.values.shape[1] == 1:
        return track
    one = slice(target, target + 1)
    return GltfTrack(
        track.node,
        track.mesh,
        track.path,
        target,
        track.interpolation,
        track.times,
        track.values[:, one],
        None if track.ins is None else track.ins[:, one],
        None if track.outs is None else track.outs[:, one],
    )


def clip_stream(
    gltf_rig: GltfRig, moving: GltfSampler, frames: GltfFrames
) -> TakeStream:
    """Return an animation as a stream, sampled block by block."""
    clock = Clock(frames.fps, frames.first, Fraction(1), frames.count)

    def sample(codes: FloatArray) -> Motion:
        return moving.at(frames.seconds(codes))

    return sampled_stream(gltf_rig.rig, clock, sample, BLOCK)


def moves(gltf_rig: GltfRig, animation: Animation) -> bool:
    """Return whether an animation moves the rig."""
    shapes = {node for node, _ in gltf_rig.shapes}
    return any(
        track.mesh >= 0 or gltf_rig.joints[track.node] >= 0 or track.node in shapes
        for track in animation.tracks
    )
