"""Results of key reduction, and their conversion to a clip."""

from __future__ import annotations

import math
from enum import StrEnum
from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipChannel, ClipUnits
from animtool.clip.clip import Clip
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.clock import Clock
from animtool.core.record import dataclass
from animtool.maths import euler
from animtool.maths.curves import Interp
from animtool.maths.fit import FittedKeys, evaluate_keys
from animtool.maths.tangents import Tangent
from animtool.motion.motion import Channel, Motion
from animtool.rig.skeleton import Rig


class ChannelKind(StrEnum):
    """Kinds of reduced channels."""

    TRANSLATION = "translation"
    ROTATION = "rotation"
    SCALE = "scale"
    WEIGHT = "weight"
    CONTROL = "control"


@dataclass(frozen=True, slots=True)
class ReducedChannel:
    """Keys of a joint's translation, rotation or scale, of a weight or a control."""

    target: str  # ``joint.kind``, ``weight[i]`` or ``control/name``
    kind: ChannelKind  # kind of its target
    index: int  # index of the joint in its rig, of the weight, or of the control
    joint: str | None  # name of the joint; None for a weight or a control
    order: str | None  # of the Euler angles, left to right; else None
    # Frames from 0, not time codes. Translations are in [m], rotations in [deg],
    # continuous over revolutions, and others in [1]. Handles lie at thirds of the
    # segments next to a key.
    keys: FittedKeys
    # The joint's part in the clip; empty for a weight or a control.
    part: str = ""


@dataclass(frozen=True, slots=True)
class Reduction:
    """Sparse keys of a take, and the errors of the motion that they give."""

    clock: Clock  # clock of the take, F frames
    rest: Motion  # one frame with the values of parts without channels
    # Ordered by translation, rotation, scale of each joint, then the weights. Parts at
    # rest have no channel; constant parts have one key.
    channels: tuple[ReducedChannel, ...]
    samples: int  # F times the number of moving channels
    error: float  # largest distance of a point from its original position [m]
    joint: str  # name of the joint that the point belongs to
    frame: int  # frame of the largest distance
    held: bool  # whether every joint is within its tolerance
    weight_error: float  # largest error of a weight [1]
    rounds: int  # number of world-error measurements

    @property
    def keys(self) -> int:
        """Number of keys of all channels; components of a channel share keys."""
        return sum(len(channel.keys.frames) for channel in self.channels)

    @property
    def samples_per_key(self) -> float:
        """Samples per key [1]."""
        return self.samples / max(1, self.keys)


def evaluate_reduction(reduction: Reduction, frames: ArrayLike | None = None) -> Motion:
    """Evaluate the keys at ``frames`` ``(N,)`` [frame]."""
    frame_indices = np.asarray(
        np.arange(reduction.clock.count) if frames is None else frames, np.float64
    )

    def optional_channel(
        kind: ChannelKind, rest_motion: Channel | None
    ) -> Channel | None:
        """Return the channel of a kind; None if the rest pose lacks that kind."""
        return (
            None
            if rest_motion is None
            else _reduced_channel_values(reduction, kind, rest_motion, frame_indices)
        )

    rest_motion = reduction.rest
    return Motion(
        _reduced_channel_values(
            reduction, ChannelKind.TRANSLATION, rest_motion.translations, frame_indices
        ),
        _reduced_channel_values(
            reduction, ChannelKind.ROTATION, rest_motion.rotations, frame_indices
        ),
        optional_channel(ChannelKind.SCALE, rest_motion.scales),
        optional_channel(ChannelKind.WEIGHT, rest_motion.weights),
    )


def channel_values(channel: ReducedChannel, frames: FloatArray) -> FloatArray:
    """Return the values ``(N, K)`` of a channel, rotations as quaternions."""
    values = evaluate_keys(channel.keys, frames)
    return (
        values if channel.order is None else euler.to_quaternion(values, channel.order)
    )


