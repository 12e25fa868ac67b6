"""Detects key times in seconds where frames are expected."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray, median
from animtool.core.clock import Clock
from animtool.core.errors import Fault, warning
from animtool.motion.keyed import WeightOption, key_arrays

# Samples with steps below this are seconds at 10 frames a second or more [frame].
MAX_DENSE_STEP, MIN_SAMPLES = 0.1, 3
# Frames keyed by hand are hardly closer together than this [frame].
MIN_HAND_KEYED_STEP = 2.0
# Times that differ by less from a whole frame are on it [frame].
ON_FRAME_TOLERANCE = 1e-6
# Whole seconds are recognised by several keys that begin before the first frame, and
# that as frames cover only this fraction of the take [1].
MIN_KEYS, MAX_COVERED_FRACTION = 3, 0.1


def are_in_seconds(times: Sequence[FloatArray], fps: Fraction) -> bool:
    """Return whether the key times of channels are likely seconds.

    >>> are_in_seconds([np.array([0, 0.5, 1.5])], Fraction(24))
    True
    """
    steps = np.concatenate([np.diff(channel_times) for channel_times in times])
    all_times = np.concatenate(times)
    is_on_frame = np.abs(all_times - np.round(all_times)) <= ON_FRAME_TOLERANCE
    if not len(steps) or is_on_frame.all():
        return False
    median_step = float(median(steps))
    if median_step < MAX_DENSE_STEP and len(steps) >= MIN_SAMPLES:
        return True
    # Several seconds from 0, keyed by hand; even steps are samples between frames.
    is_even = len(steps) >= MIN_SAMPLES and np.ptp(steps) <= ON_FRAME_TOLERANCE
    is_short = float(np.ptp(all_times)) < fps
    return bool(
        0 <= all_times.min() < 1
        and median_step < MIN_HAND_KEYED_STEP
        and is_short
        and not is_even
    )


def weight_warnings(
    weight: WeightOption, clock: Clock, *, in_shot: bool
) -> list[Fault]:
    """Warn of a weight curve in seconds, or outside the take's frames (SCN116).

    in_shot: Whether the take is trimmed to a shot; keys outside the shot are allowed.
    """
    if isinstance(weight, (int, float)):
        return []
    times, values = key_arrays(weight, "weight")
    first, last = (float(clock.times[end]) for end in (0, -1))
    if len(times) < 2 or not np.ptp(values) > 0:
        return []
    span_text = f"the keys of weight are from frame {times[0]:g} to {times[-1]:g}"
    frames_text = f"the take from {first:g} to {last:g}"
    rate = float(clock.fps)
    if are_in_seconds([times], clock.fps) or are_integer_seconds(
        [times], first, last, rate
    ):
        message = f"{span_text}, {frames_text}: they look like seconds"
        hint = f"write frames: {times[-1]:g} s is frame {first + times[-1] * rate:g}"
    elif not in_shot and (times[-1] < first or times[0] > last):
        constant_weight = values[-1] if times[-1] < first else values[0]
        message = f"{span_text}, {frames_text}: the weight is always "
        message += f"{constant_weight:g}"
        hint = "times are frames of the take"
    else:
        return []
    return [warning("SCN116", message, hint)]


def are_integer_seconds(
    times: Sequence[FloatArray], first: float, last: float, rate: float
) -> bool:
    """Return whether key times are likely whole seconds, for a range in frames.

    >>> are_integer_seconds([np.array([0.0, 1.0, 2.0])], 1, 48, 24)
    True
    """
    all_times, frame_count = np.concatenate(times), last - first + 1
    return bool(
        max(map(len, times)) >= MIN_KEYS
        and 0 <= all_times.min() < first
        and np.ptp(all_times) <= MAX_COVERED_FRACTION * frame_count
        and all_times.max() * rate <= frame_count + rate
    )
