"""A glTF animation as a clip, with the file's keys."""

from __future__ import annotations

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import GltfTrack, SamplerInterpolation
from animtool.formats.gltf.rig import GltfRig
from animtool.formats.gltf.sampling import KEY_TIME_TOLERANCE, AnimatedRow, GltfSampler
from animtool.formats.gltf.timing import GltfFrames
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent

_CHANNEL_PARTS = {
    TargetPath.TRANSLATION: "local_translation",
    TargetPath.ROTATION: "local_rotation",
    TargetPath.SCALE: "scale",
}
# Clips cannot store cubic splines of quaternions: slerp keys are added until the error
# is below this [rad].
ARC_TOLERANCE = 1e-4
# Maximum number of times a segment between keys is halved.
MAX_ARC_HALVINGS = 10


def clip_of_gltf(
    name: str, gltf_rig: GltfRig, sampler: GltfSampler, frames: GltfFrames
) -> tuple[Clip, list[Fault]]:
    """Return a clip with a glTF animation's keys, and notices.

    Args:
        name: Name of the clip.
        gltf_rig: The rig.
        sampler: The animation.
        frames: Frames of the animation.
    """
    channels: list[ClipChannel] = []
    splines = added = 0
    for path, rest in sampler.rest.items():
        tracks = {entry.row: entry for entry in sampler.tracks[path]}
        defaults = _default_rows(path, gltf_rig)
        for row in range(len(rest)):
            target = _clip_target(path, row, gltf_rig)
            if row not in tracks:
                if np.abs(rest[row] - defaults[row]).max() > 0:
                    channels.append(_static_channel(target, rest[row], path, frames))
                continue
            channel, extra_keys = _track_channel(target, tracks[row], path, frames)
            channels.append(channel)
            splines, added = (
                splines + (extra_keys > 0),
                added + extra_keys,
            )
    last_frame = frames.first + frames.count - 1
    clip = Clip(name, frames.fps, frames.first, last_frame, tuple(channels))
    if not splines:
        return clip, []
    message = (
        f"{counted(splines, 'rotation')} with cubic splines, which clips do not have: "
    )
    message += (
        f"{counted(added, 'key')} added between those of the file keep them within "
    )
    message += f"{np.degrees(ARC_TOLERANCE):.2g} degrees"
    return clip, [Fault("GLT118", message, severity=Severity.NOTE)]


def _default_rows(path: TargetPath, gltf_rig: GltfRig) -> FloatArray:
    """Return the values of a rig's channels without keys."""
    rig = gltf_rig.rig
    if path is TargetPath.TRANSLATION:
        return rig.rest_translations
    if path is TargetPath.ROTATION:
        return rig.rest_rotations
    if path is TargetPath.SCALE:
        return np.ones((len(rig.joints), 3))
    return np.zeros((len(rig.shapes), 1))


def _clip_target(path: TargetPath, row: int, gltf_rig: GltfRig) -> str:
    if path is TargetPath.WEIGHTS:
        return f"shape/{gltf_rig.rig.shapes[row].name}"
    return f"joint/{gltf_rig.rig.names[row]}.{_CHANNEL_PARTS[path]}"


def _clip_channel(
    target: str,
    times: FloatArray,
    values: FloatArray,
    interp: Interp,
    slopes: tuple[FloatArray, FloatArray] | None = None,
) -> ClipChannel:
    """Return a channel; slopes [1/frame] become handles at thirds."""
    keys, width = values.shape
    ins, outs = np.zeros((keys, 1 + width)), np.zeros((keys, 1 + width))
    tangent = Tangent.AUTO_CLAMPED
    if slopes is not None:
        tangent = Tangent.FREE
        handle_times = np.diff(times)[:, None] / 3
        outs[:-1] = np.concatenate(
            [handle_times, handle_times * slopes[1][:-1]], axis=1
        )
        ins[1:] = np.concatenate([-handle_times, -handle_times * slopes[0][1:]], axis=1)
    return ClipChannel(
        target,
        times,
        values,
        (interp,) * keys,
        ((tangent, tangent),) * keys,
        ins,
        outs,
        np.zeros((keys, 3)),
    )


def _static_channel(
    target: str, value: FloatArray, path: TargetPath, frames: GltfFrames
) -> ClipChannel:
    interp = Interp.SLERP if path is TargetPath.ROTATION else Interp.LINEAR
    times = np.array([float(frames.first)])
    return _clip_channel(target, times, value[None].copy(), interp)


def _track_channel(
    target: str, row_track: AnimatedRow, path: TargetPath, frames: GltfFrames
) -> tuple[ClipChannel, int]:
    """Return the keys of a track, and the count of keys not in the file."""
    track = row_track.track
    times = key_frames(track.times, frames)
    values = track.values.astype(np.float64) * row_track.factor
    step = track.interpolation is SamplerInterpolation.STEP
    if path is TargetPath.ROTATION:
        if track.interpolation is SamplerInterpolation.CUBIC:
            return _slerp_keys(target, track, frames)
        values = so3.align_signs(so3.normalize(values))
        interp = Interp.STEP if step else Interp.SLERP
        return _clip_channel(target, times, values, interp), 0
    if track.ins is not None and track.outs is not None:
        scale = row_track.factor / float(frames.fps)
        slopes = (track.ins * scale, track.outs * scale)
        return _clip_channel(target, times, values, Interp.BEZIER, slopes), 0
    return _clip_channel(
        target, times, values, Interp.STEP if step else Interp.LINEAR
    ), 0


def key_frames(seconds: FloatArray, frames: GltfFrames) -> FloatArray:
    """Return key times [frames], snapped to a frame within float32 rounding."""
    exact = seconds * float(frames.fps)
    frames_ = np.round(exact)
    is_on_frame = np.abs(frames_ - exact) <= KEY_TIME_TOLERANCE * np.abs(exact)
    return np.asarray(np.where(is_on_frame, frames_, exact) + float(frames.start))


def _slerp_keys(
    target: str, track: GltfTrack, frames: GltfFrames
) -> tuple[ClipChannel, int]:
    """Return slerp keys that approximate a cubic rotation, file keys included."""
    times = [track.times]
    a, b = track.times[:-1], track.times[1:]
    for _ in range(MAX_ARC_HALVINGS):
        if not len(a):
            break
        middle = (a + b) / 2
        ends_slerp = so3.slerp(track.at(a), track.at(b), 0.5)
        quarter_slerp = so3.slerp(track.at(a), track.at(b), 0.25)
        error = np.maximum(
            so3.angle_between(ends_slerp, track.at(middle)),
            so3.angle_between(quarter_slerp, track.at(a + (b - a) / 4)),
        )
        needs_split = error > ARC_TOLERANCE
        a, b, middle = a[needs_split], b[needs_split], middle[needs_split]
        times.append(middle)
        a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
    all_times = np.unique(np.concatenate(times))
    values = so3.align_signs(track.at(all_times))
    channel = _clip_channel(target, key_frames(all_times, frames), values, Interp.SLERP)
    return channel, len(all_times) - len(track.times)
