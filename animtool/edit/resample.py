"""Resampling of takes at other times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import MAX_FRAMES, Clock, frame_label, time_codes
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.rates import FractionLike, rate_option, rate_warning
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.edit.between import Between
from animtool.edit.frames import check_count
from animtool.edit.straight import straight_notices
from animtool.edit.travel import FramePositions, even_positions
from animtool.maths import filters, so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import (
    RETIMED_PARTS,
    LinearTime,
    OptionChecks,
    Pass,
    PassContext,
    Scope,
)
from animtool.motion.take import Take

BLOCK_FRAMES = 512


@dataclass(frozen=True, slots=True)
class SampleTimes:
    """Sample times of a take, exact."""

    first: Fraction  # time code of the first frame
    last: Fraction  # time code of the last frame
    # Time code of every sample ``(N,)``, ascending; sub-frame samples may lie before
    # the first or after the last frame.
    codes: FloatArray
    frames: IntArray  # frame of the source at or before each sample ``(N,)``
    fractions: FloatArray  # how far on to the next, in [0, 1) ``(N,)``
    # Number of samples of the source between whole frames of the result that are not
    # kept.
    between: int = 0
    # Remainder of the source after the last full frame [time codes].
    dropped: Fraction = Fraction(0)


def plan_samples(
    clock: Clock,
    fps: Fraction,
    start: Fraction,
    *,
    frame_range: FrameRange | None = None,
    offsets: Sequence[Fraction] = (),
    keep_samples: bool = False,
    hold: bool = False,
) -> SampleTimes:
    """Return the sample times of a take that starts at time code ``start``.

    Args:
        clock: The source's own.
        fps: Time codes a second of the result.
        start: Time code of the first frame.
        frame_range: Frames to keep, as time codes of the result; None is all.
        offsets: Samples around each frame, in frames; none is one on the frame.
        keep_samples: Keep every sample of the source at its exact time, in place
            of one a frame.
        hold: Keep every frame of the range; where the take has none, its first or
            last pose is held.

    Raises:
        OptionError: The range has no frame of the take, the options exclude each
            other, or there would be more than 10 million samples.
    """
    ratio = clock.rate / fps  # source frames from one time code to the next
    span = Fraction(clock.count - 1) / ratio
    if keep_samples:
        return _kept_samples(clock, start, 1 / ratio, frame_range)
    # Frames count from the whole time code at or before the take's first frame.
    origin, shift = start, Fraction(0)
    planned = range(int(span) + 1)
    if frame_range is not None:
        origin = Fraction(math.floor(start))
        shift = origin - start
        planned = _within(frame_range, start, span, hold=hold)
    if len(planned) * max(1, len(offsets)) > MAX_FRAMES:
        raise _refusal(f"{len(planned)} frames at {float(fps):g} fps are too many")
    first, last = origin + planned[0], origin + planned[-1]
    index = np.arange(planned[0], planned[-1] + 1, planned.step)
    each = [
        even_positions(index, shift + offset, ratio, clock.count)
        for offset in offsets or (0,)
    ]
    codes = np.stack([_codes(first + o, planned) for o in offsets or (0,)])
    order = np.argsort(codes.T.ravel(), kind="stable")
    frames = np.stack([positions.frames for positions in each]).T.ravel()[order]
    fractions = np.stack([positions.fractions for positions in each]).T.ravel()[order]
    end = span - shift  # of the take, counted as the frames are
    last_frame = math.floor(end)
    to_the_end = not hold and planned[-1] == last_frame
    if frame_range is not None and frame_range.last <= origin + last_frame:
        to_the_end = False
    return SampleTimes(
        first,
        last,
        codes.T.ravel()[order],
        frames,
        fractions,
        _between(planned, shift, ratio, clock.count, frames[fractions == 0]),
        end - last_frame if to_the_end else Fraction(0),
    )


def _between(
    frames: range, shift: Fraction, ratio: Fraction, count: int, taken: IntArray
) -> int:
    """Return the number of source samples between result frames that are dropped.

    ``shift`` [frame].
    """
    begin = max(frames[0], math.ceil(-shift))
    end = min(frames[-1], math.floor((count - 1) / ratio - shift))
    if end < begin:
        return 0
    low = max(0, math.ceil((frames[0] + shift) * ratio))
    high = min(count - 1, math.floor((frames[-1] + shift) * ratio))
    positions = even_positions(np.arange(begin, end + 1), shift, ratio, count)
    kept = np.union1d(positions.frames[positions.fractions == 0], taken)
    return high - low + 1 - int(((kept >= low) & (kept <= high)).sum())


def _refusal(message: str) -> OptionError:
    return OptionError(Fault("CLI005", message))


def outside_take(
    frame_range: FrameRange,
    first: Fraction,
    last: Fraction,
    *,
    name: str = "frame_range",
    noun: str = "take",
) -> Fault:
    """Return the fault of frames that a take does not have (CLI005).

    Args:
        frame_range: The frames.
        first: First frame of the take.
        last: Its last frame.
        name: Argument that names the frames.
        noun: What has the frames.

    >>> outside_take(FrameRange(0, 0), Fraction(1), Fraction(64), name="rest").message
    'rest: frame 0 is not in the take, which has frames 1-64'
    """
    low, high = frame_range.first, frame_range.last
    frames = f"frame {low} is" if low == high else f"frames {low}-{high} are"
    message = f"{argument(name)}: {frames} not in the {noun}, "
    message += f"which has frames {frame_label(first)}-{frame_label(last)}"
    return Fault("CLI005", message)


def _codes(first: Fraction, frames: range) -> FloatArray:
    return time_codes(Fraction(first), Fraction(frames.step), len(frames))


def _within(
    frame_range: FrameRange, start: Fraction, span: Fraction, *, hold: bool
) -> range:
    """Return the range's frames that the take covers, from ``floor(start)``.

    With ``hold``, all frames of the range.
    """
    origin = math.floor(start)
    step = frame_range.step
    low, high = frame_range.first - origin, frame_range.last - origin
    if hold:
        return range(low, high + 1, step)
    begin, end = start - origin, start - origin + span
    low += max(0, math.ceil((begin - low) / step)) * step
    frames = range(low, min(high, math.floor(end)) + 1, step)
    if not frames:
        raise OptionError(outside_take(frame_range, start, start + span))
    return frames


def _kept_samples(
    clock: Clock, start: Fraction, step: Fraction, frame_range: FrameRange | None
) -> SampleTimes:
    low, high = 0, clock.count - 1
    if frame_range is not None:
        if frame_range.step != 1:
            raise _refusal(
                f"{argument('keep_samples', True)} needs a {argument('frame_range')} "
                "without a step"
            )
        low = max(low, -(-(frame_range.first - start) // step))
        high = min(high, (frame_range.last - start) // step)
        if low > high:
            last = start + (clock.count - 1) * step
            raise OptionError(outside_take(frame_range, start, last))
    frames = np.arange(low, high + 1)
    first = start + low * step
    codes = time_codes(first, step, len(frames))
    last = start + high * step
    return SampleTimes(first, last, codes, frames, np.zeros(len(frames)))


def dropped_notice(dropped: Fraction, fps: Fraction, last: Fraction) -> Fault:
    """Return the note that a fraction of a frame [time codes] is cut at the end."""
    message = (
        f"the take ends {float(dropped):.3g} frames ({float(dropped / fps):.3g} s) "
        f"after its last whole frame, {frame_label(last)}; that part is cut off"
    )
    return Fault("TAKE006", message, severity=Severity.NOTE)


def single_frame_warning(
    times: SampleTimes, clock: Clock, fps: Fraction
) -> list[Fault]:
    """Return a warning that one frame remains of a take with several (TAKE010)."""
    if len(times.codes) != 1 or clock.count < 2:
        return []
    message = (
        f"1 of {clock.count} frames remains, {frame_label(times.first)}: the rate of "
        f"{float(fps):.6g} fps and the range leave no second one"
    )
    hint = "use a higher rate or a wider range; a still pose needs a range of one frame"
    return [Fault("TAKE010", message, hint=hint, severity=Severity.WARNING)]


def sample(
    take: Take | Between, times: SampleTimes, *, smooth: bool = False
) -> Iterator[tuple[FloatArray, Motion]]:
    """Yield time codes and motion at sample times, block by block.

    A sample on a frame of the source is that frame exactly; between frames rotations
    follow the shortest arc at constant speed (slerp), other values are linear. With
    ``smooth`` joints follow splines of class C1; weights and controls, which may have
    bounds, do not. Curves of the take are evaluated.
    """
    between = take if isinstance(take, Between) else Between.of(take)
    last = None
    # Blocks share their animated rows, which depend on the complete take.
    length = max(1, len(times.codes)) if between.curved else BLOCK_FRAMES
    for begin in range(0, len(times.codes), length):
        part = slice(begin, begin + length)
        at = FramePositions(times.frames[part], times.fractions[part])
        motion = between.at(at, smooth=smooth)
        if smooth:
            rotations = motion.rotations
            signed = so3.align_signs(rotations.values, last)
            motion, last = (
                replace(motion, rotations=replace(rotations, values=signed)),
                signed[-1],
            )
        yield times.codes[part], motion


# Before downsampling, the filter halves amplitudes at this fraction of the new rate and
# leaves a 400th of what would alias below a quarter of it.
CUTOFF_FRACTION, FILTER_ORDER = 0.35, 4


def lowpassed(motion: Motion, cutoff: float, rate: float) -> Motion:
    """Return a motion low-pass filtered at a cut-off [Hz], times unchanged."""

    def slow(channel: Channel) -> Channel:
        turning = channel is motion.rotations
        run = filters.lowpass_rotations if turning else filters.lowpass
        values = run(channel.values, cutoff, rate, order=FILTER_ORDER)
        return replace(channel, values=values)

    return replace(motion.map(slow), track_times=motion.track_times)


def resampled(
    take: Take, fps: FractionLike, *, lowpass: bool = False, smooth: bool = False
) -> Take:
    """Return the take with a sample on every time code at another rate.

    The remainder after its last full frame is cut, with a note (TAKE006).

    Args:
        take: F frames.
        fps: Frames a second, such as 24, ``"23.976"`` or ``Fraction(24000, 1001)``.
        lowpass: Where these are fewer than the take's, first remove what is too fast
            for them, which would show as something slower; without lag.
        smooth: Between frames joints go along curves of class C1, whose error falls
            with the cube of the frames' distance, and not straight.

    Raises:
        OptionError: It is no rate (SCN022), or there would be more than 10 million
            samples (SCN021).
    """
    fps = rate_option(fps)
    check_count(1 + int((take.clock.count - 1) * fps / take.clock.rate))
    times = plan_samples(take.clock, fps, take.clock.start)
    source, rate = take, take.clock.rate
    if lowpass and fps < rate:
        cutoff = CUTOFF_FRACTION * float(fps)
        source = replace(take, motion=lowpassed(take.motion, cutoff, float(rate)))
    between = Between.of(source)
    motion = Motion.concatenate(
        [block for _, block in sample(between, times, smooth=smooth)]
    )
    start, ratio = take.clock.start, float(take.clock.fps / fps)
    clock, notices = Clock(fps, start, Fraction(1), motion.frames), take.notices
    if not smooth:
        at = FramePositions(times.frames, times.fractions)
        hint = f"{argument('smooth', True)} interpolates smoothly"
        notices = (*notices, *straight_notices(between, at, hint))
    notices = (*notices, *rate_warning(fps))
    notices = (*notices, *single_frame_warning(times, take.clock, fps))
    if times.dropped:
        notices = (*notices, dropped_notice(times.dropped, fps, times.last))
    first = float(start)
    return replace(
        take,
        clock=clock,
        motion=motion.map(Channel.compact) if between.curved else motion,
        notices=notices,
        curve=between.curve(lambda codes: first + (codes - first) * ratio),
    )


@dataclass(frozen=True, slots=True)
class ResampleOptions:
    """The new rate.

    Attributes:
        fps: Frames a second, such as ``24``, ``23.976`` or ``24000/1001``; none
            leaves the take as it is.
        lowpass: Where these are fewer than the take's, first remove what is too fast
            for them, which would show as something slower.
        smooth: Between frames, joints go along curves, and not straight.
    """

    fps: str | float | None = None
    lowpass: bool = False
    smooth: bool = False


def _run(take: Take, options: ResampleOptions, context: PassContext) -> Take:
    if options.fps is None:
        return take
    result = resampled(
        take, options.fps, lowpass=options.lowpass, smooth=options.smooth
    )
    context.note_once(result.notices[len(take.notices) :])
    return result


def _checks(options: ResampleOptions) -> OptionChecks:
    if options.fps is None:
        return {}
    fps = options.fps
    return {"fps": lambda: rate_option(fps)}


def _even(options: ResampleOptions, clock: Clock) -> LinearTime | None:
    if options.fps is None or options.lowpass:
        return None
    start = float(clock.start)
    return LinearTime(start, float(rate_option(options.fps) / clock.fps), start)


PASS = Pass(
    "resample",
    "Resample at another rate",
    ResampleOptions,
    Scope.CLIP,
    _run,
    _checks,
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
    even=_even,
)
