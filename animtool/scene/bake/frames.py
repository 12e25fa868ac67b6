"""The frames of a bake: sample times, sampled motion and moving joints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from animtool.clip.keyed_curve import KeyedCurve
from animtool.core.arguments import argument, clause
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import Clock, frame_label, time_codes
from animtool.core.errors import Fault, OptionError, Severity, warning
from animtool.core.rates import rate_warning
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange, Shot, frame_spans
from animtool.edit.between import TakeSampler
from animtool.edit.resample import (
    SampleTimes,
    dropped_notice,
    missing_frames_fault,
    plan_samples,
    sample_blocks,
    single_frame_warning,
)
from animtool.edit.straight import interpolation_notices
from animtool.edit.travel import FramePositions
from animtool.motion.motion import Motion, TimedBlocks
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig
from animtool.scene.bake.first_frame import integer_frames, start_notice
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.retime import no_frames_error

if TYPE_CHECKING:
    from animtool.scene.systems.character_motion import CharacterRecorder
    from animtool.usd.props.writer import PropSamples
    from animtool.usd.rigs.joint_map import RigJointMap


@dataclass(frozen=True, slots=True)
class TakePlan:
    """One take of a bake: its stream, its joint map, and its first output frame."""

    source: Path  # file of the take
    name: str  # legal, unique name of a library's take; else empty
    stream: TakeStream  # opened, with the joints in the order written
    joint_map: RigJointMap | None  # maps the take's joints to those of a rig layer
    options: BakeOptions  # takes after the first have no rest frame
    fps: Fraction  # time codes a second of the output
    start: Fraction  # time code of the first frame
    notices: list[Fault]  # notices of the plan


@dataclass(frozen=True, slots=True)
class SampledTake:
    """A take sampled at the times of an output."""

    blocks: TimedBlocks
    rig: Rig
    # Times at which the source is sampled; None if its own samples are written.
    times: SampleTimes | None = None

    @property
    def first_and_last(self) -> tuple[Fraction, Fraction] | None:
        """First and last frame; None if they are unknown until the blocks are read."""
        return None if self.times is None else (self.times.first, self.times.last)


def sample_take(plan: TakePlan, stream: TakeStream) -> SampledTake:
    """Return a take sampled at the times of the output.

    If each sample of the source is a sample of the output, its blocks are passed
    through; otherwise the take is collected and resampled.
    """
    options = plan.options
    # A requested rate puts a sample on each frame.
    keeps_samples = options.fps is None or options.keep_samples or stream.step == 1
    is_unchanged = (
        plan.fps == stream.fps
        and keeps_samples
        and not options.samples
        and options.frame_range is None
        and options.rest_frame is None
    )
    if is_unchanged:
        return SampledTake(_stream_blocks(plan, stream), stream.rig)
    curve = None if stream.is_altered else stream.curve
    if curve is not None and options.rest_frame is None:
        return _sample_curve(plan, stream, curve)
    take = stream.collect()
    times = _sample_times(plan, take.clock)
    rig, sampler = take.rig, TakeSampler.from_take(take)
    if options.rest_frame is not None:
        rig = _with_rest(plan, sampler, options.rest_frame)
    plan.notices.extend(_interpolation_notices(plan, sampler, times))
    return SampledTake(sample_blocks(sampler, times), rig, times)


def _interpolation_notices(
    plan: TakePlan, sampler: TakeSampler, times: SampleTimes
) -> list[Fault]:
    """Return notices about interpolation errors, except those that a pass reported."""
    reported_codes = {notice.code for notice in plan.stream.notices}
    positions = FramePositions(times.frames, times.fractions)
    hint = f"{argument('keep_samples', True)} keeps the frames as is"
    notices = interpolation_notices(sampler, positions, hint)
    return [n.in_file(plan.source) for n in notices if n.code not in reported_codes]


def _sample_times(plan: TakePlan, clock: Clock) -> SampleTimes:
    """Return the sample times of a take, with notices of missing frames."""
    options = plan.options
    source_frames = None
    if options.fps is not None and not options.keep_samples:
        source_frames = integer_frames(clock, plan.fps, plan.start)
    try:
        times = plan_samples(
            clock,
            plan.fps,
            plan.start,
            frame_range=options.frame_range or source_frames,
            offsets=options.samples,
            keep_samples=options.keep_samples,
            extend=options.shot is not None,
        )
    except OptionError as error:
        fault = replace(error.faults[0], path=str(plan.source))
        if options.frame_range is not None and fault.hint is None:
            fault = replace(fault, hint=_range_hint(plan, options.frame_range, clock))
        raise OptionError(fault) from error
    frame_range = options.frame_range
    if options.shot is None or frame_range is None:
        notices = _range_notice(plan, times)
    else:
        notices = _missing_frames(plan, options.shot, clock)
        # Also checked if samples are kept that are not on the first and last frame.
        first, last = Fraction(frame_range.first), Fraction(frame_range.last)
        if options.keep_samples:
            times = replace(times, first=first, last=last)
    if options.start is None and options.shot is None:
        source = plan.stream.start, plan.stream.fps
        notices += start_notice(*source, plan.start, plan.fps, times.first)
    if options.fps is not None:
        notices += rate_warning(options.fps)
    if frame_range is None or frame_range.first != frame_range.last:
        notices += single_frame_warning(times, clock, plan.fps)
    notices += _end_notices(plan, times)
    plan.notices.extend(notice.in_file(plan.source) for notice in notices)
    return times


def _range_hint(plan: TakePlan, frames: FrameRange, clock: Clock) -> str | None:
    """Return a hint on how to number the take so that it contains a frame range."""
    span = Fraction(clock.count - 1) * plan.fps / clock.rate
    source_start = plan.stream.first_frame
    offset = plan.start - source_start
    start = argument("start", frame_label(plan.start))
    if offset and 0 <= frames.first - source_start <= span:
        range_text = (
            f"{frames.first + math.floor(offset)}-{frames.last + math.floor(offset)}"
        )
        return (
            f"{start} renumbers the take first: {argument('frame_range', range_text)}"
        )
    if plan.options.start is None and frames.last - frames.first <= span:
        start = argument("start", frames.first)
        hint = f"{start} numbers the first frame of the take {frames.first}"
        return clause(hint) or None
    return None


def _missing_frames(plan: TakePlan, shot: Shot, clock: Clock) -> list[Fault]:
    """Return notices about frames of a shot that the take lacks.

    The last frame of a take lasts until the next frame would begin.
    """
    frame_range, source_path = plan.options.frame_range, str(plan.source)
    assert frame_range is not None
    requested_frames = range(frame_range.first, frame_range.last + 1, frame_range.step)
    step = plan.fps / clock.rate
    last = plan.start + (clock.count - 1) * step
    # Played backwards, a frame lasts until the previous one.
    lead_in, lead_out = (step, Fraction(0)) if shot.speed < 0 else (Fraction(0), step)
    begin, end = plan.start - lead_in, last + lead_out
    missing_frames = [
        frame
        for frame in requested_frames
        if not begin < frame < end and frame not in {plan.start, last}
    ]
    if not missing_frames:
        return []
    from animtool.documents.document import with_position

    prefix = f"shot {shot.name}: " if shot.name else ""
    hint = f"the take has {float(plan.start):.7g} to {float(last):.7g}"
    if len(missing_frames) == len(requested_frames):
        # After passes that retime the take, its times do not correspond to the media.
        nearest_end = last if shot.speed < 0 else plan.start
        end_frames = requested_frames[0], requested_frames[-1]
        if end_frames[1] < shot.start or end_frames[0] > shot.end:
            raise _outside_shot_error(shot, frame_range, source_path)
        if shot.places_media and shot.frame_at(0) == nearest_end:
            length = clock.count / clock.rate * abs(shot.speed)
            raise no_frames_error(shot, *end_frames, length, source_path)
        message = (
            f"{prefix}the take has no frame from {end_frames[0]} to {end_frames[1]}"
        )
        cut_key = None if shot.places_media else "shot.cut"
        hint += "; change cut, or start, the number of the take's first frame"
        fault = Fault("SCN042", message, source_path, (), hint, where=cut_key)
        raise OptionError(with_position(fault))
    cut_frames = [
        frame for frame in missing_frames if shot.cut_in <= frame <= shot.cut_out
    ]
    handle_frames = [frame for frame in missing_frames if frame not in cut_frames]
    notices = []
    for code, description, key, frames in (
        ("SCN074", "frames of the cut", "cut", cut_frames),
        ("SCN106", "handle frames", "handles", handle_frames),
    ):
        if frames:
            message = f"{prefix}the take does not have {description} "
            message += frame_spans(frames, frame_range.step)
            message += "; the nearest pose is held"
            key_text = None if shot.places_media else f"shot.{key}"
            fault = warning(
                code, message, f"{hint}; change {key}, or export longer media", key_text
            )
            notices.append(with_position(fault.in_file(source_path)))
    return notices


def _outside_shot_error(shot: Shot, frames: FrameRange, path: str) -> OptionError:
    """Return the error for a requested range outside the frames of a shot (SCN042)."""
    offset = shot.start - 1  # of a range that counts from the start of the shot
    if not (frames.first >= 1 and frames.last + offset <= shot.end):
        offset = shot.start - frames.first
    first, last = frames.first + offset, min(frames.last + offset, shot.end)
    step_text = f"x{frames.step}" if frames.step > 1 else ""
    shot_text = f"shot {shot.name}" if shot.name else "the shot"
    message = f"{argument('frame_range', f'{frames.first}-{frames.last}{step_text}')} "
    message += f"has no frame of {shot_text}, which has {shot.start} to {shot.end}"
    range_text = f"{first}-{last}{step_text}"
    hint = f"for example write {argument('frame_range', range_text)}"
    return OptionError(Fault("SCN042", message, path, (), hint))


def _sample_curve(
    plan: TakePlan, stream: TakeStream, curve: Callable[[FloatArray], Motion]
) -> SampledTake:
    """Evaluate a source that is a function of time at the output's sample times."""
    first = stream.first_frame
    clock = Clock(stream.fps, first, stream.step, stream.count)
    times = _sample_times(plan, clock)
    # Samples on the source's frames are exact; those before its first or after its last
    # frame are off its grid. In a shot these hold the pose of its first or last frame.
    samples = times.frames + times.fractions
    if plan.options.shot is None:
        ratio = float(clock.rate / plan.fps)
        source_frames = (times.codes - float(plan.start)) * ratio
        is_outside = (source_frames < 0) | (source_frames > clock.count - 1)
        samples = np.where(is_outside, source_frames, samples)
    sample_codes = float(first) + samples * float(stream.step)
    motions = (
        curve.blocks(sample_codes)
        if isinstance(curve, KeyedCurve)
        else iter([curve(sample_codes)])
    )
    return SampledTake(_with_codes(times.codes, motions), stream.rig, times)


