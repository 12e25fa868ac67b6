"""Props held by hands: their motion, and how they follow the retargeted hands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import gaussian_smooth, remove_short_runs
from animtool.motion.motion import Channel, Motion
from animtool.motion.transforms import Track, Transforms, rotate_track
from animtool.retarget.transfer import Transfer

# A hand grips a prop if it moves in the prop's frame by less than this fraction of an
# arm length per second,
GRIP_SPEED = 0.25
# and is nearer to its origin than this many arm lengths.
GRIP_DISTANCE = 1.5
# A gripped prop moves farther than this fraction of an arm length.
MIN_PROP_MOTION = 0.1
# Gaussian width of smoothing before speeds are computed [s].
SMOOTHING_SECONDS = 0.03


@dataclass(frozen=True, slots=True)
class PropMotion:
    """Motion of a prop in the target's axes, in all frames."""

    track: int  # index of the track in the take
    positions: FloatArray  # (F, 3) [m]
    rotations: FloatArray  # (F, 4)

    def find_gripped_frames(
        self, wrist: FloatArray, arm_length: float, fps: float
    ) -> BoolArray:
        """Return a mask of the frames in which a hand grips the prop ``(F,)``.

        ``wrist`` ``(F, 3)`` is that of the source, and ``arm_length`` the length of its
        arm, both [m].
        """
        if len(wrist) < 3 or arm_length <= 0:
            return np.zeros(len(wrist), np.bool_)
        relative_path = self.in_prop_frame(wrist)
        smooth_path = gaussian_smooth(relative_path, SMOOTHING_SECONDS * fps)
        speed = np.gradient(smooth_path, axis=0) * fps
        is_steady = np.linalg.norm(speed, axis=1) < GRIP_SPEED * arm_length
        is_near = np.linalg.norm(relative_path, axis=1) < GRIP_DISTANCE * arm_length
        is_gripped = remove_short_runs(is_steady & is_near, fps)
        for start, end in runs(is_gripped):
            if (
                np.ptp(self.positions[start:end], axis=0).max()
                < MIN_PROP_MOTION * arm_length
            ):
                is_gripped[start:end] = False
        return is_gripped

    def in_prop_frame(self, points: FloatArray) -> FloatArray:
        """Transform world points into the prop's frame ``(F, 3)`` [m]."""
        return so3.rotate(so3.conjugate(self.rotations), points - self.positions)


class PropTracks:
    """The prop tracks of a take, and the track times of its frames."""

    def __init__(self, tracks: Sequence[Track]) -> None:
        self.tracks = tuple(tracks)
        self._times: list[Channel] = []

    def record_times(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        """Yield the blocks, and record their track times."""
        for block in blocks:
            assert block.track_times is not None
            self._times.append(block.track_times)
            yield block

    def moving_props(self, transfer: Transfer) -> list[PropMotion]:
        """Return the motion of props that move; call it after all frames were read."""
        times = Channel.concatenate(self._times).dense()[..., 0]
        motions = []
        for i, track in enumerate(self.tracks):
            if track.has_transform and track.is_animated:
                upright_track = rotate_track(track, transfer.up_rotation)
                at_frames = upright_track.at(times[:, i])
                motion = PropMotion(i, at_frames.translations, at_frames.rotations)
                motions.append(motion)
        return motions

    def rescale_gripped(
        self, gripped_tracks: set[int], transfer: Transfer, ground_offset: FloatArray
    ) -> tuple[Track, ...]:
        """Return the tracks, with gripped props scaled to follow the target.

        ``gripped_tracks`` are indices of tracks; ``ground_offset`` is that of the
        target's ground ``(3,)`` [m].
        """
        tracks = list(self.tracks)
        for i in gripped_tracks:
            upright_track = rotate_track(tracks[i], transfer.up_rotation)
            tracks[i] = _scale_track(upright_track, transfer.scale, ground_offset)
        return tuple(tracks)


def _scale_track(track: Track, scale: float, ground_offset: FloatArray) -> Track:
    """Scale and shift the path of a track; the size of the prop stays unchanged."""

    def sample(times: FloatArray) -> Transforms:
        """Return the transforms at the times, positions scaled and shifted."""
        transforms = track.sample(times)
        matrices = transforms.matrices
        if matrices is not None:
            matrices = matrices.copy()
            matrices[:, :3, 3] = scale * matrices[:, :3, 3] + ground_offset
        translations = scale * transforms.translations + ground_offset
        return replace(transforms, translations=translations, matrices=matrices)

    return replace(track, sample=sample)
