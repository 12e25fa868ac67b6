"""Warnings about clips whose key times or rate look mistaken."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipChannel, values_at
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted, listed
from animtool.core.rates import rate_warning
from animtool.documents.document import Document
from animtool.maths import so3
from animtool.maths.curves import Extrapolation
from animtool.motion.key_times import are_in_seconds, are_integer_seconds

# Ends of a cycle that differ by less are equal [rad]; relative to the value range [1].
CYCLE_TOLERANCE = 1e-3
# Extrapolation that does not repeat the keys.
_ACYCLIC_EXTRAPOLATIONS = frozenset({Extrapolation.HOLD, Extrapolation.LINEAR})


def warn_of_times(
    document: Document,
    channels: Sequence[ClipChannel],
    fps: Fraction,
    first: Fraction,
    last: Fraction,
) -> None:
    """Warn of an implausible rate, times in seconds, and keys outside the range."""
    for fault in rate_warning(fps, None):
        document.warn(fault.code, ("fps",), fault.message, fault.hint)
    if 0 < last - first < 1 and "range" in document.value:
        message = f"the range from {float(first):g} to {float(last):g} holds one frame"
        hint = "frames run from the first in steps of 1: widen the range"
        document.warn("TAKE010", ("range",), message, hint)
    frame_range = (float(first), float(last)) if "range" in document.value else None
    if not _warn_of_seconds(document, channels, fps, frame_range):
        _warn_of_range(document, channels, float(first), float(last))
    _warn_of_open_cycles(document, channels, float(first), float(last))


def _warn_of_seconds(
    document: Document,
    channels: Sequence[ClipChannel],
    fps: Fraction,
    frame_range: tuple[float, float] | None,
) -> bool:
    """Warn of key times in seconds (CLIP110); return whether they are in seconds."""
    message_and_hint = seconds_texts(
        [channel.times for channel in channels], fps, frame_range
    )
    if message_and_hint is None:
        return False
    message, hint = message_and_hint
    i = max(range(len(channels)), key=lambda i: channels[i].times[-1])
    location = ("channels", i, "keys", len(channels[i].times) - 1, "t")
    document.warn("CLIP110", location, f"key times from {message}", hint)
    return True


def seconds_texts(
    times: Sequence[FloatArray], fps: Fraction, frame_range: tuple[float, float] | None
) -> tuple[str, str] | None:
    """Return a message about times in seconds and a hint, or None (CLIP110).

    The times of each curve ascend; ``frame_range`` is the first and last frame of the
    file's range.
    """
    if not times:
        return None
    rate = float(fps)
    is_in_range = frame_range and are_integer_seconds(times, *frame_range, rate)
    if not is_in_range and not are_in_seconds(times, fps):
        return None
    first = min(float(curve_times[0]) for curve_times in times)
    last = max(float(curve_times[-1]) for curve_times in times)
    message = f"{first:g} to {last:g} look like seconds: as frames at {rate:g} fps "
    message += f"they last {(last - first) / rate:.3g} s"
    start = 0.0
    if frame_range and is_in_range:
        start = frame_range[0]
        message += f" of the range from {frame_range[0]:g} to {frame_range[1]:g}"
    return message, f"write frames: {last:g} s is frame {start + last * rate:g}"


def _warn_of_range(
    document: Document, channels: Sequence[ClipChannel], first: float, last: float
) -> None:
    """Warn of keys outside the clip's range that have no effect (CLIP201).

    The nearest key outside on either side shapes the curve inside the range, and all
    keys are played if the channel repeats them.
    """
    keys_outside_by_channel = {
        i: keys_without_effect(c, first, last) for i, c in enumerate(channels)
    }
    keys_outside_by_channel = {
        i: keys for i, keys in keys_outside_by_channel.items() if len(keys)
    }
    if not keys_outside_by_channel:
        _note_of_repeated_keys(document, channels, first, last)
        return
    i, keys = next(iter(keys_outside_by_channel.items()))
    frame_text = listed([f"{t:g}" for t in channels[i].times[keys]])
    times = channels[i].times
    if times[0] > last or times[-1] < first:
        message = f"no key of {channels[i].target!r} is in the range from {first:g} to "
        message += f"{last:g}: its keys are from {times[0]:g} to {times[-1]:g}"
        hint = f"write range: [{times[0]:g}, {times[-1]:g}], or move the keys"
        document.warn("CLIP201", ("channels", i, "keys", 0, "t"), message, hint)
        return
    other_count = len(keys_outside_by_channel) - 1
    message = f"{counted(len(keys), 'key')} of {channels[i].target!r} outside the "
    message += f"range from {first:g} to {last:g}: {frame_text}"
    message += (
        f"; keys of {counted(other_count, 'other channel')} too" if other_count else ""
    )
    hint = "widen the range, or remove what is never played"
    document.warn("CLIP201", ("channels", i, "keys", int(keys[0]), "t"), message, hint)


def _note_of_repeated_keys(
    document: Document, channels: Sequence[ClipChannel], first: float, last: float
) -> None:
    """Add a note if no channel has a key in the range, and some repeat (CLIP201)."""
    moving_channels = [c for c in channels if len(c.times) > 1]
    is_repeating = any(
        not {c.pre, c.post} <= _ACYCLIC_EXTRAPOLATIONS for c in moving_channels
    )
    keys_in_range = [(c.times >= first) & (c.times <= last) for c in moving_channels]
    if not is_repeating or any(mask.any() for mask in keys_in_range):
        return
    first_key = min(float(c.times[0]) for c in moving_channels)
    last_key = max(float(c.times[-1]) for c in moving_channels)
    if first_key < first and last < last_key:
        return
    message = f"no key of any channel is in the range from {first:g} to {last:g}: keys "
    message += f"are from {first_key:g} to {last_key:g}; only repeated keys are played"
    hint = f"write range: [{first_key:g}, {first_key + last - first:g}], or move the "
    document.note("CLIP201", ("range",), message, f"{hint}keys")


def keys_without_effect(channel: ClipChannel, first: float, last: float) -> IntArray:
    """Return the keys of a channel that have no effect inside a frame range."""
    if not {channel.pre, channel.post} <= _ACYCLIC_EXTRAPOLATIONS:
        return np.zeros(0, np.int64)
    keys_before = np.flatnonzero(channel.times < first)[:-1]
    keys_after = np.flatnonzero(channel.times > last)[1:]
    return np.concatenate([keys_before, keys_after])


def _warn_of_open_cycles(
    document: Document, channels: Sequence[ClipChannel], first: float, last: float
) -> None:
    """Warn of channels that jump where their cycle repeats in the range (CLIP207)."""
    for i, channel in enumerate(channels):
        first_time, last_time = channel.times[0], channel.times[-1]
        for key, extrapolation, is_reached in (
            ("pre", channel.pre, first < first_time),
            ("post", channel.post, last > last_time),
        ):
            is_cycle = extrapolation is Extrapolation.CYCLE and is_reached
            if not is_cycle or _is_closed(channel):
                continue
            message = (
                f"{channel.target!r} repeats frames {first_time:g} to {last_time:g}, "
                "but its first and last values differ, so every repeat jumps"
            )
            hint = "give both the same value, or use cycle_offset to continue from the "
            hint += "last"
            document.warn("CLIP207", ("channels", i, key), message, hint)


def _is_closed(channel: ClipChannel) -> bool:
    """Return whether a channel's first and last value are equal, modulo revolutions."""
    first_value, last_value = channel.values[0], channel.values[-1]
    if (
        channel.target.endswith(".angle")
        and abs(last_value[0] - first_value[0]) > math.pi
    ):
        return (
            abs(math.remainder(float(last_value[0] - first_value[0]), math.tau))
            <= CYCLE_TOLERANCE
        )
    if channel.euler or channel.values.shape[1] == 4:
        end_rotations = values_at(channel, channel.times[[0, -1]])
        return (
            float(so3.angle_between(end_rotations[:1], end_rotations[1:])[0])
            <= CYCLE_TOLERANCE
        )
    value_range = float(np.ptp(channel.values, axis=0).max())
    return (
        float(np.abs(last_value - first_value).max()) <= CYCLE_TOLERANCE * value_range
    )
