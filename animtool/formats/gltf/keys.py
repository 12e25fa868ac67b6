"""A clip of a glTF as a clip of animtool, with the keys of the file."""

from __future__ import annotations

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted
from animtool.formats.gltf.animations import Interpolation, Track
from animtool.formats.gltf.animations import Path as Moved
from animtool.formats.gltf.rig import GltfRig
from animtool.formats.gltf.sampling import NEAR, Moving, Sampler
from animtool.formats.gltf.timing import Frames
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent

_PARTS = {
    Moved.TRANSLATION: "local_translation",
    Moved.ROTATION: "local_rotation",
    Moved.SCALE: "scale",
}
# A clip has no rotations by cubic splines of their numbers: keys are put between until
# arcs are this near to them [rad].
ARC_TOLERANCE = 1e-4
# Halvings of a segment between two keys.
MAX_HALVINGS = 10


def clip_of_gltf(
    name: str, made: GltfRig, moving: Sampler, frames: Frames
) -> tuple[Clip, list[Fault]]:
    """Return a clip with the keys of a glTF's, and what of it is not so.

    Args:
        name: What the clip is called.
        made: The rig.
        moving: The tracks.
        frames: When they are.
    """
    channels: list[ClipChannel] = []
    bent = added = 0
    for path, rest in moving.rest.items():
        own = {one.row: one for one in moving.moving[path]}
        usual = _usual(path, made)
        for row in range(len(rest)):
            target = _target(path, row, made)
            if row not in own:
                if np.abs(rest[row] - usual[row]).max() > 0:
                    channels.append(_still(target, rest[row], path, frames))
                continue
            channel, more = _channel(target, own[row], path, frames)
            channels.append(channel)
            bent, added = bent + (more > 0), added + more
    last = frames.first + frames.count - 1
    clip = Clip(name, frames.fps, frames.first, last, tuple(channels))
    if not bent:
        return clip, []
    message = (
        f"{counted(bent, 'rotation')} with cubic splines, which clips do not have: "
    )
    message += (
        f"{counted(added, 'key')} added between those of the file keep them within "
    )
    message += f"{np.degrees(ARC_TOLERANCE):.2g} degrees"
    return clip, [Fault("GLT118", message, severity=Severity.NOTE)]


def _usual(path: Moved, made: GltfRig) -> FloatArray:
    """Return what a rig without keys has."""
    rig = made.rig
    if path is Moved.TRANSLATION:
        return rig.rest_translations
    if path is Moved.ROTATION:
        return rig.rest_rotations
    if path is Moved.SCALE:
        return np.ones((len(rig.joints), 3))
    return np.zeros((len(rig.shapes), 1))


def _target(path: Moved, row: int, made: GltfRig) -> str:
    if path is Moved.WEIGHTS:
        return f"shape/{made.rig.shapes[row].name}"
    return f"joint/{made.rig.names[row]}.{_PARTS[path]}"


def _made(
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
        thirds = np.diff(times)[:, None] / 3
        outs[:-1] = np.concatenate([thirds, thirds * slopes[1][:-1]], axis=1)
        ins[1:] = np.concatenate([-thirds, -thirds * slopes[0][1:]], axis=1)
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


def _still(target: str, value: FloatArray, path: Moved, frames: Frames) -> ClipChannel:
    interp = Interp.SLERP if path is Moved.ROTATION else Interp.LINEAR
    times = np.array([float(frames.first)])
    return _made(target, times, value[None].copy(), interp)


def _channel(
    target: str, one: Moving, path: Moved, frames: Frames
) -> tuple[ClipChannel, int]:
    """Return the keys of a track, and how many are none of the file."""
    track = one.track
    times = key_frames(track.times, frames)
    values = track.values.astype(np.float64) * one.factor
    step = track.interpolation is Interpolation.STEP
    if path is Moved.ROTATION:
        if track.interpolation is Interpolation.CUBIC:
            return _arcs(target, track, frames)
        values = so3.align_signs(so3.normalize(values))
        interp = Interp.STEP if step else Interp.SLERP
        return _made(target, times, values, interp), 0
    if track.ins is not None and track.outs is not None:
        scale = one.factor / float(frames.fps)
        slopes = (track.ins * scale, track.outs * scale)
        return _made(target, times, values, Interp.BEZIER, slopes), 0
    return _made(target, times, values, Interp.STEP if step else Interp.LINEAR), 0


def key_frames(seconds: FloatArray, frames: Frames) -> FloatArray:
    """Return key times [frames]; those that float32 cannot tell from a frame are it."""
    exact = seconds * float(frames.fps)
    whole = np.round(exact)
    near = np.abs(whole - exact) <= NEAR * np.abs(exact)
    return np.asarray(np.where(near, whole, exact) + float(frames.start))


def _arcs(target: str, track: Track, frames: Frames) -> tuple[ClipChannel, int]:
    """Return arcs that follow a cubic rotation, the keys of the file among theirs."""
    times = [track.times]
    a, b = track.times[:-1], track.times[1:]
    for _ in range(MAX_HALVINGS):
        if not len(a):
            break
        middle = (a + b) / 2
        ends = so3.slerp(track.at(a), track.at(b), 0.5)
        quarter = so3.slerp(track.at(a), track.at(b), 0.25)
        off = np.maximum(
            so3.angle_between(ends, track.at(middle)),
            so3.angle_between(quarter, track.at(a + (b - a) / 4)),
        )
        split = off > ARC_TOLERANCE
        a, b, middle = a[split], b[split], middle[split]
        times.append(middle)
        a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
    every = np.unique(np.concatenate(times))
    values = so3.align_signs(track.at(every))
    channel = _made(target, key_frames(every, frames), values, Interp.SLERP)
    return channel, len(every) - len(track.times)
