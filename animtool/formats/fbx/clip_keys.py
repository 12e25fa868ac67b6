"""Converts an FBX take to a clip, with the file's keys or with samples."""

from __future__ import annotations

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, Severity, counted
from animtool.formats.fbx.joined_keys import JoinedKeys, join_keys
from animtool.formats.fbx.layers import (
    OUTER_ROTATIONS,
    PIVOT_PROPERTIES,
    ROTATION,
    SCALING,
    TRANSLATION,
    PropertyTrack,
)
from animtool.formats.fbx.models import INHERIT_SCALE, Model
from animtool.formats.fbx.poses import TransformPart
from animtool.formats.fbx.rig import FbxRig
from animtool.formats.fbx.sampling import FRAME_TOLERANCE, FbxSampler, clock_ticks
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.fbx.takes import find_track
from animtool.maths import euler, so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent

_TARGET_SUFFIXES = ("local_translation", "local_rotation", "scale")
# Tolerance of values at rest.
REST_TOLERANCE = 1e-12


def build_clip(
    name: str, fbx_rig: FbxRig, sampler: FbxSampler, clock: Clock
) -> tuple[Clip, list[Fault]]:
    """Return a clip of a take, and notices about channels that are sampled.

    Translations, scales, Euler angles and shapes keep their keys if the take has one
    layer. Other channels are sampled at every frame, and at each key between frames.

    Args:
        name: Name of the clip.
        fbx_rig: The rig.
        sampler: The take on the rig.
        clock: Frames of the take.
    """
    builder = _ClipBuilder(fbx_rig, sampler, clock)
    channels: list[ClipChannel] = []
    for component in range(3):
        channels += builder.component_channels(component)
    channels += builder.shape_channels()
    last_frame = clock.start + clock.count - 1
    clip = Clip(name, clock.fps, clock.start, last_frame, tuple(channels))
    return clip, builder.sampling_notices()


