"""Resampling of takes at another rate or at the time codes of an output."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import MAX_FRAME_COUNT, Clock, frame_label, time_codes
from animtool.core.errors import Fault, OptionError, Severity, warning
from animtool.core.loaded import check_loaded
from animtool.core.rates import FractionLike, rate_option, rate_warning
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.edit.between import TakeSampler
from animtool.edit.frames import check_count
from animtool.edit.straight import interpolation_notices
from animtool.edit.travel import FramePositions, even_positions
from animtool.maths import filters, so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    RETIMED_PARTS,
    FrameScope,
    LinearTime,
    OptionChecks,
    Pass,
    PassContext,
)
from animtool.motion.take import Take

BLOCK_FRAMES = 512


@dataclass(frozen=True, slots=True)
class SampleTimes:
    """Exact sample times of a take, as fractions."""

    first: Fraction  # time code of the first frame
    last: Fraction  # time code of the last frame
    # Time code of every sample ``(N,)``, ascending; sub-frame samples may be before the
    # first or after the last frame.
    codes: FloatArray
    frames: IntArray  # frame of the source at or before each sample ``(N,)``
    fractions: FloatArray  # fraction towards the next frame, in [0, 1) ``(N,)``
    # Number of dropped source samples between full frames of the result.
    dropped_sample_count: int = 0
    # Remainder of the source after the last full frame [time codes].
    dropped_duration_at_end: Fraction = Fraction(0)


def plan_samples(
    clock: Clock,
    fps: Fraction,
    start: Fraction,
    *,
    frame_range: FrameRange | None = None,
    offsets: Sequence[Fraction] = (),
    keep_samples: bool = False,
    extend: bool = False,
) -> SampleTimes:
    """Return the sample times of a take that starts at time code ``start``.

    Args:
        clock: Clock of the source.
        fps: Time codes per second of the result.
        start: Time code of the first frame.
        frame_range: Frames to keep, as time codes of the result; None keeps all.
        offsets: Sample offsets around each frame, in frames; empty for one sample on
            the frame.
        keep_samples: Keep every sample of the source at its exact time, instead of one
            per frame.
        extend: Keep every frame of the range; outside the take, its first or last pose
            is held.
    """
    ratio = clock.rate / fps  # source frames per time code
    frame_span = Fraction(clock.count - 1) / ratio
    if keep_samples:
        return _source_samples(clock, start, 1 / ratio, frame_range)
    # Frames are counted from the integer time code at or before the take's first frame.
    origin, frame_shift = start, Fraction(0)
    frame_numbers = range(int(frame_span) + 1)
    if frame_range is not None:
        origin = Fraction(math.floor(start))
        frame_shift = origin - start
        frame_numbers = _covered_frames(frame_range, start, frame_span, extend=extend)
    if len(frame_numbers) * max(1, len(offsets)) > MAX_FRAME_COUNT:
        message = f"{len(frame_numbers)} frames at {float(fps):g} fps are too many"
        raise _range_error(message)
    first, last = origin + frame_numbers[0], origin + frame_numbers[-1]
    frame_indices = np.arange(
        frame_numbers[0], frame_numbers[-1] + 1, frame_numbers.step
    )
    offsets = offsets or (Fraction(0),)
    positions = [
        even_positions(frame_indices, frame_shift + offset, ratio, clock.count)
        for offset in offsets
    ]
    step_and_count = (Fraction(frame_numbers.step), len(frame_numbers))
    codes = np.stack(
        [time_codes(first + o, *step_and_count) for o in offsets]
    ).T.ravel()
    sort_order = np.argsort(codes, kind="stable")
    frames = np.stack([p.frames for p in positions]).T.ravel()[sort_order]
    fractions = np.stack([p.fractions for p in positions]).T.ravel()[sort_order]
    end_position = frame_span - frame_shift  # of the take, in the same count
    last_frame = math.floor(end_position)
    has_remainder = not extend and frame_numbers[-1] == last_frame
    if frame_range is not None and frame_range.last <= origin + last_frame:
        has_remainder = False
    return SampleTimes(
        first,
        last,
        codes[sort_order],
        frames,
        fractions,
        _dropped_sample_count(
            frame_numbers, frame_shift, ratio, clock.count, frames[fractions == 0]
        ),
        end_position - last_frame if has_remainder else Fraction(0),
    )


def _dropped_sample_count(
    frames: range,
    shift: Fraction,
    ratio: Fraction,
    sample_count: int,
    sampled_frames: IntArray,
) -> int:
    """Return the number of source samples between result frames that are dropped.

    ``shift``: offset of result frames from the take's first frame [frame].
    """
    first_frame = max(frames[0], math.ceil(-shift))
    last_frame = min(frames[-1], math.floor((sample_count - 1) / ratio - shift))
    if last_frame < first_frame:
        return 0
    first_sample = max(0, math.ceil((frames[0] + shift) * ratio))
    last_sample = min(sample_count - 1, math.floor((frames[-1] + shift) * ratio))
    frame_indices = np.arange(first_frame, last_frame + 1)
    positions = even_positions(frame_indices, shift, ratio, sample_count)
    samples_on_frames = positions.frames[positions.fractions == 0]
    used_samples = np.union1d(samples_on_frames, sampled_frames)
    is_in_range = (used_samples >= first_sample) & (used_samples <= last_sample)
    return last_sample - first_sample + 1 - int(is_in_range.sum())


def _range_error(message: str) -> OptionError:
    """Return the error for an invalid frame range (CLI005)."""
    return OptionError(Fault("CLI005", message))


def missing_frames_fault(
    frame_range: FrameRange,
    first: Fraction,
    last: Fraction,
    *,
    argument_name: str = "frame_range",
    noun: str = "take",
) -> Fault:
    """Return a fault for requested frames that a take does not have (CLI005).

    ``argument_name`` is the argument that requests them, ``noun`` what lacks them.

    >>> missing = FrameRange(0, 0)
    >>> first, last = Fraction(1), Fraction(64)
    >>> missing_frames_fault(missing, first, last, argument_name="rest").message
    'rest: frame 0 is not in the take, which has frames 1-64'
    """
    first_frame, last_frame = frame_range.first, frame_range.last
    frames_text = (
        f"frame {first_frame} is"
        if first_frame == last_frame
        else f"frames {first_frame}-{last_frame} are"
    )
    message = f"{argument(argument_name)}: {frames_text} not in the {noun}, "
    message += f"which has frames {frame_label(first)}-{frame_label(last)}"
    return Fault("CLI005", message)


def _covered_frames(
    frame_range: FrameRange, start: Fraction, frame_span: Fraction, *, extend: bool
) -> range:
    """Return the frames of the range that the take covers, from ``floor(start)``.

    With ``extend``, return all frames of the range.
    """
    origin = math.floor(start)
    step = frame_range.step
    range_first, range_last = frame_range.first - origin, frame_range.last - origin
    if extend:
        return range(range_first, range_last + 1, step)
    take_first, take_last = start - origin, start - origin + frame_span
    range_first += max(0, math.ceil((take_first - range_first) / step)) * step
    frames = range(range_first, min(range_last, math.floor(take_last)) + 1, step)
    if not frames:
        raise OptionError(missing_frames_fault(frame_range, start, start + frame_span))
    return frames


def _source_samples(
    clock: Clock, start: Fraction, step: Fraction, frame_range: FrameRange | None
) -> SampleTimes:
    """Return the source's own samples at their exact times."""
    first_index, last_index = 0, clock.count - 1
    if frame_range is not None:
        if frame_range.step != 1:
            message = f"{argument('keep_samples', True)} needs a "
            raise _range_error(f"{message}{argument('frame_range')} without a step")
        first_index = max(first_index, -(-(frame_range.first - start) // step))
        last_index = min(last_index, (frame_range.last - start) // step)
        if first_index > last_index:
            last = start + (clock.count - 1) * step
            raise OptionError(missing_frames_fault(frame_range, start, last))
    frames = np.arange(first_index, last_index + 1)
    first = start + first_index * step
    codes = time_codes(first, step, len(frames))
    last = start + last_index * step
    return SampleTimes(first, last, codes, frames, np.zeros(len(frames)))


def dropped_notice(dropped_frames: Fraction, fps: Fraction, last: Fraction) -> Fault:
    """Return the note that a fraction of a frame is cut off at the end (TAKE006)."""
    message = (
        f"the take ends {float(dropped_frames):.3g} frames "
        f"({float(dropped_frames / fps):.3g} s) after its last whole frame, "
        f"{frame_label(last)}; that part is cut off"
    )
    return Fault("TAKE006", message, severity=Severity.NOTE)


def single_frame_warning(
    times: SampleTimes, clock: Clock, fps: Fraction
) -> list[Fault]:
    """Return a warning if resampling leaves one frame of several (TAKE010)."""
    if len(times.codes) != 1 or clock.count < 2:
        return []
    message = f"1 of {clock.count} frames remains, {frame_label(times.first)}: the "
    message += f"rate of {float(fps):.6g} fps and the range leave no second one"
    hint = "use a higher rate or a wider range; a still pose needs a range of one frame"
    return [warning("TAKE010", message, hint)]


def sample_blocks(
    take: Take | TakeSampler, times: SampleTimes, *, is_smooth: bool = False
) -> Iterator[tuple[FloatArray, Motion]]:
    """Yield time codes and motion at sample times, block by block.

    A sample on a frame of the source equals that frame exactly. Between frames,
    rotations follow the shortest arc at constant speed (slerp) and other values are
    linear. With ``is_smooth``, joints follow splines of class C1; weights and controls,
    which may have bounds, do not. Curves of the take are evaluated.
    """
    sampler = take if isinstance(take, TakeSampler) else TakeSampler.from_take(take)
    previous_rotations = None
    # Blocks share their animated rows, which depend on the complete take.
    block_length = max(1, len(times.codes)) if sampler.rows_on_curve else BLOCK_FRAMES
    for block_start in range(0, len(times.codes), block_length):
        block_samples = slice(block_start, block_start + block_length)
        fractions = times.fractions[block_samples]
        positions = FramePositions(times.frames[block_samples], fractions)
        motion = sampler.sample(positions, is_smooth=is_smooth)
        if is_smooth:
            values = so3.align_signs(motion.rotations.values, previous_rotations)
            rotations = replace(motion.rotations, values=values)
            motion = replace(motion, rotations=rotations)
            previous_rotations = values[-1]
        yield times.codes[block_samples], motion


# Before downsampling, the filter halves amplitudes at this fraction of the new rate,
# and leaves a 400th of frequencies that would alias below a quarter of it.
CUTOFF_FRACTION, FILTER_ORDER = 0.35, 4


def filter_motion(motion: Motion, cutoff: float, rate: float) -> Motion:
    """Return a motion low-pass filtered at a cut-off [Hz], times unchanged."""

    def filter_channel(channel: Channel) -> Channel:
        """Return a low-pass filtered channel."""
        is_rotation = channel is motion.rotations
        lowpass_filter = filters.lowpass_rotations if is_rotation else filters.lowpass
        values = lowpass_filter(channel.values, cutoff, rate, order=FILTER_ORDER)
        return replace(channel, values=values)

    return replace(motion.map(filter_channel), track_times=motion.track_times)


def resampled(
    take: Take, fps: FractionLike, *, lowpass: bool = False, smooth: bool = False
) -> Take:
    """Resample a take to another frame rate, with a sample on every time code.

    The remainder after its last full frame is cut, with a note (TAKE006).

    Args:
        take: F frames.
        fps: Frames per second, such as 24, ``"23.976"`` or ``Fraction(24000, 1001)``.
        lowpass: If the new rate is lower, first remove frequencies that would alias;
            without lag.
        smooth: Interpolate joints along curves of class C1, whose error falls with the
            cube of the frame interval, instead of linearly.

    Raises:
        OptionError: The rate is invalid (SCN022), or there would be more than 10
            million samples (SCN021).
    """
    check_loaded(take, Take, "take")
    fps = rate_option(fps)
    check_count(1 + int((take.clock.count - 1) * fps / take.clock.rate))
    sample_times = plan_samples(take.clock, fps, take.clock.start)
    source, rate = take, take.clock.rate
    if lowpass and fps < rate:
        cutoff = CUTOFF_FRACTION * float(fps)
        source = replace(take, motion=filter_motion(take.motion, cutoff, float(rate)))
    sampler = TakeSampler.from_take(source)
    blocks = sample_blocks(sampler, sample_times, is_smooth=smooth)
    motion = Motion.concatenate([block for _, block in blocks])
    new_start, codes_ratio = take.clock.start, float(take.clock.fps / fps)
    clock, notices = Clock(fps, new_start, Fraction(1), motion.frames), take.notices
    if not smooth:
        positions = FramePositions(sample_times.frames, sample_times.fractions)
        hint = f"{argument('smooth', True)} interpolates smoothly"
        notices = (*notices, *interpolation_notices(sampler, positions, hint))
    notices = (*notices, *rate_warning(fps))
    notices = (*notices, *single_frame_warning(sample_times, take.clock, fps))
    if sample_times.dropped_duration_at_end:
        notices = (
            *notices,
            dropped_notice(
                sample_times.dropped_duration_at_end, fps, sample_times.last
            ),
        )
    first_code = float(new_start)
    return replace(
        take,
        clock=clock,
        motion=motion.map(Channel.compact) if sampler.rows_on_curve else motion,
        notices=notices,
        curve=sampler.retimed_curve(
            lambda codes: first_code + (codes - first_code) * codes_ratio
        ),
    )


@dataclass(frozen=True, slots=True)
class ResampleOptions:
    """The new rate.

    Attributes:
        fps: Frames per second, such as ``24``, ``23.976`` or ``24000/1001``; None
            leaves the take unchanged.
        lowpass: If the new rate is lower, first remove frequencies that would alias.
        smooth: Interpolate joints along curves instead of linearly.
    """

    fps: str | float | None = None
    lowpass: bool = False
    smooth: bool = False


def _run(take: Take, options: ResampleOptions, context: PassContext) -> Take:
    """Run the pass: resample at the new rate."""
    if options.fps is None:
        return take
    filter_options = {"lowpass": options.lowpass, "smooth": options.smooth}
    result = resampled(take, options.fps, **filter_options)
    context.add_notices_once(result.notices[len(take.notices) :])
    return result


def _checks(options: ResampleOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    if options.fps is None:
        return {}
    fps = options.fps
    return {"fps": lambda: rate_option(fps)}


def _linear_time(options: ResampleOptions, clock: Clock) -> LinearTime | None:
    """Return the linear map of time codes that the pass applies, if any."""
    if options.fps is None or options.lowpass:
        return None
    start = float(clock.start)
    return LinearTime(start, float(rate_option(options.fps) / clock.fps), start)


PASS = Pass(
    "resample",
    "Resample at another rate",
    ResampleOptions,
    FrameScope.CLIP,
    _run,
    _checks,
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
    linear_time=_linear_time,
)
