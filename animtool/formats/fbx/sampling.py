"""FBX takes sampled as rig motion at any times."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import MAX_FRAMES, Clock
from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.formats.characters.stream import sampled_stream
from animtool.formats.fbx.layers import PERCENT, PropertyTrack
from animtool.formats.fbx.poses import Changes, NodeTransforms
from animtool.formats.fbx.rig import FbxRig
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.settings import TICKS
from animtool.formats.fbx.takes import AnimTake
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import forward

# Frames per block: 60 joints take 2 MB.
BLOCK = 1024
# What a take is held with: numbers that change, of all frames.
MAX_VALUES = 60_000_000
# A frame takes time however few of its numbers change.
MIN_VALUES = 40
MAX_TICKS = 2.0**61
# A key is on a frame that is nearer than this [frame].
ON_FRAME = 1e-3
# Keys between frames at which joints are measured.
MAX_MEASURED = 256


@dataclass(frozen=True, slots=True)
class FbxFrames:
    """The frame range and rate of a take: frame 0 is at time 0."""

    fps: Fraction
    first: int
    count: int

    def ticks(self, codes: FloatArray) -> IntArray:
        """Return times of frame numbers [ticks]."""
        # One product of two floats: a frame is exact as long as its tick is.
        per_frame = float(Fraction(TICKS) / self.fps)
        return np.rint(np.clip(codes * per_frame, -MAX_TICKS, MAX_TICKS)).astype(
            np.int64
        )


class FbxSampler:
    """Sampler of a take's rig motion at any times."""

    def __init__(self, scene: FbxScene, fbx_rig: FbxRig, take: AnimTake | None) -> None:
        """Sample a rig by a take; None leaves it as saved."""
        self.scene, self.fbx_rig, self.take = scene, fbx_rig, take
        changes = Changes(scene.models, take)
        flags = np.array([changes.row(row) for row in fbx_rig.rows]).reshape(-1, 3)
        flags[:, 2] &= ~fbx_rig.even
        self.moving = [np.flatnonzero(flags[:, k]) for k in range(3)]
        rows = range(len(fbx_rig.shapes))
        self.shapes = np.array([row for row in rows if self._moves(row)], np.int64)
        begin = 0 if take is None else take.begin
        self.rest = self._rest(np.array([begin], np.int64))
        self.is_scaled = bool(len(self.moving[2]) or (self.rest[2] != 1.0).any())

    @property
    def numbers(self) -> int:
        """Count of animated numbers per frame."""
        moves, rotations, scales = (len(one) for one in self.moving)
        return 3 * moves + 4 * rotations + 3 * scales + len(self.shapes)

    def track(self, row: int) -> PropertyTrack | None:
        """Return the track of a shape's weight; None if not animated."""
        channel = self.fbx_rig.shapes[row][0]
        take = self.take
        return None if take is None else take.tracks.get((channel.id, PERCENT))

    def _moves(self, row: int) -> bool:
        track = self.track(row)
        base = np.array([self.fbx_rig.shapes[row][0].percent])
        return track is not None and track.constant(base) is None

    def weight(self, row: int, ticks: IntArray) -> FloatArray:
        """Return the weight of a shape at times ``(F,)`` [1]."""
        channel, full = self.fbx_rig.shapes[row]
        base, track = np.array([channel.percent]), self.track(row)
        if track is None:
            return np.full(len(ticks), channel.percent / full)
        return np.asarray(track.at(base, ticks)[:, 0] / full)

    def _rest(self, ticks: IntArray) -> list[FloatArray]:
        """Return the static values of each channel."""
        fbx_rig, count = self.fbx_rig, len(self.fbx_rig.rig.joints)
        state = NodeTransforms(self.scene, self.take, ticks)
        moved, turned = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        scaled = np.ones((count, 3))
        for j, row in enumerate(fbx_rig.rows):
            local = state.row(row)
            moved[j], turned[j] = local[0][0] * fbx_rig.factors[j], local[1][0]
            scaled[j] = 1.0 if fbx_rig.even[j] else local[2][0]
        weights = [self.weight(row, ticks)[0] for row in range(len(fbx_rig.shapes))]
        return [moved, turned, scaled, np.array(weights).reshape(-1, 1)]

    def at(self, ticks: IntArray) -> Motion:
        """Return the motion at times ``(F,)`` [ticks]."""
        fbx_rig = self.fbx_rig
        state = NodeTransforms(self.scene, self.take, ticks)
        values = [
            np.zeros((len(ticks), len(joints), w))
            for joints, w in zip(self.moving, (3, 4, 3), strict=True)
        ]
        for part, joints in enumerate(self.moving):
            for k, j in enumerate(joints.tolist()):
                samples = state.row(fbx_rig.rows[j])[part]
                if part == 0:
                    samples = samples * fbx_rig.factors[j]
                elif part == 1:
                    samples = so3.align_signs(samples)
                values[part][:, k] = samples
        channels = [
            Channel(self.rest[part], joints, values[part])
            for part, joints in enumerate(self.moving)
        ]
        weights = None
        if fbx_rig.shapes:
            rows = [self.weight(row, ticks) for row in self.shapes.tolist()]
            shown = np.stack(rows, axis=1) if rows else np.zeros((len(ticks), 0))
            weights = Channel(self.rest[3], self.shapes, shown[:, :, None])
        scales = channels[2] if self.is_scaled else None
        return Motion(channels[0], channels[1], scales, weights)


