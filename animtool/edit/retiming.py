"""Trims takes, and plays them at another speed or along a time curve."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, Severity, refuse, warning
from animtool.core.loaded import check_loaded
from animtool.core.quantities import percent_hint
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.edit.between import TakeSampler
from animtool.edit.combine import align_signs
from animtool.edit.frames import (
    check_count,
    check_range,
    exact_fraction,
    frame_error,
    seconds_hint,
)
from animtool.edit.straight import interpolation_notices
from animtool.edit.travel import FramePositions, even_positions, frame_positions
from animtool.motion.keyed import (
    KeyInterpolation,
    KeyPairs,
    interpolate_keys,
    key_arrays,
)
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    RETIMED_PARTS,
    FrameScope,
    LinearTime,
    Pass,
    PassContext,
    TakePart,
)
from animtool.motion.take import Take, TakeStream

# Hint on how to lower the error of linear interpolation.
RESAMPLE_HINT = "a smooth resampling to a higher rate, before this, lowers the error"
# Time codes have few digits; a time code this near to a frame is that frame [frame].
FRAME_TOLERANCE = Fraction(1, 1_000_000)


@dataclass(frozen=True, slots=True)
class TrimOptions:
    """The frames to keep.

    Attributes:
        first: First time code to keep; None uses the take's first.
        last: Last time code to keep; None uses the take's last.
    """

    first: float | None = None
    last: float | None = None


def trim(take: Take, first: float | None = None, last: float | None = None) -> Take:
    """Return the frames of a take between two time codes, inclusive.

    Frames and their time codes stay unchanged; if a time code is between two frames,
    the range starts after it or ends before it.

    Args:
        take: A take of F frames.
        first: First time code to keep; None uses the take's first.
        last: Last time code to keep; None uses the take's last.

    Raises:
        OptionError: The take has no frame in the range (SCN013).
    """
    check_loaded(take, Take, "take")
    return _run_trim(TakeStream.of(take), TrimOptions(first, last)).collect()


def _run_trim(
    stream: TakeStream, options: TrimOptions, context: PassContext | None = None
) -> TakeStream:
    """Run the pass: keep a range of frames."""
    # The frames of a shot at the ends of the range may be between two samples.
    in_shot = context is not None and context.in_shot
    check_range(options.first, options.last)
    first_code = stream.first_frame

    def round_to_frame_index(frame: float, name: str, *, is_rounded_down: bool) -> int:
        """Return the index of the frame at a time code, or of one next to it."""
        index = (exact_fraction(frame, name) - first_code) / stream.step
        if is_rounded_down:
            return math.floor(index + FRAME_TOLERANCE)
        return math.ceil(index - FRAME_TOLERANCE)

    first_index, last_index = 0, None
    if options.first is not None:
        first_index = round_to_frame_index(
            options.first, "first", is_rounded_down=in_shot
        )
    if options.last is not None:
        last_index = round_to_frame_index(
            options.last, "last", is_rounded_down=not in_shot
        )
    range_ends = {"first": options.first, "last": options.last}
    stated_end_by_name = {
        name: end for name, end in range_ends.items() if end is not None
    }
    hint = seconds_hint(stated_end_by_name, first_code, stream.fps)
    if options.first is not None and first_index < 0 and not in_shot:
        message = f"first is {options.first:g}, but the take begins at "
        message += f"{float(first_code):g}; frames have the numbers of the take"
        first_hint = hint or f"write {argument('first', f'{float(first_code):g}')}"
        note = Fault("SCN013", message, hint=first_hint, severity=Severity.NOTE)
        stream.notices.append(note)
    first_index = max(0, first_index)
    if last_index is not None and last_index < first_index:
        first = float(first_code) if options.first is None else options.first
        message = f"there is no frame from {first:g} to {options.last:g}; the take "
        raise frame_error(f"{message}begins at {float(first_code):g}", hint)
    new_start = stream.start
    if first_index > 0:
        new_start = first_code + first_index * stream.step
    return replace(
        stream,
        start=new_start,
        blocks=_trim_blocks(
            stream,
            first_index,
            last_index,
            first_code,
            in_shot=in_shot,
            hint=None if in_shot else hint,
        ),
    )


def _trim_blocks(
    stream: TakeStream,
    first_index: int,
    last_index: int | None,
    start: Fraction,
    *,
    in_shot: bool,
    hint: str | None,
) -> Iterator[Motion]:
    """Yield the frames of a range; refuse a range outside the take.

    ``hint``: the frames of a range that seems to be in seconds.
    """
    frame_count = 0
    # The source is read to its end, which completes its notices.
    for block in stream.blocks:
        first_in_block, end_in_block = max(0, first_index - frame_count), block.frames
        if last_index is not None:
            end_in_block = min(block.frames, last_index + 1 - frame_count)
        if first_in_block < end_in_block:
            yield block.select(slice(first_in_block, end_in_block))
        frame_count += block.frames
    last = start + (frame_count - 1) * stream.step
    if first_index >= frame_count:
        raise frame_error(
            f"the first frame to keep is {float(start + first_index * stream.step):g}, "
            f"but the take has {float(start):g}-{float(last):g}",
            f"write frames from {float(start):g} to {float(last):g}",
        )
    if hint is not None and last_index == first_index and frame_count > 1:
        stream.notices.append(
            warning("TAKE010", f"1 of {frame_count} frames remains", hint)
        )
    if last_index is not None and last_index >= frame_count and not in_shot:
        requested_end = float(start + last_index * stream.step)
        message = f"last is {requested_end:g}, but the take ends at {float(last):g}, "
        message += f"at {rate_label(stream.fps)}"
        end_hint = f"write {argument('last', f'{float(last):g}')}"
        end_hint += ", or trim before a pass that changes the rate"
        notice = Fault("SCN013", message, hint=end_hint, severity=Severity.NOTE)
        stream.notices.append(notice)


TRIM = Pass(
    "trim",
    "Keep a range of frames",
    TrimOptions,
    FrameScope.FRAME,
    _run_trim,
    lambda options: {"last": lambda: check_range(options.first, options.last)},
    reads=frozenset({TakePart.CLOCK}),
    changes=frozenset({TakePart.CLOCK}),
)


# Percentages of a speed are larger; a lapse of time hardly is [1].
MIN_PERCENT_SPEED = 25.0


@dataclass(frozen=True, slots=True)
class TimeScaleOptions:
    """The playback speed.

    Attributes:
        speed: Speed factor: 2 is twice as fast, negative plays backwards.
        pivot: Time code that stays in place; None uses the first frame.
    """

    speed: float = 1.0
    pivot: float | None = None


def time_scale(take: Take, speed: float, pivot: float | None = None) -> Take:
    """Play a take at another speed, sampled on its own frame grid.

    Curves are evaluated between frames; other values are linear, and a note estimates
    their error (TAKE007).

    Time code t of the result shows ``pivot + (t - pivot) · speed`` of the take. The
    speed is interpreted as a decimal, so that coinciding frames equal the source's
    exactly.

    Args:
        take: A take of F frames.
        speed: Factor [1]: 2 is twice as fast, a negative one plays backwards.
        pivot: Time code that stays in place; None uses the first.

    Raises:
        OptionError: The speed is 0 or not finite (SCN016), no frame of the grid is
            left (SCN013), or there would be more than 10 million (SCN021).
    """
    check_loaded(take, Take, "take")
    _check_speed(speed)
    clock = take.clock
    exact_speed = exact_fraction(speed, "speed")
    pivot_code = clock.start if pivot is None else exact_fraction(pivot, "pivot")
    # All in frames of the take, counted from its first.
    pivot_frame = (pivot_code - clock.start) / clock.step
    end_positions = sorted(
        pivot_frame + (end_frame - pivot_frame) / exact_speed
        for end_frame in (0, clock.count - 1)
    )
    first_index, last_index = math.ceil(end_positions[0]), math.floor(end_positions[1])
    if first_index > last_index:
        raise frame_error(f"at speed {speed:g} no frame remains")
    check_count(last_index - first_index + 1)
    frame_indices = np.arange(first_index, last_index + 1)
    offset = pivot_frame / exact_speed - pivot_frame
    positions = even_positions(frame_indices, offset, exact_speed, clock.count)
    pivot_time, factor = float(pivot_code), float(exact_speed)
    start = clock.start + first_index * clock.step
    new_clock = replace(clock, start=start, count=len(frame_indices))
    result = _resample_at(
        take,
        new_clock,
        positions,
        lambda times: pivot_time + (times - pivot_time) * factor,
    )
    warnings = _percentage_warnings(speed, clock, new_clock)
    return replace(result, notices=(*result.notices, *warnings))


def _resample_at(
    take: Take,
    clock: Clock,
    positions: FramePositions,
    source_times: Callable[[FloatArray], FloatArray],
) -> Take:
    """Return a take resampled at fractional frame positions.

    clock: clock of the result, whose time t shows time ``source_times(t)`` of the take.
    """
    sampler = TakeSampler.from_take(take)
    notices = interpolation_notices(sampler, positions, RESAMPLE_HINT)
    return replace(
        take,
        clock=clock,
        motion=align_signs(sampler.sample(positions)).map(Channel.compact),
        notices=(*take.notices, *notices),
        curve=sampler.retimed_curve(source_times),
    )


def _check_speed(speed: float) -> None:
    """Raise if the speed is 0 or not finite."""
    if not math.isfinite(speed) or speed == 0:
        refuse("SCN016", f"speed is {speed}; it must be finite and not 0")


def _percentage_warnings(
    speed: float, clock_before: Clock, clock_after: Clock
) -> list[Fault]:
    """Return a warning about a speed that looks like a percentage (SCN117)."""
    if abs(speed) < MIN_PERCENT_SPEED or clock_before.count < 2:
        return []
    option = argument("speed", f"{speed:g}")
    message = f"{option} plays {abs(speed):g} times as fast, which leaves "
    message += f"{clock_after.count} of {clock_before.count} frames"
    return [warning("SCN117", message, percent_hint(speed))]


def _run_time_scale(
    take: Take, options: TimeScaleOptions, context: PassContext
) -> Take:
    """Run the pass: play at another speed."""
    result = time_scale(take, options.speed, options.pivot)
    context.add_notices_once(result.notices[len(take.notices) :])
    return result


def _linear_time(options: TimeScaleOptions, clock: Clock) -> LinearTime | None:
    """Return the linear map of time codes that the pass applies, if any."""
    if options.speed <= 0:
        return None
    pivot = float(clock.start) if options.pivot is None else options.pivot
    return LinearTime(pivot, 1 / options.speed, pivot)


TIME_SCALE = Pass(
    "time_scale",
    "Play at another speed",
    TimeScaleOptions,
    FrameScope.CLIP,
    _run_time_scale,
    lambda options: {"speed": lambda: _check_speed(options.speed)},
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
    linear_time=_linear_time,
)


@dataclass(frozen=True, slots=True)
class TimeWarpOptions:
    """The time curve.

    Attributes:
        curve: Pairs ``[frame of the result, frame of the take]``, the former ascending;
            empty leaves the take unchanged.
        interpolation: Interpolation between the pairs.
    """

    curve: tuple[tuple[float, float], ...] = ()
    interpolation: KeyInterpolation = KeyInterpolation.LINEAR


def time_warp(
    take: Take,
    curve: KeyPairs,
    interpolation: KeyInterpolation | str = KeyInterpolation.LINEAR,
) -> Take:
    """Retime a take by a time curve, from the curve's first frame to its last.

    The result has the frames of the take's grid, extended beyond its ends if the curve
    reaches there. The curve may run backwards or be constant. Curves of the take are
    evaluated between frames; other values are linear, and a note estimates their error
    (TAKE007).

    Args:
        take: A take of F frames.
        curve: Pairs ``[frame of the result, frame of the take]``, time codes.
        interpolation: ``smooth`` never leaves the range of two neighbouring pairs.

    Raises:
        OptionError: The curve is malformed (SCN015), shows frames that the take lacks
            or no frame of the grid (SCN013), or has too many (SCN021).
    """
    check_loaded(take, Take, "take")
    clock = take.clock
    key_times, source_codes = key_arrays(curve, "curve")
    _check_curve_range(clock, key_times, source_codes)
    first, last = float(key_times[0]), float(key_times[-1])
    offsets_from_start = [
        exact_fraction(code, "curve") - clock.start for code in (first, last)
    ]
    first_index = math.ceil(offsets_from_start[0] / clock.step)
    frame_count = math.floor(offsets_from_start[1] / clock.step) - first_index + 1
    if frame_count < 1:
        raise frame_error(
            f"the curve from {first:g} to {last:g} contains no whole frame"
        )
    check_count(frame_count)
    start, step = float(clock.start), float(clock.step)
    result_start = clock.start + first_index * clock.step
    result_clock = replace(clock, start=result_start, count=frame_count)

    def source_times(times: FloatArray) -> FloatArray:
        """Return the times of the take that the curve shows."""
        return interpolate_keys(key_times, source_codes, times, interpolation)

    frames = (source_times(result_clock.times) - start) / step
    positions = frame_positions(frames, clock.count)
    return _resample_at(take, result_clock, positions, source_times)


def _check_curve_range(
    clock: Clock, key_times: FloatArray, source_codes: FloatArray
) -> None:
    """Raise if the curve shows frames that the take lacks."""
    first, last = clock.times[[0, -1]] if clock.count else np.zeros(2)
    tolerance = 1e-6 * float(clock.step)
    outside_values = source_codes[
        (source_codes < first - tolerance) | (source_codes > last + tolerance)
    ]
    if len(outside_values):
        message = f"the curve maps to frame {outside_values[0]:g}, but the take has "
        hint = None
        last_key = float(key_times[-1])
        ascends = bool((np.diff(source_codes) > 0).all())
        if (
            ascends
            and first <= key_times[0]
            and last_key <= last <= source_codes[-1] - 1
        ):
            hint = "pairs are [frame of the result, frame of the take]: are they "
            hint += "swapped?"
        seconds = float(np.max(source_codes))
        last_code = float(clock.start) + seconds * float(clock.fps)
        has_fractions = bool((source_codes != np.round(source_codes)).any())
        if np.min(source_codes) >= 0 and has_fractions and last_code <= last + 1:
            hint = (
                f"a curve has frames, not seconds: {seconds:g} s is frame {last_code:g}"
            )
        raise frame_error(f"{message}{first:g}-{last:g}", hint)


def _run_time_warp(take: Take, options: TimeWarpOptions, context: PassContext) -> Take:
    """Run the pass: retime by a curve."""
    if not options.curve:
        return take
    result = time_warp(take, options.curve, options.interpolation)
    context.add_notices_once(result.notices[len(take.notices) :])
    return result


TIME_WARP = Pass(
    "time_warp",
    "Retime by a curve",
    TimeWarpOptions,
    FrameScope.CLIP,
    _run_time_warp,
    lambda options: {
        "curve": lambda: options.curve and key_arrays(options.curve, "curve")
    },
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
)