def _reduced_channel_values(
    reduction: Reduction, kind: ChannelKind, rest: Channel, frames: FloatArray
) -> Channel:
    """Return a channel of a kind, evaluated at frames."""
    channels = [channel for channel in reduction.channels if channel.kind is kind]
    constant_values, moving_channels = rest.rest.copy(), []
    for channel in channels:
        if len(channel.keys.frames) > 1:
            moving_channels.append(channel)
        else:
            constant_values[channel.index] = channel_values(channel, frames[:1])[0]
    values = np.zeros((len(frames), len(moving_channels), rest.rest.shape[1]))
    for i, channel in enumerate(moving_channels):
        values[:, i] = channel_values(channel, frames)
    return Channel(
        constant_values,
        np.array(
            [reduced_channel.index for reduced_channel in moving_channels], np.int64
        ),
        values,
    )


# Significant digits; rounding is far below any tolerance.
SIGNIFICANT_DIGITS = 10


def clip_of_reduction(reduction: Reduction, rig: Rig, name: str) -> Clip:
    """Return a reduction as a clip, its numbers rounded in the units of the rig.

    Keys are Hermite with slopes per frame, so that each segment is the fitted cubic.
    Rotations are Euler angles; a pin has one angle.
    """
    clock = reduction.clock
    last = clock.start + (clock.count - 1) * clock.step
    return Clip(
        name,
        clock.fps,
        Fraction(float(clock.start)),
        Fraction(float(last)),
        tuple(_clip_channel(channel, rig, clock) for channel in reduction.channels),
    )


def _clip_channel(channel: ReducedChannel, rig: Rig, clock: Clock) -> ClipChannel:
    """Return a reduced channel as a channel of a clip."""
    target, euler = _target_name(channel, rig), channel.order or ""
    unit = ClipUnits.of_rig(rig).unit_of(target, euler)
    return fitted_channel(target, channel.keys, clock, unit, euler)


def fitted_channel(
    target: str, keys: FittedKeys, clock: Clock, unit: float, euler: str = ""
) -> ClipChannel:
    """Return fitted keys as a channel of Hermite keys.

    Args:
        target: Target of the channel.
        keys: Keys in metres, degrees or [1]; frames from 0.
        clock: Clock of the frames.
        unit: Unit of written values [m], [rad] or [1].
        euler: Euler order; empty for other values.
    """
    # Unit of the fitted keys relative to the unit of the file.
    is_rotation = bool(euler) or target.endswith(".angle")
    factor = (math.radians(1.0) if is_rotation else 1.0) / unit
    times = float(clock.start) + keys.frames.astype(np.float64) * float(clock.step)
    intervals = np.diff(times)[:, None]
    count, components = keys.values.shape
    ins, outs = np.zeros((2, count, 1 + components))
    ins[1:, 0], outs[:-1, 0] = -1.0, 1.0
    ins[1:, 1:] = _round_in_unit(3 * keys.ins[1:] / intervals * factor, unit)
    outs[:-1, 1:] = _round_in_unit(3 * keys.outs[:-1] / intervals * factor, unit)
    outer_tangents = (Tangent.AUTO_CLAMPED, Tangent.FREE)
    tangents_before = (outer_tangents[0], *(Tangent.FREE,) * (count - 1))
    tangents_after = (*(Tangent.FREE,) * (count - 1), outer_tangents[0])
    return ClipChannel(
        target,
        times,
        _round_in_unit(keys.values * factor, unit),
        (Interp.HERMITE,) * count,
        tuple(zip(tangents_before, tangents_after, strict=True)),
        ins,
        outs,
        np.zeros((count, 3)),
        euler=euler,
    )


def _target_name(channel: ReducedChannel, rig: Rig) -> str:
    """Return the target of a channel in a clip."""
    if channel.kind is ChannelKind.CONTROL:
        return channel.target
    if channel.kind is ChannelKind.WEIGHT:
        return f"shape/{rig.shapes[channel.index].name}"
    return f"joint/{channel.joint}.{channel.part}"


def _round_in_unit(values: ArrayLike, unit: float) -> FloatArray:
    """Round values to the digits of a file unit; return metres and radians."""
    flattened = np.ravel(values).tolist()
    rounded_values = [
        float(f"{value + 0.0:.{SIGNIFICANT_DIGITS}g}") * unit for value in flattened
    ]
    return np.reshape(rounded_values, np.shape(values))