class _ClipBuilder:
    """Builds a clip's channels from curves or samples."""

    def __init__(self, fbx_rig: FbxRig, sampler: FbxSampler, clock: Clock) -> None:
        self.fbx_rig = fbx_rig
        self.sampler = sampler
        self.clock = clock
        self.models = sampler.scene.models
        self.axes_rotation = so3.from_matrix(sampler.scene.settings.basis)
        self.sampled_channel_count = 0
        # Largest errors between keys of translations, rotations and scales.
        self.max_errors = [0.0, 0.0, 0.0]
        self.sampled_joints: list[set[int]] = [set(), set(), set()]
        rig = fbx_rig.rig
        unit_scales = np.ones((len(rig.joints), 3))
        self.default_values = (rig.rest_translations, rig.rest_rotations, unit_scales)

    def component_channels(self, component: int) -> list[ClipChannel]:
        """Return the channels of translations (0), rotations (1) or scales (2)."""
        channels: list[ClipChannel] = []
        animated_joints = set(self.sampler.animated_joints[component].tolist())
        rest = self.sampler.rest_values[component]
        for j in range(len(rest)):
            if j in animated_joints:
                exact_channels = self._exact_channels(component, j)
                channels += exact_channels
                if not exact_channels:
                    self.sampled_joints[component].add(j)
            elif (
                np.abs(rest[j] - self.default_values[component][j]).max()
                > REST_TOLERANCE
            ):
                target = self._channel_target(j, component)
                channels.append(self._static_channel(target, rest[j]))
        return channels + self._sampled_channels(component)

    def shape_channels(self) -> list[ClipChannel]:
        """Return the channels of blend shapes."""
        channels = []
        animated_shapes = set(self.sampler.animated_shapes.tolist())
        for k, shape in enumerate(self.fbx_rig.rig.shapes):
            target = f"shape/{shape.name}"
            if k not in animated_shapes:
                value = self.sampler.rest_values[3][k]
                if value.any():
                    channels.append(self._static_channel(target, value))
                continue
            channel, full_percent = self.fbx_rig.shape_channels[k]
            track = self.sampler.weight_track(k)
            assert track is not None
            keys = join_keys(track, np.array([channel.percent]))
            if keys is None:
                ticks = self._sample_times()
                values = self.sampler.weight(k, ticks)[:, None]
                self.sampled_channel_count += 1
                shape_channel = self._sampled_key_channel(
                    target, ticks, values, Interp.LINEAR
                )
            else:
                factor = np.eye(1) / full_percent
                shape_channel = self._build_channel(target, keys, factor, np.zeros(1))
            channels.append(shape_channel)
        return channels

    def _channel_target(self, j: int, component: int) -> str:
        return f"joint/{self.fbx_rig.rig.names[j]}.{_TARGET_SUFFIXES[component]}"

    def _exact_channels(self, component: int, j: int) -> list[ClipChannel]:
        """Return channels with the file's keys; empty if clips cannot store them."""
        model = self.models[self.fbx_rig.joint_sources[j].model]
        track = self._find_track(model, (TRANSLATION, ROTATION, SCALING)[component])
        keys = None if track is None else join_keys(track, model.base_values[component])
        if keys is None:
            return []
        if component == 1:
            return self._rotation_channels(j, model, keys)
        if component == 2:
            return self._scale_channels(j, model, keys)
        return self._translation_channels(j, model, keys)

    def _translation_channels(
        self, j: int, model: Model, keys: JoinedKeys
    ) -> list[ClipChannel]:
        pivot_offset = self._pivot_offset(model)
        if pivot_offset is None:
            return []
        factor = self.fbx_rig.translation_factors[j]
        basis = self.sampler.scene.settings.basis if model.parent < 0 else np.eye(3)
        target, offset = self._channel_target(j, 0), basis @ pivot_offset * factor
        return [self._build_channel(target, keys, basis * factor, offset)]

    def _scale_channels(
        self, j: int, model: Model, keys: JoinedKeys
    ) -> list[ClipChannel]:
        inherits_scale = model.scale_inheritance == INHERIT_SCALE or model.parent < 0
        if (
            not inherits_scale
            or self.fbx_rig.joint_sources[j].part is not TransformPart.FULL
        ):
            return []
        target = self._channel_target(j, 2)
        return [self._build_channel(target, keys, np.eye(3), np.zeros(3))]

    def _find_track(self, model: Model, name: str) -> PropertyTrack | None:
        return find_track(self.sampler.take, model.object.id, name)

    def _pivot_offset(self, model: Model) -> FloatArray | None:
        """Return the constant translation offset of the pivots; None if animated."""
        if any(self._find_track(model, name) is not None for name in PIVOT_PROPERTIES):
            return None
        rotation_offset, rotation_pivot, scaling_offset, scaling_pivot = model.pivots
        if not (scaling_offset.any() or scaling_pivot.any() or rotation_pivot.any()):
            return np.asarray(rotation_offset)
        names = ROTATION, SCALING, *OUTER_ROTATIONS
        if any(self._find_track(model, name) is not None for name in names):
            return None
        translations, *_ = model.local_transforms(None, np.zeros(1, np.int64))
        return np.asarray(translations[0] - model.base_values[0])

    def _rotation_channels(
        self, j: int, model: Model, keys: JoinedKeys
    ) -> list[ClipChannel]:
        """Return Euler angle channels after a constant channel for pre-rotation."""
        if any(self._find_track(model, name) is not None for name in OUTER_ROTATIONS):
            return []
        if np.abs(model.inverse_post_rotation[:3]).max() > REST_TOLERANCE:
            return []
        is_inner = self.fbx_rig.joint_sources[j].part is TransformPart.INNER
        is_root = model.parent < 0 and not is_inner
        pre_rotation = model.pre_rotation
        if is_root:
            pre_rotation = so3.multiply(self.axes_rotation, pre_rotation)
        pre_rotation = so3.normalize(pre_rotation)
        channels = []
        if so3.angle_between(pre_rotation, self.default_values[1][j]) > REST_TOLERANCE:
            target = self._channel_target(j, 1)
            channels.append(self._static_channel(target, pre_rotation))
        order = model.rotation_order
        axis_matrix = np.eye(3)[list(euler.axes_of(order))] * (np.pi / 180.0)
        target = f"joint/{self.fbx_rig.rig.names[j]}.rotation"
        channel = self._build_channel(target, keys, axis_matrix, np.zeros(3), order)
        return [*channels, channel]

    def _build_channel(
        self,
        target: str,
        keys: JoinedKeys,
        value_matrix: FloatArray,
        offset: FloatArray,
        euler_order: str = "",
    ) -> ClipChannel:
        """Return a channel with key values transformed by a matrix and an offset."""
        fps = float(self.clock.fps)
        in_handles, out_handles = (
            np.concatenate(
                [handles[:, :1] * fps, handles[:, 1:] @ value_matrix.T], axis=1
            )
            for handles in (keys.in_handles, keys.out_handles)
        )
        key_count = len(keys.ticks)
        return ClipChannel(
            target,
            self._key_frames(keys.ticks),
            keys.values @ value_matrix.T + offset,
            keys.interps,
            ((Tangent.FREE, Tangent.FREE),) * key_count,
            in_handles,
            out_handles,
            np.zeros((key_count, 3)),
            euler=euler_order,
            pre=keys.pre,
            post=keys.post,
        )

    def _key_frames(self, ticks: IntArray) -> FloatArray:
        """Return key times [frames], snapped to frames that are within two ticks."""
        frames_per_tick = float(self.clock.fps) / TICKS_PER_SECOND
        frame_numbers = ticks * frames_per_tick
        frames = np.round(frame_numbers)
        is_on_frame = np.abs(frame_numbers - frames) <= 2.0 * frames_per_tick
        return np.where(is_on_frame, frames, frame_numbers)

    def _static_channel(self, target: str, value: FloatArray) -> ClipChannel:
        interp = Interp.SLERP if len(value) == 4 else Interp.LINEAR
        ticks = clock_ticks(self.clock, self.clock.times[:1])
        return self._sampled_key_channel(target, ticks, value[None].copy(), interp)

    def _sampled_key_channel(
        self, target: str, ticks: IntArray, values: FloatArray, interp: Interp
    ) -> ClipChannel:
        key_count, component_count = values.shape
        tangents = (Tangent.AUTO_CLAMPED, Tangent.AUTO_CLAMPED)
        handles = np.zeros((key_count, 1 + component_count))
        return ClipChannel(
            target,
            self._key_frames(ticks),
            values,
            (interp,) * key_count,
            (tangents,) * key_count,
            handles,
            handles.copy(),
            np.zeros((key_count, 3)),
        )

    def _sample_times(self) -> IntArray:
        """Return the times of all frames and of keys between frames [ticks]."""
        ticks = clock_ticks(self.clock, self.clock.times)
        take = self.sampler.take
        key_times = np.zeros(0, np.int64) if take is None else take.key_times()
        key_times = key_times[(key_times > ticks[0]) & (key_times < ticks[-1])]
        next_frames = np.clip(np.searchsorted(ticks, key_times), 1, len(ticks) - 1)
        neighbours = np.stack([ticks[next_frames], ticks[next_frames - 1]])
        frame_distance = np.abs(neighbours - key_times).min(axis=0)
        tolerance = FRAME_TOLERANCE * TICKS_PER_SECOND / float(self.clock.fps)
        key_times = key_times[frame_distance > tolerance]
        return ticks if len(key_times) > len(ticks) else np.union1d(ticks, key_times)

    def _sampled_channels(self, component: int) -> list[ClipChannel]:
        """Return sampled channels of a component; record their errors."""
        sampled_joints = self.sampled_joints[component]
        if not sampled_joints:
            return []
        ticks = self._sample_times()
        middle_ticks = (ticks[1:] + ticks[:-1]) // 2
        joints = self.sampler.animated_joints[component].tolist()
        values = self._sampled_values(component, ticks)
        middle_values = self._sampled_values(component, middle_ticks)
        channels = []
        for column, j in enumerate(joints):
            if j not in sampled_joints:
                continue
            samples, exact_values = values[:, column], middle_values[:, column]
            self.sampled_channel_count += 1
            interp = Interp.LINEAR
            if component == 1:
                interp, samples = Interp.SLERP, so3.align_signs(samples)
                middle_samples = so3.slerp(samples[:-1], samples[1:], 0.5)
                errors = so3.angle_between(middle_samples, exact_values)
            else:
                errors = np.abs((samples[:-1] + samples[1:]) / 2 - exact_values)
            max_error = float(errors.max(initial=0.0))
            self.max_errors[component] = max(self.max_errors[component], max_error)
            target = self._channel_target(j, component)
            channels.append(self._sampled_key_channel(target, ticks, samples, interp))
        return channels

    def _sampled_values(self, component: int, ticks: IntArray) -> FloatArray:
        motion = self.sampler.sample(ticks)
        channel = (motion.translations, motion.rotations, motion.scales)[component]
        assert channel is not None
        return np.asarray(channel.values)

    def sampling_notices(self) -> list[Fault]:
        """Return one notice with the count and errors of sampled channels."""
        if not self.sampled_channel_count:
            return []
        metres, radians, scale = self.max_errors
        channels = counted(self.sampled_channel_count, "channel")
        message = f"{channels} sampled, as a clip has no such keys (layers, pivots, "
        message += "inherited scales, steps of one part): up to "
        message += f"{metres * 1e3:.3g} mm, {np.degrees(radians):.3g} degrees "
        message += f"and {scale:.3g} of scale off between keys"
        return [Fault("FBX121", message, severity=Severity.NOTE)]