def _with_codes(codes: FloatArray, motions: Iterator[Motion]) -> TimedBlocks:
    frames_done = 0
    for motion in motions:
        yield codes[frames_done : frames_done + motion.frames], motion
        frames_done += motion.frames


def _stream_blocks(plan: TakePlan, stream: TakeStream) -> TimedBlocks:
    frames_read = 0
    for block in stream.blocks:
        first = plan.start + frames_read * stream.step
        yield time_codes(first, stream.step, block.frames), block
        frames_read += block.frames


def _range_notice(plan: TakePlan, times: SampleTimes) -> list[Fault]:
    """Return a warning if a frame range extends beyond the take."""
    frame_range = plan.options.frame_range
    if frame_range is None or plan.options.keep_samples:
        return []
    last = frame_range.last - (frame_range.last - frame_range.first) % frame_range.step
    if times.first == frame_range.first and times.last == last:
        return []
    range_text = f"{frame_range.first}-{frame_range.last}"
    message = f"{argument('frame_range', range_text)} extends beyond the take; "
    message += f"{float(times.first):g} to {float(times.last):g} are written"
    return [warning("SCN202", message)]


def _end_notices(plan: TakePlan, times: SampleTimes) -> list[Fault]:
    """Return notices if the take's last frame or an end of a range is not written."""
    frame_range = plan.options.frame_range
    notices = []
    if times.dropped_duration_at_end:
        note = dropped_notice(times.dropped_duration_at_end, plan.fps, times.last)
        hint = f"{argument('keep_samples', True)} writes it"
        notices.append(replace(note, hint=hint))
    if frame_range is None or plan.options.shot is not None:
        return notices
    written_range = f"{frame_label(times.first)} to {frame_label(times.last)}"
    is_last_off_step = (frame_range.last - frame_range.first) % frame_range.step != 0
    are_ends_missing = times.first > frame_range.first or times.last < frame_range.last
    if is_last_off_step or (plan.options.keep_samples and are_ends_missing):
        range_text = f"{frame_range.first}-{frame_range.last}"
        range_text += f"x{frame_range.step}" if frame_range.step > 1 else ""
        message = f"{argument('frame_range', range_text)} has no sample at its ends; "
        message += f"{written_range} are written"
        notices.append(Fault("CLI105", message, severity=Severity.NOTE))
    return notices


