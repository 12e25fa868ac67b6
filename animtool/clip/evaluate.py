"""Channels of keys at any times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool._types import FloatArray
from animtool.clip.channels import ClipChannel
from animtool.clip.segments import curves_of, rotation_kinds
from animtool.maths import euler
from animtool.maths.curves import evaluate
from animtool.maths.rotation_curves import evaluate_rotations

# Rotations worked out at once: enough to make few calls, few enough to take 1 MB.
ROTATIONS_AT_ONCE = 2**15


def evaluate_channels(
    channels: Sequence[ClipChannel], times: FloatArray
) -> dict[str, FloatArray]:
    """Return the value of every target ``(F, D)``, ``(1, D)`` where it never moves.

    Rotations are quaternions (x, y, z, w), Euler angles made into some.

    Args:
        channels: Each of a target of its own.
        times: Any [frames] ``(F,)``; ascending ones are quickest.
    """
    values: dict[str, FloatArray] = {}
    curves: list[ClipChannel] = []
    turning: list[ClipChannel] = []
    for channel in channels:
        if _is_static(channel):
            values[channel.target] = _turned(channel, channel.values[:1])
        elif channel.values.shape[1] == 4:
            turning.append(channel)
        else:
            curves.append(channel)
    values |= _rotations(turning, times)
    if curves:
        rows = evaluate(curves_of(curves), times)
        begin = 0
        for channel in curves:
            end = begin + channel.values.shape[1]
            values[channel.target] = _turned(channel, rows[begin:end].T)
            begin = end
    return {channel.target: values[channel.target] for channel in channels}


def _rotations(channels: list[ClipChannel], times: FloatArray) -> dict[str, FloatArray]:
    """Return the rotations ``(F, 4)`` of every target, those keyed alike at once."""
    alike: dict[tuple[object, ...], list[ClipChannel]] = {}
    for channel in channels:
        how = channel.interps, channel.pre, channel.post
        alike.setdefault((channel.times.tobytes(), *how), []).append(channel)
    size = max(1, ROTATIONS_AT_ONCE // max(len(times), 1))
    values: dict[str, FloatArray] = {}
    groups = (
        same[begin : begin + size]
        for same in alike.values()
        for begin in range(0, len(same), size)
    )
    for group in groups:
        first = group[0]
        made = evaluate_rotations(
            first.times,
            np.stack([channel.values for channel in group], axis=1),
            rotation_kinds(first),
            times,
            first.pre,
            first.post,
        )
        rows = np.ascontiguousarray(made.swapaxes(0, 1))
        values |= {c.target: own for c, own in zip(group, rows, strict=True)}
    return values


def _is_static(channel: ClipChannel) -> bool:
    """Return whether no key and no handle says another value than the first key."""
    still = bool((channel.values == channel.values[0]).all())
    return still and not channel.ins[:, 1:].any() and not channel.outs[:, 1:].any()


def _turned(channel: ClipChannel, values: FloatArray) -> FloatArray:
    """Return Euler angles as quaternions, everything else as it is."""
    if not channel.euler:
        return values
    return euler.to_quaternion(np.degrees(values), channel.euler)
