"""Samples FBX takes as rig motion at arbitrary times."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import MAX_FRAME_COUNT, Clock
from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.rates import rate_label
from animtool.formats.characters.stream import build_sampled_stream
from animtool.formats.fbx.curves import MAX_TICKS
from animtool.formats.fbx.layers import DEFORM_PERCENT, PropertyTrack
from animtool.formats.fbx.poses import AnimatedComponents, NodeTransforms
from animtool.formats.fbx.rig import FbxRig
from animtool.formats.fbx.scene import FbxScene
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.fbx.takes import AnimTake, find_track
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import forward_kinematics

# Frames per block; with 60 joints a block has 2 MB.
BLOCK_FRAMES = 1024
# Limit of a take's animated numbers over all frames.
MAX_TAKE_VALUES = 60_000_000
# Minimum values counted per frame, as each frame takes time even with few values.
MIN_VALUES_PER_FRAME = 40
# Tolerance of keys on a frame [frame].
FRAME_TOLERANCE = 1e-3
# Maximum keys between frames at which joint errors are measured.
MAX_MEASURED_KEYS = 256


def clock_ticks(clock: Clock, frame_numbers: FloatArray) -> IntArray:
    """Return the times of frame numbers [ticks]; frame 0 is at time 0."""
    # One product of two floats keeps frames as exact as their ticks.
    ticks_per_frame = float(Fraction(TICKS_PER_SECOND) / clock.fps)
    ticks = np.clip(frame_numbers * ticks_per_frame, -MAX_TICKS, MAX_TICKS)
    return np.rint(ticks).astype(np.int64)


class FbxSampler:
    """Samples a take's motion on a rig at arbitrary times."""

    def __init__(self, scene: FbxScene, fbx_rig: FbxRig, take: AnimTake | None) -> None:
        """Prepare to sample a take on a rig, or the saved pose if there is no take."""
        self.scene, self.fbx_rig, self.take = scene, fbx_rig, take
        finder = AnimatedComponents(scene.models, take)
        is_animated = np.array(
            [finder.animated_components(source) for source in fbx_rig.joint_sources]
        ).reshape(-1, 3)
        is_animated[:, 2] &= ~fbx_rig.is_baked
        self.animated_joints = [np.flatnonzero(is_animated[:, k]) for k in range(3)]
        shape_indices = range(len(fbx_rig.shape_channels))
        self.animated_shapes = np.array(
            [shape for shape in shape_indices if self._is_animated(shape)], np.int64
        )
        start_time = 0 if take is None else take.start_ticks
        self.rest_values = self._static_values(np.array([start_time], np.int64))
        self.is_scaled = bool(
            len(self.animated_joints[2]) or (self.rest_values[2] != 1.0).any()
        )

    @property
    def values_per_frame(self) -> int:
        """Number of animated values per frame."""
        translations, rotations, scales = (len(j) for j in self.animated_joints)
        return 3 * translations + 4 * rotations + 3 * scales + len(self.animated_shapes)

    def weight_track(self, shape_index: int) -> PropertyTrack | None:
        """Return the track of a shape's weight; None if not animated."""
        channel = self.fbx_rig.shape_channels[shape_index][0]
        return find_track(self.take, channel.id, DEFORM_PERCENT)

    def _is_animated(self, shape_index: int) -> bool:
        track = self.weight_track(shape_index)
        return track is not None and not track.is_static()

    def weight(self, shape_index: int, ticks: IntArray) -> FloatArray:
        """Return the weight of a shape at times ``(F,)`` [1]."""
        channel, full_percent = self.fbx_rig.shape_channels[shape_index]
        base, track = np.array([channel.percent]), self.weight_track(shape_index)
        if track is None:
            return np.full(len(ticks), channel.percent / full_percent)
        return np.asarray(track.evaluate(base, ticks)[:, 0] / full_percent)

    def _static_values(self, ticks: IntArray) -> list[FloatArray]:
        """Return translations, rotations, scales and weights at the first time."""
        fbx_rig, joint_count = self.fbx_rig, len(self.fbx_rig.rig.joints)
        transforms = NodeTransforms(self.scene, self.take, ticks)
        translations = np.zeros((joint_count, 3))
        rotations = np.tile([0.0, 0.0, 0.0, 1.0], (joint_count, 1))
        scales = np.ones((joint_count, 3))
        for j, source in enumerate(fbx_rig.joint_sources):
            local = transforms.joint_transforms(source)
            translations[j] = local[0][0] * fbx_rig.translation_factors[j]
            rotations[j] = local[1][0]
            scales[j] = 1.0 if fbx_rig.is_baked[j] else local[2][0]
        weights = [self.weight(r, ticks)[0] for r in range(len(fbx_rig.shape_channels))]
        return [translations, rotations, scales, np.array(weights).reshape(-1, 1)]

    def sample(self, ticks: IntArray) -> Motion:
        """Return the motion at times ``(F,)`` [ticks]."""
        fbx_rig = self.fbx_rig
        transforms = NodeTransforms(self.scene, self.take, ticks)
        values = [
            np.zeros((len(ticks), len(j), c))
            for j, c in zip(self.animated_joints, (3, 4, 3), strict=True)
        ]
        for component, joints in enumerate(self.animated_joints):
            for column, j in enumerate(joints.tolist()):
                samples = transforms.joint_transforms(fbx_rig.joint_sources[j])[
                    component
                ]
                if component == 0:
                    samples = samples * fbx_rig.translation_factors[j]
                elif component == 1:
                    samples = so3.align_signs(samples)
                values[component][:, column] = samples
        channels = [
            Channel(self.rest_values[component], joints, values[component])
            for component, joints in enumerate(self.animated_joints)
        ]
        weights = None
        if fbx_rig.shape_channels:
            shape_weights = np.zeros((len(ticks), len(self.animated_shapes), 1))
            for column, shape_index in enumerate(self.animated_shapes.tolist()):
                shape_weights[:, column, 0] = self.weight(shape_index, ticks)
            weights = Channel(self.rest_values[3], self.animated_shapes, shape_weights)
        scales = channels[2] if self.is_scaled else None
        return Motion(channels[0], channels[1], scales, weights)


