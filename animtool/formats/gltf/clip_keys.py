"""Converts a glTF animation to a clip with the file's keys."""

from __future__ import annotations

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted
from animtool.formats.gltf.animation_targets import TargetPath
from animtool.formats.gltf.animations import GltfTrack, SamplerInterpolation
from animtool.formats.gltf.rig import GltfRig
from animtool.formats.gltf.sampling import KEY_TIME_TOLERANCE, GltfSampler, RigTrack
from animtool.formats.gltf.timing import GltfFrames
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent

_PARTS_BY_PATH = {
    TargetPath.TRANSLATION: "local_translation",
    TargetPath.ROTATION: "local_rotation",
    TargetPath.SCALE: "scale",
}
# Clips cannot store cubic splines of quaternions: slerp keys are added until the error
# is below this [rad].
SLERP_TOLERANCE = 1e-4
# Maximum number of times a segment between keys is halved.
MAX_HALVINGS = 10


def build_clip(
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
    spline_count = added_key_count = 0
    for path, rest_values in sampler.rest_values.items():
        track_by_row = {rig_track.row: rig_track for rig_track in sampler.tracks[path]}
        default_values = _default_channel_values(path, gltf_rig)
        for row in range(len(rest_values)):
            target = _clip_target(path, row, gltf_rig)
            if row not in track_by_row:
                if np.abs(rest_values[row] - default_values[row]).max() > 0:
                    channels.append(
                        _static_channel(target, rest_values[row], path, frames)
                    )
                continue
            channel, channel_key_count = _track_channel(
                target, track_by_row[row], path, frames
            )
            channels.append(channel)
            spline_count = spline_count + (channel_key_count > 0)
            added_key_count = added_key_count + channel_key_count
    last_frame = frames.first_frame + frames.count - 1
    clip = Clip(name, frames.fps, frames.first_frame, last_frame, tuple(channels))
    if not spline_count:
        return clip, []
    message = (
        f"{counted(spline_count, 'rotation')} with cubic splines, which clips do not "
        f"have: {counted(added_key_count, 'key')} added between those of the file keep "
        f"them within {np.degrees(SLERP_TOLERANCE):.2g} degrees"
    )
    return clip, [Fault("GLT118", message, severity=Severity.NOTE)]


def _default_channel_values(path: TargetPath, gltf_rig: GltfRig) -> FloatArray:
    """Return the value of each joint or shape if no channel sets it ``(N, W)``."""
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
    return f"joint/{gltf_rig.rig.names[row]}.{_PARTS_BY_PATH[path]}"


def _clip_channel(
    target: str,
    times: FloatArray,
    values: FloatArray,
    interp: Interp,
    slopes: tuple[FloatArray, FloatArray] | None = None,
) -> ClipChannel:
    """Return a channel; slopes [1/frame] become handles at thirds of segments."""
    key_count, width = values.shape
    in_handles, out_handles = (
        np.zeros((key_count, 1 + width)),
        np.zeros((key_count, 1 + width)),
    )
    tangent = Tangent.AUTO_CLAMPED
    if slopes is not None:
        tangent = Tangent.FREE
        handle_times = np.diff(times)[:, None] / 3
        out_handles[:-1] = np.concatenate(
            [handle_times, handle_times * slopes[1][:-1]], axis=1
        )
        in_handles[1:] = np.concatenate(
            [-handle_times, -handle_times * slopes[0][1:]], axis=1
        )
    return ClipChannel(
        target,
        times,
        values,
        (interp,) * key_count,
        ((tangent, tangent),) * key_count,
        in_handles,
        out_handles,
        np.zeros((key_count, 3)),
    )


def _static_channel(
    target: str, value: FloatArray, path: TargetPath, frames: GltfFrames
) -> ClipChannel:
    interp = Interp.SLERP if path is TargetPath.ROTATION else Interp.LINEAR
    times = np.array([float(frames.first_frame)])
    return _clip_channel(target, times, value[None].copy(), interp)


def _track_channel(
    target: str, rig_track: RigTrack, path: TargetPath, frames: GltfFrames
) -> tuple[ClipChannel, int]:
    """Return the clip channel of a track, and the number of keys added to it."""
    track = rig_track.track
    times = key_times_in_frames(track.times, frames)
    values = track.values.astype(np.float64) * rig_track.factor
    is_stepped = track.interpolation is SamplerInterpolation.STEP
    if path is TargetPath.ROTATION:
        if track.interpolation is SamplerInterpolation.CUBIC:
            return _slerp_channel(target, track, frames)
        values = so3.align_signs(so3.normalize(values))
        interp = Interp.STEP if is_stepped else Interp.SLERP
        return _clip_channel(target, times, values, interp), 0
    if track.in_slopes is not None and track.out_slopes is not None:
        slope_factor = rig_track.factor / float(frames.fps)
        slopes = (track.in_slopes * slope_factor, track.out_slopes * slope_factor)
        return _clip_channel(target, times, values, Interp.BEZIER, slopes), 0
    return _clip_channel(
        target, times, values, Interp.STEP if is_stepped else Interp.LINEAR
    ), 0


def key_times_in_frames(seconds: FloatArray, frames: GltfFrames) -> FloatArray:
    """Return key times [frames], snapped to a frame within float32 rounding."""
    frame_numbers = seconds * float(frames.fps)
    nearest_frames = np.round(frame_numbers)
    is_on_frame = np.abs(nearest_frames - frame_numbers) <= KEY_TIME_TOLERANCE * np.abs(
        frame_numbers
    )
    return np.asarray(
        np.where(is_on_frame, nearest_frames, frame_numbers) + float(frames.start)
    )


def _slerp_channel(
    target: str, track: GltfTrack, frames: GltfFrames
) -> tuple[ClipChannel, int]:
    """Return a cubic rotation as slerp keys, and the number of added keys."""
    time_arrays = [track.times]
    start_times, end_times = track.times[:-1], track.times[1:]
    for _ in range(MAX_HALVINGS):
        if not len(start_times):
            break
        middles = (start_times + end_times) / 2
        middle_values = so3.slerp(
            track.sample(start_times), track.sample(end_times), 0.5
        )
        quarter_values = so3.slerp(
            track.sample(start_times), track.sample(end_times), 0.25
        )
        errors = np.maximum(
            so3.angle_between(middle_values, track.sample(middles)),
            so3.angle_between(
                quarter_values,
                track.sample(start_times + (end_times - start_times) / 4),
            ),
        )
        needs_split = errors > SLERP_TOLERANCE
        start_times = start_times[needs_split]
        end_times = end_times[needs_split]
        middles = middles[needs_split]
        time_arrays.append(middles)
        start_times = np.concatenate([start_times, middles])
        end_times = np.concatenate([middles, end_times])
    all_times = np.unique(np.concatenate(time_arrays))
    values = so3.align_signs(track.sample(all_times))
    channel = _clip_channel(
        target, key_times_in_frames(all_times, frames), values, Interp.SLERP
    )
    return channel, len(all_times) - len(track.times)
