"""Keys of clips converted to glTF samplers, and the reverse."""

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
# Clip channels that add to one with the complete value.
_ADDITIVE_PARTS = {
    "translation": "translation",
    "slide": "translation",
    "rotation": "rotation",
    "angle": "rotation",
}


@dataclass(frozen=True, slots=True, eq=False)
class Keys:
    """Keys of a property as a sampler stores them."""

    times: FloatArray  # ``(K,)`` [s]
    values: FloatArray  # ``(K, W)``
    interpolation: str = "LINEAR"
    ins: FloatArray | None = None  # slopes into the keys ``(K, W)`` [1/s]
    outs: FloatArray | None = None  # slopes out of them

    def rows(self, *, scalars: bool = False) -> FloatArray:
        """Return accessor rows; weights are one scalar per row."""
        values = self.values
        if self.ins is not None and self.outs is not None:
            values = np.stack([self.ins, self.values, self.outs], axis=1)
        width = self.values.shape[1]
        flat = values.reshape(-1, width)
        return flat.reshape(-1, 1) if scalars else flat


def keys_of_clip(
    clip: Clip, take: Take, start: Fraction
) -> dict[tuple[int, str], Keys]:
    """Return clip keys that glTF can store, by row and path.

    Args:
        clip: The clip.
        take: The take sampled from the clip.
        start: Time code of time 0.
    """
    all_keys: dict[tuple[int, str], Keys] = {}
    has_additive: set[tuple[int, str]] = set()
    shapes = [shape.name for shape in take.rig.shapes]
    for channel in clip.channels:
        group, _, name = channel.target.partition("/")
        if group == "shape":
            at = (shapes.index(name), "weight")
        elif group == "joint":
            joint, part = split_part(name, KEYED_PARTS)
            if part in _ADDITIVE_PARTS:
                has_additive.add((take.rig.index(joint), _ADDITIVE_PARTS[part]))
            if part not in _PATHS_BY_PART:
                continue
            at = (take.rig.index(joint), _PATHS_BY_PART[part])
        else:
            continue
        keys = _gltf_keys(channel, clip, start)
        if keys is not None:
            all_keys[at] = keys
    return {at: keys for at, keys in all_keys.items() if at not in has_additive}


_NATIVE_PARTS = {
    TargetPath.TRANSLATION: "translation",
    TargetPath.ROTATION: "rotation",
    TargetPath.SCALE: "scale",
    TargetPath.WEIGHTS: "weight",
}


def native_keys(native: NativeKeys, start: Fraction) -> dict[tuple[int, str], Keys]:
    """Return the unchanged keys of a glTF source.

    Rotations are normalized, except those of cubic splines, which would change.

    ``start`` is the time code of time 0.
    """
    frames = native.frames
    later = float(frames.start - start) / float(frames.fps)
    all_keys: dict[tuple[int, str], Keys] = {}
    times: dict[int, FloatArray] = {}
    for path, tracks in native.sampler.tracks.items():
        for row in tracks:
            track = row.track
            key_times = times.setdefault(id(track.times), track.times + later)
            if key_times[0] < 0:
                continue
            slopes = [
                None if slope is None else slope * row.factor
                for slope in (track.ins, track.outs)
            ]
            values = track.values
            if row.factor != 1.0:
                values = values * row.factor
            interpolation = str(track.interpolation)
            if path is TargetPath.ROTATION and slopes[0] is None:
                values = so3.normalize(values)
            all_keys[row.row, _NATIVE_PARTS[path]] = Keys(
                key_times, values, interpolation, *slopes
            )
    return all_keys


def _gltf_keys(channel: ClipChannel, clip: Clip, start: Fraction) -> Keys | None:
    """Return the keys of a channel; None if glTF has no equivalent curve."""
    constant = {Extrapolation.HOLD}
    if (
        {channel.pre, channel.post} - constant
        or channel.euler
        or not len(channel.times)
    ):
        return None
    seconds = (channel.times - float(start)) / float(clip.fps)
    if seconds[0] < 0:
        return None
    interps = set(channel.interps[:-1]) or {Interp.LINEAR}
    linear = Interp.SLERP if channel.values.shape[1] == 4 else Interp.LINEAR
    if interps == {linear}:
        return Keys(seconds, channel.values)
    if interps == {Interp.STEP}:
        return Keys(seconds, channel.values, "STEP")
    if interps == {Interp.BEZIER} and channel.values.shape[1] != 4:
        return _cubic_keys(channel, seconds)
    return None


def _cubic_keys(channel: ClipChannel, seconds: FloatArray) -> Keys | None:
    """Return Bézier keys with handles at thirds as cubic splines."""
    lengths = np.diff(channel.times)
    outs, ins = channel.outs[:-1], channel.ins[1:]
    is_free = all(
        a[1] is Tangent.FREE and b[0] is Tangent.FREE
        for a, b in zip(channel.tangents[:-1], channel.tangents[1:], strict=True)
    )
    deviation = max(
        float(np.abs(outs[:, 0] - lengths / 3).max(initial=0.0)),
        float(np.abs(-ins[:, 0] - lengths / 3).max(initial=0.0)),
    )
    if not is_free or deviation > HANDLE_TOLERANCE * float(lengths.max(initial=1.0)):
        return None
    third = (np.diff(seconds) / 3)[:, None]
    in_slopes, out_slopes = (
        np.zeros(channel.values.shape),
        np.zeros(channel.values.shape),
    )
    out_slopes[:-1] = outs[:, 1:] / third
    in_slopes[1:] = -ins[:, 1:] / third
    return Keys(seconds, channel.values, "CUBICSPLINE", in_slopes, out_slopes)