def find_frame_range(
    scene: FbxScene,
    take: AnimTake | None,
    requested_rate: Fraction | None,
    values_per_frame: int,
) -> Clock:
    """Return the stated frame range of a take, else that of its keys.

    Args:
        scene: The file.
        take: The take; None is one frame.
        requested_rate: Requested frame rate; None is the file's.
        values_per_frame: Animated numbers per frame.
    """
    rate = requested_rate or scene.settings.fps
    if take is None:
        return Clock(rate, Fraction(0), Fraction(1), 1)
    key_ticks = take.key_times()
    start_ticks, end_ticks = take.start_ticks, take.end_ticks
    if end_ticks <= start_ticks and len(key_ticks):
        start_ticks, end_ticks = int(key_ticks[0]), int(key_ticks[-1])
    # Frames contain the range: from the frame at or before its start to the frame at or
    # after its end.
    first, last = (
        ticks * rate / TICKS_PER_SECOND for ticks in (start_ticks, end_ticks)
    )
    first_frame = round(first) if _is_on_frame(first) else math.floor(first)
    last_frame = round(last) if _is_on_frame(last) else math.ceil(last)
    last_frame = max(first_frame, last_frame)
    count = last_frame - first_frame + 1
    value_count = count * max(values_per_frame, MIN_VALUES_PER_FRAME)
    if count > MAX_FRAME_COUNT or value_count > MAX_TAKE_VALUES:
        message = (
            f"take {take.name!r} lasts "
            f"{(end_ticks - start_ticks) / TICKS_PER_SECOND:.6g} s, which is {count} "
            f"frames at {rate_label(rate)}; the limit is "
            f"{min(MAX_FRAME_COUNT, MAX_TAKE_VALUES * count // value_count)}"
        )
        hint = f"remove stray keys, or lower the rate with {argument('source.fps')}"
        raise FormatError(
            Fault("FBX013", message, str(scene.path), (), hint, where=take.location)
        )
    return Clock(rate, Fraction(first_frame), Fraction(1), count)