def frames_of(
    scene: FbxScene, take: AnimTake | None, fps: Fraction | None, width: int
) -> FbxFrames:
    """Return the frame range of a take: its span, else that of its keys.

    Args:
        scene: The file.
        take: The take; None is one frame.
        fps: The rate that is asked for; None is the file's.
        width: Numbers of a frame.

    Raises:
        FormatError: It has more frames than are read (FBX013).
    """
    rate = fps or scene.settings.fps
    if take is None:
        return FbxFrames(rate, 0, 1)
    keys = take.key_times()
    begin, end = take.begin, take.end
    if end <= begin and len(keys):
        begin, end = int(keys[0]), int(keys[-1])
    # From the frame at or before the beginning to that at or after the end.
    first = _nearest(begin, rate)
    first -= _is_off(begin, rate) and first * TICKS > begin * rate
    last = _nearest(end, rate)
    last += _is_off(end, rate) and last * TICKS < end * rate
    last = max(first, last)
    count = last - first + 1
    if count > MAX_FRAMES or count * max(width, MIN_VALUES) > MAX_VALUES:
        message = f"take {take.name!r}: {(end - begin) / TICKS:.6g} s at "
        message += f"{rate_label(rate)} are {count} frames of {width} numbers, above "
        message += "the limit"
        hint = f"lower the rate with {argument('source.fps')}"
        raise FormatError(
            Fault("FBX013", message, str(scene.path), (), hint, where=take.where)
        )
    return FbxFrames(rate, first, count)


def between_notices(
    scene: FbxScene, fbx_rig: FbxRig, moving: FbxSampler, frames: FbxFrames
) -> list[Fault]:
    """Return a notice of joint errors where keys are between frames."""
    take = moving.take
    keys = np.zeros(0, np.int64) if take is None else take.key_times()
    if take is None or not len(keys):
        return []
    codes = keys / float(Fraction(TICKS) / frames.fps)
    off = np.flatnonzero(np.abs(codes - np.round(codes)) > ON_FRAME)
    if not len(off):
        return []
    shown = off[:: max(1, len(off) // MAX_MEASURED)]
    low = np.floor(codes[shown])
    positions = [
        forward(fbx_rig.rig, *moving.at(ticks).dense()).positions
        for ticks in (frames.ticks(low), frames.ticks(low + 1.0), keys[shown])
    ]
    fraction = (codes[shown] - low)[:, None, None]
    straight = positions[0] + fraction * (positions[1] - positions[0])
    distances = np.linalg.norm(positions[2] - straight, axis=2)
    worst = int(distances.max(axis=0).argmax())
    message = f"{len(off)} of {len(keys)} key times fall between the frames at "
    message += (
        f"{rate_label(frames.fps)}: joints are up to {distances.max() * 1e3:.3g} mm "
    )
    message += f"off there (joint {fbx_rig.rig.names[worst]!r})"
    hint = f"set another rate with {argument('source.fps')}"
    path = str(scene.path)
    return [Fault("FBX110", message, path, (), hint, Severity.NOTE, where=take.where)]


def _nearest(ticks: int, rate: Fraction) -> int:
    return round(ticks * rate / TICKS)


def _is_off(ticks: int, rate: Fraction) -> bool:
    frames = ticks * rate / TICKS
    return abs(frames - round(frames)) > Fraction(1, 1000)


def take_stream(fbx_rig: FbxRig, moving: FbxSampler, frames: FbxFrames) -> TakeStream:
    """Return a take as a stream, sampled block by block."""
    clock = Clock(frames.fps, Fraction(frames.first), Fraction(1), frames.count)

    def sample(codes: FloatArray) -> Motion:
        return moving.at(frames.ticks(codes))

    return sampled_stream(fbx_rig.rig, clock, sample, BLOCK)


def moves(fbx_rig: FbxRig, take: AnimTake, scene: FbxScene) -> bool:
    """Return whether a take animates the rig."""
    ids = {scene.models[row.model].object.id for row in fbx_rig.rows}
    ids |= {channel.id for channel, _ in fbx_rig.shapes}
    return any(of in ids for of, _ in take.tracks)
