"""Keys of glTF samplers: from clips, from glTF sources, and reduced."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.sampling import NativeKeys
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.tangents import Tangent
from animtool.motion.take import Take
from animtool.rig.joints import KEYED_PARTS, split_part

# Tolerance of a handle's time from a third of its segment [1].
HANDLE_TOLERANCE = 1e-6
_PATHS_BY_PART = {
    "local_translation": "translation",
    "local_rotation": "rotation",
    "scale": "scale",
}
# Clip channels that are added to others; their sum cannot be stored as keys.
_ADDITIVE_PARTS = {
    "translation": "translation",
    "slide": "translation",
    "rotation": "rotation",
    "angle": "rotation",
}


@dataclass(frozen=True, slots=True, eq=False)
class SamplerKeys:
    """Keys of a property as a sampler stores them."""

    times: FloatArray  # ``(K,)`` [s]
    values: FloatArray  # ``(K, W)``
    interpolation: str = "LINEAR"
    in_slopes: FloatArray | None = None  # slopes into the keys ``(K, W)`` [1/s]
    out_slopes: FloatArray | None = None  # slopes out of the keys ``(K, W)`` [1/s]

    def accessor_rows(self, *, is_scalar: bool = False) -> FloatArray:
        """Return the rows of an output accessor, of one number each if ``is_scalar``.

        Cubic splines have three rows a key: incoming slope, value and outgoing slope.
        """
        rows = self.values
        if self.in_slopes is not None and self.out_slopes is not None:
            rows = np.stack([self.in_slopes, self.values, self.out_slopes], axis=1)
        return rows.reshape(-1, 1 if is_scalar else self.values.shape[1])


def convert_clip_keys(
    clip: Clip, take: Take, start: Fraction
) -> dict[tuple[int, str], SamplerKeys]:
    """Return the keys of a clip that glTF can store, by joint or shape and path.

    Args:
        clip: The clip.
        take: The take sampled from the clip.
        start: Time code of time 0.
    """
    all_keys: dict[tuple[int, str], SamplerKeys] = {}
    additive_keys: set[tuple[int, str]] = set()
    shapes = [shape.name for shape in take.rig.shapes]
    for channel in clip.channels:
        target_kind, _, name = channel.target.partition("/")
        if target_kind == "shape":
            target_key = (shapes.index(name), "weights")
        elif target_kind == "joint":
            joint, part = split_part(name, KEYED_PARTS)
            if part in _ADDITIVE_PARTS:
                additive_keys.add((take.rig.index(joint), _ADDITIVE_PARTS[part]))
            if part not in _PATHS_BY_PART:
                continue
            target_key = (take.rig.index(joint), _PATHS_BY_PART[part])
        else:
            continue
        keys = _convert_channel(channel, clip, start)
        if keys is not None:
            all_keys[target_key] = keys
    return {t: k for t, k in all_keys.items() if t not in additive_keys}


def convert_native_keys(
    native_keys: NativeKeys, start: Fraction
) -> dict[tuple[int, str], SamplerKeys]:
    """Return the keys of a glTF source by joint or shape and path, shifted in time.

    Rotations are normalized, except those of cubic splines, which would change.

    ``start`` is the time code of time 0.
    """
    frames = native_keys.frames
    time_offset = float(frames.start - start) / float(frames.fps)
    all_keys: dict[tuple[int, str], SamplerKeys] = {}
    shifted_times: dict[int, FloatArray] = {}
    for path, tracks in native_keys.sampler.tracks.items():
        for rig_track in tracks:
            track = rig_track.track
            key_times = shifted_times.setdefault(
                id(track.times), track.times + time_offset
            )
            if key_times[0] < 0:
                continue
            slopes = [
                None if slopes is None else slopes * rig_track.factor
                for slopes in (track.in_slopes, track.out_slopes)
            ]
            values = track.values
            if rig_track.factor != 1.0:
                values = values * rig_track.factor
            interpolation = str(track.interpolation)
            if path is TargetPath.ROTATION and slopes[0] is None:
                values = so3.normalize(values)
            all_keys[rig_track.row, str(path)] = SamplerKeys(
                key_times, values, interpolation, *slopes
            )
    return all_keys


def _convert_channel(
    channel: ClipChannel, clip: Clip, start: Fraction
) -> SamplerKeys | None:
    """Return the keys of a channel; None if glTF has no equivalent curve."""
    is_constant = {channel.pre, channel.post} == {Extrapolation.HOLD}
    if not is_constant or channel.euler or not len(channel.times):
        return None
    seconds = (channel.times - float(start)) / float(clip.fps)
    if seconds[0] < 0:
        return None
    interps = set(channel.interps[:-1]) or {Interp.LINEAR}
    linear_interp = Interp.SLERP if channel.values.shape[1] == 4 else Interp.LINEAR
    if interps == {linear_interp}:
        return SamplerKeys(seconds, channel.values)
    if interps == {Interp.STEP}:
        return SamplerKeys(seconds, channel.values, "STEP")
    if interps == {Interp.BEZIER} and channel.values.shape[1] != 4:
        return _convert_cubic_keys(channel, seconds)
    return None


def _convert_cubic_keys(
    channel: ClipChannel, seconds: FloatArray
) -> SamplerKeys | None:
    """Convert Bézier keys with handles at thirds to cubic splines; else None."""
    durations = np.diff(channel.times)
    out_handles, in_handles = channel.out_handles[:-1], channel.in_handles[1:]
    is_free = all(
        t[1] is Tangent.FREE and a[0] is Tangent.FREE
        for t, a in zip(channel.tangents[:-1], channel.tangents[1:], strict=True)
    )
    deviation = max(
        float(np.abs(out_handles[:, 0] - durations / 3).max(initial=0.0)),
        float(np.abs(-in_handles[:, 0] - durations / 3).max(initial=0.0)),
    )
    if not is_free or deviation > HANDLE_TOLERANCE * float(durations.max(initial=1.0)):
        return None
    third_duration = (np.diff(seconds) / 3)[:, None]
    in_slopes = np.zeros(channel.values.shape)
    out_slopes = np.zeros(channel.values.shape)
    out_slopes[:-1] = out_handles[:, 1:] / third_duration
    in_slopes[1:] = -in_handles[:, 1:] / third_duration
    return SamplerKeys(seconds, channel.values, "CUBICSPLINE", in_slopes, out_slopes)


def reduce_keys(keys: SamplerKeys, tolerance: float) -> SamplerKeys:
    """Return keys that reproduce all others within a tolerance.

    Each step adds the sample with the largest error, until none exceeds the tolerance
    (Ramer, 1972; Douglas and Peucker, 1973). For rotations the tolerance is an angle
    [rad].

    >>> line = SamplerKeys(np.arange(5.0), np.arange(5.0)[:, None])
    >>> reduce_keys(line, 1e-3).times.tolist()
    [0.0, 4.0]
    """
    times, values = keys.times, keys.values
    is_key = np.zeros(len(times), np.bool_)
    is_key[[0, -1]] = True
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        fraction = (times[inside] - times[first]) / (times[last] - times[first])
        errors = _segment_distances(
            values[first], values[last], fraction, values[inside]
        )
        worst_index = int(errors.argmax())
        if errors[worst_index] > tolerance:
            middle = first + 1 + worst_index
            is_key[middle] = True
            spans += [(first, middle), (middle, last)]
    return SamplerKeys(times[is_key], values[is_key])


def _segment_distances(
    start: FloatArray, end: FloatArray, fraction: FloatArray, values: FloatArray
) -> FloatArray:
    """Return distances ``(F,)`` of samples from the segment between two samples."""
    if values.shape[1] == 4:
        segment_values = so3.slerp(start[None], end[None], fraction)
        return so3.angle_between(segment_values, values)
    segment_values = start + fraction[:, None] * (end - start)
    return np.asarray(np.abs(values - segment_values).max(axis=1))