def off_frame_keys_notice(
    scene: FbxScene, fbx_rig: FbxRig, sampler: FbxSampler, clock: Clock
) -> list[Fault]:
    """Return a note about keys between frames, with the error of joints there."""
    take = sampler.take
    if take is None:
        return []
    key_ticks = take.key_times()
    frame_numbers = key_ticks / float(Fraction(TICKS_PER_SECOND) / clock.fps)
    off_frame_indices = np.flatnonzero(
        np.abs(frame_numbers - np.round(frame_numbers)) > FRAME_TOLERANCE
    )
    if not len(off_frame_indices):
        return []
    stride = max(1, len(off_frame_indices) // MAX_MEASURED_KEYS)
    measured_indices = off_frame_indices[::stride]
    frame_before = np.floor(frame_numbers[measured_indices])
    positions = [
        forward_kinematics(fbx_rig.rig, *sampler.sample(ticks).dense()).positions
        for ticks in (
            clock_ticks(clock, frame_before),
            clock_ticks(clock, frame_before + 1.0),
            key_ticks[measured_indices],
        )
    ]
    fraction = (frame_numbers[measured_indices] - frame_before)[:, None, None]
    frame_positions = positions[0] + fraction * (positions[1] - positions[0])
    distances = np.linalg.norm(positions[2] - frame_positions, axis=2)
    worst_joint = int(distances.max(axis=0).argmax())
    message = (
        f"{len(off_frame_indices)} of {len(key_ticks)} key times fall between the "
        f"frames at {rate_label(clock.fps)}: joints are up to "
        f"{distances.max() * 1e3:.3g} mm off there "
        f"(joint {fbx_rig.rig.names[worst_joint]!r})"
    )
    hint = f"set another rate with {argument('source.fps')}"
    path = str(scene.path)
    return [
        Fault("FBX110", message, path, (), hint, Severity.NOTE, where=take.location)
    ]


def keys_outside_notice(
    scene: FbxScene, take: AnimTake | None, clock: Clock
) -> list[Fault]:
    """Return a note about keys outside the range of a take, or a warning if all are."""
    curves = [] if take is None else take.curves()
    animated_curves = [curve for curve in curves if not curve.is_static()]
    if take is None or not animated_curves:
        return []
    key_ticks = np.unique(np.concatenate([curve.times for curve in animated_curves]))
    frame_numbers = key_ticks / float(Fraction(TICKS_PER_SECOND) / clock.fps)
    first, last = int(clock.start), int(clock.start) + clock.count - 1
    is_outside = frame_numbers < first - FRAME_TOLERANCE
    is_outside |= frame_numbers > last + FRAME_TOLERANCE
    outside_count = int(is_outside.sum())
    if not outside_count:
        return []
    message = (
        f"{outside_count} of {len(key_ticks)} key times of take {take.name!r}, "
        f"{frame_numbers[0]:.6g} to {frame_numbers[-1]:.6g}, lie outside its frames "
        f"{first} to {last}, which are read"
    )
    hint = "if they belong to it, make the take longer in the program that wrote it"
    severity = Severity.WARNING if outside_count == len(key_ticks) else Severity.NOTE
    path = str(scene.path)
    return [Fault("FBX123", message, path, (), hint, severity, where=take.location)]


def _is_on_frame(frame: Fraction) -> bool:
    return abs(frame - round(frame)) <= Fraction(1, 1000)


def build_stream(fbx_rig: FbxRig, sampler: FbxSampler, clock: Clock) -> TakeStream:
    """Return a take as a stream, sampled block by block."""

    def sample(frame_numbers: FloatArray) -> Motion:
        return sampler.sample(clock_ticks(clock, frame_numbers))

    return build_sampled_stream(fbx_rig.rig, clock, sample, BLOCK_FRAMES)


def animates_rig(fbx_rig: FbxRig, take: AnimTake, scene: FbxScene) -> bool:
    """Return whether a take has tracks of the rig's nodes or shapes."""
    ids = {scene.models[source.model].object.id for source in fbx_rig.joint_sources}
    ids |= {channel.id for channel, _ in fbx_rig.shape_channels}
    return any(object_id in ids for object_id, _ in take.tracks)


def count_animated_joints(fbx_rig: FbxRig, take: AnimTake, scene: FbxScene) -> int:
    """Return how many joints of a rig move in a take."""
    animated_ids = {
        object_id
        for (object_id, _), track in take.tracks.items()
        if not all(curve.is_static() for curve in track.curves())
    }
    return sum(
        scene.models[source.model].object.id in animated_ids
        for source in fbx_rig.joint_sources
    )