def _with_rest(plan: TakePlan, sampler: TakeSampler, frame: int) -> Rig:
    """Return the rig with its rest pose replaced by the pose of a frame of the take."""
    frames, take = FrameRange(frame, frame), sampler.take
    try:
        times = plan_samples(take.clock, plan.fps, plan.start, frame_range=frames)
    except OptionError as error:
        last = plan.start + Fraction(take.clock.count - 1) * plan.fps / take.clock.rate
        fault = missing_frames_fault(
            frames, plan.start, last, argument_name="rest_frame"
        )
        raise OptionError(replace(fault, path=str(plan.source))) from error
    ((_, pose),) = sample_blocks(sampler, times)
    translations, rotations = (values[0].tolist() for values in pose.dense()[:2])
    rest_joints = zip(take.rig.joints, translations, rotations, strict=True)
    joints = tuple(
        replace(joint, translation=tuple(translation), rotation=tuple(rotation))
        for joint, translation, rotation in rest_joints
    )
    return replace(take.rig, joints=joints)


def moving_joints(plan: TakePlan, rig: Rig, motions: list[Motion]) -> BoolArray:
    """Return a mask of the joints that leave the rest pose in any frame ``(J,)``."""
    is_moving = np.zeros(len(rig.joints), bool)
    rest_scales = np.ones((len(rig.joints), 3))
    if plan.joint_map is not None:
        rest_scales = plan.joint_map.rest_scales
    for motion in motions:
        channels = [
            (motion.translations, rig.rest_translations),
            (motion.rotations, rig.rest_rotations),
        ]
        if motion.scales is not None:
            channels.append((motion.scales, rest_scales))
        for channel, rest_value in channels:
            is_moving |= (channel.rest != rest_value).any(axis=-1)
            is_displaced = channel.values != rest_value[channel.animated]
            is_moving[channel.animated] |= is_displaced.any(axis=(0, 2))
    if plan.options.root_motion and rig.roots:
        # The SkelRoot carries it; with several roots the others are relative to it.
        is_moving[rig.roots[0]] = False
        is_moving[rig.roots[1:]] = True
    if rig.roots and not is_moving.any():
        is_moving[rig.roots[0]] = True
    return is_moving


