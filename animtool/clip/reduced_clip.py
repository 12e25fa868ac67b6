"""A reduction as a clip, to be written."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from animtool._types import ArrayLike, FloatArray
from animtool.clip.channels import ClipChannel, Interp, Tangent
from animtool.clip.clip import Clip
from animtool.clip.reduction import ChannelKind, ReducedChannel, Reduction
from animtool.clip.units import ClipUnits
from animtool.clock import Clock
from animtool.maths.fit import FittedKeys
from animtool.rig.skeleton import Rig

# Significant digits: beside the tolerance of any reduction, rounding is nothing.
DIGITS = 10


def clip_of_reduction(reduction: Reduction, rig: Rig, name: str) -> Clip:
    """Return a reduction as a clip, its numbers rounded in the units of the rig.

    Keys are Hermite ones, their tangents slopes a frame: each segment is the cubic
    that was fitted. Rotations are Euler angles, a pin's is one angle.

    Args:
        reduction: Keys in metres and degrees, frames from 0.
        rig: Whose joints its channels name.
        name: What the clip is called.
    """
    clock = reduction.clock
    last = clock.start + (clock.count - 1) * clock.step
    return Clip(
        name,
        clock.fps,
        Fraction(float(clock.start)),
        Fraction(float(last)),
        tuple(_channel(channel, rig, clock) for channel in reduction.channels),
    )


def _channel(channel: ReducedChannel, rig: Rig, clock: Clock) -> ClipChannel:
    target, euler = _target(channel, rig), channel.order or ""
    unit = ClipUnits.of_rig(rig).of(target, euler)
    return fitted_channel(target, channel.keys, clock, unit, euler)


def fitted_channel(
    target: str, keys: FittedKeys, clock: Clock, unit: float, euler: str = ""
) -> ClipChannel:
    """Return fitted keys as a channel of Hermite ones.

    Args:
        target: Of the channel.
        keys: In metres, degrees or [1]; frames from 0.
        clock: What the frames are of.
        unit: What a value of 1 means where it is written: [m], [rad] or [1].
        euler: Order of the angles; empty for other values.
    """
    # What the keys count, in the unit that they are written in.
    turns = bool(euler) or target.endswith(".angle")
    given = (math.radians(1.0) if turns else 1.0) / unit
    times = float(clock.start) + keys.frames.astype(np.float64) * float(clock.step)
    spans = np.diff(times)[:, None]
    count, width = keys.values.shape
    ins, outs = np.zeros((2, count, 1 + width))
    ins[1:, 0], outs[:-1, 0] = -1.0, 1.0
    ins[1:, 1:] = _rounded(3 * keys.ins[1:] / spans * given, unit)
    outs[:-1, 1:] = _rounded(3 * keys.outs[:-1] / spans * given, unit)
    ends = (Tangent.AUTO_CLAMPED, Tangent.FREE)
    befores = (ends[0], *(Tangent.FREE,) * (count - 1))
    behinds = (*(Tangent.FREE,) * (count - 1), ends[0])
    return ClipChannel(
        target,
        times,
        _rounded(keys.values * given, unit),
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
    """Return values of a unit at few digits, in metres and radians."""
    flat = np.ravel(values).tolist()
    short = [float(f"{value + 0.0:.{DIGITS}g}") * unit for value in flat]
    return np.reshape(short, np.shape(values))
