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
    index: int  # of the joint in its rig, of the weight, or of the control
    joint: str | None  # name of the joint; None for a weight or a control
    order: str | None  # of the Euler angles, left to right; None for all but rotations
    # Frames from 0, not time codes. Translations are in [m], rotations in [deg],
    # continuous over turns; the rest in [1]. Handles lie at thirds of the segments
    # beside a key.
    keys: FittedKeys
    # The joint's part as a clip names it; empty for a weight or a control.
    part: str = ""


@dataclass(frozen=True, slots=True)
class Reduction:
    """Sparse keys of a take and their error."""

    clock: Clock  # of the take, F frames
    rest: Motion  # one frame of the values without channels
    # In the order translation, rotation, scale of each joint, then the weights. What
    # stays at rest has none, what only stays has one key.
    channels: tuple[ReducedChannel, ...]
    samples: int  # F times the channels that move
    error: float  # largest distance of a point from where it was [m]
    joint: str  # name of the joint that the point belongs to
    frame: int  # where that is [frame]
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
    at = np.asarray(
        np.arange(reduction.clock.count) if frames is None else frames, np.float64
    )

    def optional_channel(kind: ChannelKind, rest: Channel | None) -> Channel | None:
        return None if rest is None else _channel(reduction, kind, rest, at)

    rest = reduction.rest
    return Motion(
        _channel(reduction, ChannelKind.TRANSLATION, rest.translations, at),
        _channel(reduction, ChannelKind.ROTATION, rest.rotations, at),
        optional_channel(ChannelKind.SCALE, rest.scales),
        optional_channel(ChannelKind.WEIGHT, rest.weights),
    )


def channel_values(channel: ReducedChannel, frames: FloatArray) -> FloatArray:
    """Return the values ``(N, K)`` of a channel, rotations as quaternions."""
    values = evaluate_keys(channel.keys, frames)
    return (
        values if channel.order is None else euler.to_quaternion(values, channel.order)
    )


def _channel(
    reduction: Reduction, kind: ChannelKind, rest: Channel, at: FloatArray
) -> Channel:
    channels = [channel for channel in reduction.channels if channel.kind is kind]
    constant, moves = rest.rest.copy(), []
    for channel in channels:
        if len(channel.keys.frames) > 1:
            moves.append(channel)
        else:
            constant[channel.index] = channel_values(channel, at[:1])[0]
    values = np.zeros((len(at), len(moves), rest.rest.shape[1]))
    for i, channel in enumerate(moves):
        values[:, i] = channel_values(channel, at)
    return Channel(constant, np.array([c.index for c in moves], np.int64), values)


# Significant digits: rounding is far below any tolerance.
DIGITS = 10


def clip_of_reduction(reduction: Reduction, rig: Rig, name: str) -> Clip:
    """Return a reduction as a clip, its numbers rounded in the units of the rig.

    Keys are Hermite with slopes per frame: each segment is the fitted
    cubic. Rotations are Euler angles; a pin has one angle.
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
    target, euler = _target(channel, rig), channel.order or ""
    unit = ClipUnits.of_rig(rig).of(target, euler)
    return fitted_channel(target, channel.keys, clock, unit, euler)


def fitted_channel(
    target: str, keys: FittedKeys, clock: Clock, unit: float, euler: str = ""
) -> ClipChannel:
    """Return fitted keys as a channel of Hermite keys.

    Args:
        target: Of the channel.
        keys: In metres, degrees or [1]; frames from 0.
        clock: Clock of the frames.
        unit: Unit of written values [m], [rad] or [1].
        euler: Euler order; empty for other values.
    """
    # Unit of the fitted keys in the unit of the file.
    rotates = bool(euler) or target.endswith(".angle")
    factor = (math.radians(1.0) if rotates else 1.0) / unit
    times = float(clock.start) + keys.frames.astype(np.float64) * float(clock.step)
    spans = np.diff(times)[:, None]
    count, width = keys.values.shape
    ins, outs = np.zeros((2, count, 1 + width))
    ins[1:, 0], outs[:-1, 0] = -1.0, 1.0
    ins[1:, 1:] = _rounded(3 * keys.ins[1:] / spans * factor, unit)
    outs[:-1, 1:] = _rounded(3 * keys.outs[:-1] / spans * factor, unit)
    ends = (Tangent.AUTO_CLAMPED, Tangent.FREE)
    befores = (ends[0], *(Tangent.FREE,) * (count - 1))
    behinds = (*(Tangent.FREE,) * (count - 1), ends[0])
    return ClipChannel(
        target,
        times,
        _rounded(keys.values * factor, unit),
        (Interp.HERMITE,) * count,
        tuple(zip(befores, behinds, strict=True)),
        ins,
        outs,
        np.zeros((count, 3)),
        euler=euler,
    )


def _target(channel: ReducedChannel, rig: Rig) -> str:
    if channel.kind is ChannelKind.CONTROL:
        return channel.target
    if channel.kind is ChannelKind.WEIGHT:
        return f"shape/{rig.shapes[channel.index].name}"
    return f"joint/{channel.joint}.{channel.part}"


def _rounded(values: ArrayLike, unit: float) -> FloatArray:
    """Round values in a unit; return them in metres and radians."""
    flat = np.ravel(values).tolist()
    short = [float(f"{value + 0.0:.{DIGITS}g}") * unit for value in flat]
    return np.reshape(short, np.shape(values))