class BakedTake:
    """A take that is read from its source and sampled for the writer."""

    def __init__(
        self, plan: TakePlan, recorder: CharacterRecorder | None = None
    ) -> None:
        self.plan = plan
        # Number of frames read from the source, and written to the output.
        self.frame_count = self.sample_count = 0
        self.props: PropSamples | None = None
        self._recorder = recorder
        self._sampled_take: SampledTake | None = None

    def open(self) -> SampledTake:
        """Return the take at the output's times; its frames are counted when read."""
        if self._sampled_take is not None:
            return self._sampled_take
        stream = self.plan.stream
        stream = replace(stream, blocks=self._count_frames(stream.blocks))
        if self._recorder is not None:
            stream = self._recorder.record_while_read(stream)
        sampled_take = sample_take(self.plan, stream)
        if stream.tracks:
            from animtool.usd.props.writer import PropSamples

            self.props = PropSamples(stream.tracks)
        blocks = self._record_blocks(sampled_take.blocks)
        self._sampled_take = replace(sampled_take, blocks=blocks)
        return self._sampled_take

    @property
    def rig(self) -> Rig:
        """The take's rig; its rest pose may be a requested frame of the take."""
        return self.open().rig

    def _count_frames(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self.frame_count += block.frames
            yield block

    def _record_blocks(self, blocks: TimedBlocks) -> TimedBlocks:
        """Yield blocks; count their samples and record their codes and props."""
        for codes, motion in blocks:
            self.sample_count += len(codes)
            if self._recorder is not None:
                self._recorder.record_codes(codes)
            if self.props is not None:
                self.props.record(codes, motion)
            yield codes, motion


def resample_for_output(plan: TakePlan) -> TakeStream:
    """Return a take resampled to the rate, frames and time codes of an output.

    Only the options ``fps``, ``frame_range`` and ``shot`` are used. New notices are
    added to those of the plan.
    """
    options = plan.options
    frame_options = BakeOptions(
        fps=options.fps, frame_range=options.frame_range, shot=options.shot
    )
    sampled_take = sample_take(replace(plan, options=frame_options), plan.stream)
    if sampled_take.times is None:
        return replace(plan.stream, start=plan.start)
    step = 1 if options.frame_range is None else options.frame_range.step
    return replace(
        plan.stream,
        fps=plan.fps,
        start=sampled_take.times.first,
        step=Fraction(step),
        blocks=(motion for _, motion in sampled_take.blocks),
        curve=None,
        count=0,
        control_curves={},
    )
