"""Finds the frame rate and range of a glTF animation, whose keys are in seconds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import MAX_FRAME_COUNT
from animtool.core.errors import Fault, FormatError, Severity
from animtool.core.rates import parse_rate, rate_label
from animtool.core.record import dataclass
from animtool.formats.characters.names import unique_take_names
from animtool.formats.gltf.animations import Animation

# Candidate rates in order: the first with all keys on frames is used.
RATES_BY_PREFERENCE = (
    *(Fraction(n) for n in (24, 30, 60, 25, 50, 48, 120, 100, 12, 15, 10)),
    *(Fraction(n * 1000, 1001) for n in (24, 30, 60)),
    *(Fraction(n) for n in (90, 72, 240, 200, 144, 1000)),
)
DEFAULT_RATE = Fraction(30)
# Keys closer to a frame than this [frame], or within the relative precision of their
# time, are on it.
FRAME_TOLERANCE, TIME_PRECISION = 1e-3, 4e-7
# Key times look like milliseconds if this many keys or more are farther apart than the
# first spacing, and like frames if all are whole numbers at most the second apart [s].
MIN_SUSPECT_KEYS, MAX_KEY_SPACING, MAX_FRAME_SPACING = 9, 10.0, 2.0
# A first key later than this [s], with no more frames after it than before it, is
# reported.
LATE_START_SECONDS = 1.0
# Highest rate of evenly spaced keys that a note suggests [frame/s].
MAX_KEY_RATE = 1000.0
# Maximum number of animated values of a take, over all frames.
MAX_TAKE_VALUES = 60_000_000


@dataclass(frozen=True, slots=True)
class GltfFrames:
    """Frame range and rate of an animation."""

    fps: Fraction
    start: Fraction  # time code of time 0
    first_frame: Fraction  # time code of the first frame
    count: int
    notices: tuple[Fault, ...] = ()

    def seconds(self, codes: FloatArray) -> FloatArray:
        """Return times of frame numbers [s]."""
        return np.asarray((codes - float(self.start)) / float(self.fps))


def find_frame_range(
    animation: Animation | None, fps: Fraction | None, path: str, values_per_frame: int
) -> GltfFrames:
    """Return the frame range and rate of an animation.

    Time 0 is frame 0, except in files written by animtool, which state the start.

    Args:
        animation: The animation; None is one frame.
        fps: Requested frame rate; None derives it from the keys.
        path: The file, for notices.
        values_per_frame: Number of animated values per frame.
    """
    if animation is None or not animation.tracks:
        return GltfFrames(fps or RATES_BY_PREFERENCE[0], Fraction(0), Fraction(0), 1)
    stated_rate, start = _recorded_timing(animation.extras)
    times = key_times(animation)
    fitting_rates = (rate for rate in RATES_BY_PREFERENCE if _fits_rate(times, rate))
    rate = fps or stated_rate or next(fitting_rates, DEFAULT_RATE)
    first_time, last_time = animation.span
    first_frame = 0
    if first_time < 0:
        tolerance = _frame_tolerance(first_time, rate)
        first_frame = math.floor(first_time * float(rate) + tolerance)
    last_frame = max(
        first_frame,
        math.ceil(last_time * float(rate) - _frame_tolerance(last_time, rate)),
    )
    count = last_frame - first_frame + 1
    if count > MAX_FRAME_COUNT or count * max(values_per_frame, 1) > MAX_TAKE_VALUES:
        duration = last_time - first_time
        limit = min(MAX_FRAME_COUNT, MAX_TAKE_VALUES // max(values_per_frame, 1))
        message = f"the animation lasts {duration:.6g} s, which is {count} frames at "
        message += f"{rate_label(rate)}; the limit is {limit}"
        hint = f"remove stray keys, or lower the rate with {argument('source.fps')}"
        raise FormatError(
            Fault("GLT013", message, path, (), hint, where=animation.pointer)
        )
    notices = _unit_warning(times, path, animation)
    if not _fits_rate(times, rate):
        notices.append(_off_frame_fault(times, rate, path, animation))
    notices += _late_start_note(animation, rate, start, path)
    return GltfFrames(rate, start, start + first_frame, count, tuple(notices))


def _late_start_note(
    animation: Animation, rate: Fraction, start: Fraction, path: str
) -> list[Fault]:
    """Return a note if the pose does not change for most of an animation (GLT122)."""
    first_time, last_time = animation.span
    if first_time <= max(LATE_START_SECONDS, last_time - first_time):
        return []
    first_code, last_code = (
        float(start) + round(time * float(rate)) for time in (first_time, last_time)
    )
    message = f"the first key is at {first_time:.4g} s: frames {float(start):g} to "
    message += f"{first_code:g} have the same pose"
    hint = f"{argument('frame_range', f'{first_code:g}-{last_code:g}')} leaves them out"
    return [
        Fault("GLT122", message, path, (), hint, Severity.NOTE, where=animation.pointer)
    ]


def _unit_warning(times: FloatArray, path: str, animation: Animation) -> list[Fault]:
    """Return a warning if key times look like milliseconds or frames (GLT120)."""
    if len(times) < MIN_SUSPECT_KEYS:
        return []
    duration = float(times[-1] - times[0])
    spacing = float(np.median(np.diff(times)))
    # Exporters add up frame times in single precision.
    tolerances = FRAME_TOLERANCE + TIME_PRECISION * np.abs(times)
    is_integer = bool((np.abs(times - np.round(times)) < tolerances).all())
    if spacing > MAX_KEY_SPACING:
        unit, factor = "milliseconds", 1000.0
    elif is_integer and spacing <= MAX_FRAME_SPACING:
        unit, factor = (f"frames at {rate_label(DEFAULT_RATE)}", float(DEFAULT_RATE))
    else:
        return []
    message = f"keys are {spacing:.4g} s apart, over {duration:.5g} s; as {unit} they "
    message += (
        f"would be {spacing / factor:.3g} s apart, over {duration / factor:.3g} s"
    )
    hint = "key times of a glTF are in seconds: export it again"
    severity = Severity.WARNING
    return [Fault("GLT120", message, path, (), hint, severity, where=animation.pointer)]


def key_times(animation: Animation) -> FloatArray:
    """Return all distinct key times of an animation [s]."""
    times_by_id: dict[int, FloatArray] = {
        id(t.times): t.times for t in animation.tracks
    }
    return np.unique(np.concatenate(list(times_by_id.values())))


def _frame_tolerance(time: float, rate: Fraction) -> float:
    return FRAME_TOLERANCE + TIME_PRECISION * abs(time) * float(rate)


def _frame_distances(times: FloatArray, rate: Fraction) -> FloatArray:
    """Return distances of keys from the nearest frame, less rounding [frame]."""
    frames = times * float(rate)
    return np.asarray(
        np.abs(frames - np.round(frames)) - TIME_PRECISION * np.abs(frames)
    )


def _fits_rate(times: FloatArray, rate: Fraction) -> bool:
    return bool((_frame_distances(times, rate) <= FRAME_TOLERANCE).all())


def _off_frame_fault(
    times: FloatArray, rate: Fraction, path: str, animation: Animation
) -> Fault:
    is_off_frame = _frame_distances(times, rate) > FRAME_TOLERANCE
    message = f"{int(is_off_frame.sum())} of {len(times)} key times fall between the "
    message += f"frames at {rate_label(rate)}; the last key is at {times[-1]:.6g} s"
    hint = f"set another rate with {argument('source.fps')}"
    if key_rate := _rate_of_keys(times):
        rate_text = f"{float(key_rate):.7g}"
        hint = f"{argument('source.fps', rate_text)} puts all keys on frames"
    return Fault(
        "GLT110", message, path, (), hint, Severity.NOTE, where=animation.pointer
    )


def _rate_of_keys(times: FloatArray) -> Fraction | None:
    """Return the rate at which evenly spaced keys are on frames; None if they are not.

    >>> _rate_of_keys(np.array([10.0, 11.0, 14.0]) / 24.024)
    Fraction(3003, 125)
    """
    spacing = float(np.diff(times).min()) if len(times) > 1 else 0.0
    if not spacing * MAX_KEY_RATE > 1.0:
        return None
    last_frame = round(times[-1] / spacing)
    if last_frame < 1:
        return None
    rate = Fraction(last_frame / float(times[-1])).limit_denominator(1001)
    return rate if rate and _fits_rate(times, rate) else None


def _recorded_timing(extras: dict[str, Any]) -> tuple[Fraction | None, Fraction]:
    """Return the rate and start frame recorded by animtool."""
    timing = extras.get("animtool")
    if not isinstance(timing, dict):
        return None, Fraction(0)
    try:
        rate = parse_rate(str(timing["fps"]))
        start = Fraction(str(timing.get("start", 0)))
    except (KeyError, ValueError, ArithmeticError):
        return None, Fraction(0)
    return rate, start if abs(start) < 10**9 else Fraction(0)


def unique_clip_names(animations: Iterable[Animation]) -> list[str]:
    """Return a unique name for each animation; unnamed ones are numbered."""
    return unique_take_names((animation.name or "" for animation in animations), "clip")
