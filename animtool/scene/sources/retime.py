"""Retiming of takes: pre-roll, conversion to shot frames, shots outside their take."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.timecode import parse_timecode
from animtool.edit.between import TakeSampler
from animtool.edit.travel import frame_positions
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream


@dataclass(frozen=True, slots=True)
class Preroll:
    """Frames before the output in which passes with state, such as springs, start."""

    # Frame of the take's start; None is as its source states, or 1.
    start: Fraction | None
    first_frame: int  # first frame of the preroll
    fps: Fraction | None  # frames a second of the output; None is the take's rate

    def missing_frame_count(self, stream: TakeStream) -> int:
        """Return the number of frames that a take lacks before its first."""
        start = self.start if self.start is not None else stream.start
        start_offset = (Fraction(1) if start is None else start) - self.first_frame
        rate = stream.fps / stream.step
        return max(0, math.ceil(start_offset * rate / (self.fps or stream.fps)))


def with_preroll(stream: TakeStream, count: int) -> TakeStream:
    """Return a take that starts with copies of its first pose.

    The take's own frames keep their time codes.
    """
    source_blocks, curve, start = stream.blocks, stream.curve, stream.first_frame
    first = float(start)

    def first_pose(times: FloatArray) -> Motion:
        assert curve is not None
        return curve(np.maximum(times, first))

    def blocks() -> Iterator[Motion]:
        for i, block in enumerate(source_blocks):
            if not i:
                yield block.select(np.zeros(count, np.int64))
            yield block

    return replace(
        stream,
        start=start - count * stream.step,
        blocks=blocks(),
        curve=None if curve is None else first_pose,
        is_altered=True,
        count=0,
        control_curves={},
    )


def drop_first_frames(
    stream: TakeStream, count: int, start: Fraction | None
) -> TakeStream:
    """Return a take without its first frames.

    ``start`` is the time code of the first frame that remains; None leaves it unstated.
    """
    source_blocks = stream.blocks

    def blocks() -> Iterator[Motion]:
        frames_left = count
        for block in source_blocks:
            if frames_left < block.frames:
                yield block.select(slice(frames_left, None))
            frames_left = max(0, frames_left - block.frames)

    return replace(stream, start=start, blocks=blocks())


def in_shot(stream: TakeStream, shot: Shot | None) -> TakeStream:
    """Return a take with its sample times converted exactly to frames of a shot.

    No sample is resampled or dropped. The take is unchanged if the shot does not place
    its media. A shot that holds a pose repeats it in each frame.
    """
    if shot is None or shot.fps is None or not shot.places_media:
        return stream
    if shot.speed == 0:
        return _hold_pose(stream, shot)
    if shot.speed < 0:
        return _reverse(stream, shot)
    shot_step = stream.step / stream.fps * shot.fps / shot.speed
    return _retime_stream(stream, shot, shot.frame_at(0), shot_step)


def _retime_stream(
    stream: TakeStream, shot: Shot, start: Fraction, step: Fraction
) -> TakeStream:
    """Return a take with new frame numbers, and its curves retimed to match."""
    assert shot.fps is not None
    ratio = stream.fps * shot.speed / shot.fps
    curve, first_code = stream.curve, float(stream.first_frame)
    origin = float(shot.frame_at(0))

    def sample_shifted(times: FloatArray) -> Motion:
        assert curve is not None
        return curve(first_code + (times - origin) * float(ratio))

    return replace(
        stream,
        fps=shot.fps,
        start=start,
        step=step,
        curve=None if curve is None else sample_shifted,
        control_curves={
            name: curves.retimed(first_code, float(1 / ratio), origin)
            for name, curves in stream.control_curves.items()
            if ratio > 0
        },
    )


def _reverse(stream: TakeStream, shot: Shot) -> TakeStream:
    """Return a take reversed in time; it is read completely."""
    assert shot.fps is not None
    motion = stream.collect().motion
    sample_seconds = stream.step / stream.fps
    start = shot.frame_at((motion.frames - 1) * sample_seconds)
    reversed_motion = motion.select(np.arange(motion.frames)[::-1])
    step = sample_seconds * shot.fps / -shot.speed
    stream = replace(stream, blocks=iter([reversed_motion]))
    return _retime_stream(stream, shot, start, step)


def _hold_pose(stream: TakeStream, shot: Shot) -> TakeStream:
    """Return one pose of a take in every frame of a shot; it is read completely."""
    assert shot.fps is not None
    assert shot.media_in is not None
    take, frame_count = stream.collect(), shot.end - shot.start + 1
    sample_index = shot.media_in * stream.fps / stream.step
    if not 0 <= sample_index < take.clock.count:
        take_seconds = take.clock.count / take.clock.rate
        raise no_frames_error(shot, shot.start, shot.end, take_seconds)
    position = frame_positions([float(sample_index)], take.clock.count)
    pose = TakeSampler.from_take(take).sample(position)
    return replace(
        stream,
        fps=shot.fps,
        start=Fraction(shot.start),
        step=Fraction(1),
        blocks=iter([pose.select(np.zeros(frame_count, np.int64))]),
        curve=None,
        count=0,
        control_curves={},
    )


SECONDS_PER_HOUR = 3600
# A distance within this time of a multiple of an hour suggests a wrong hour [s].
HOUR_TOLERANCE = 600


def no_frames_error(
    shot: Shot, first: int, last: int, length: Fraction, path: str | None = None
) -> OptionError:
    """Return the error for a shot whose frames are all outside its take (SCN042).

    The shot places its media. ``length`` is the duration of the take [s].
    """
    prefix = f"shot {shot.name}: " if shot.name else ""
    message, hint = f"{prefix}the take has no frame from {first} to {last}", None
    if shot.timecode is not None:
        distance, hint = range_distance(shot, first, last, length)
        message += f"; {distance}"
    return OptionError(Fault("SCN042", message, path, (), hint))


def range_distance(
    shot: Shot, first: int, last: int, length: Fraction
) -> tuple[str, str]:
    """Return the distance of a shot's frames from its take as text, and a hint.

    ``length`` is the duration of the take [s].
    """
    media_timecode = shot.timecode
    assert media_timecode is not None
    shot_seconds = sorted(shot.seconds_at(frame) for frame in (first, last))
    shot_range = " to ".join(map(media_timecode.label, shot_seconds))
    frame_seconds = 1 / media_timecode.rate
    take_seconds = Fraction(0), max(Fraction(0), length - frame_seconds)
    take_range = " to ".join(map(media_timecode.label, take_seconds))
    side = "after" if shot_seconds[0] > 0 else "before"
    message = f"the range shows {shot_range}, but the take is {take_range}: the range "
    message += f"is {_duration_text(shot_seconds[0])} {side} it"
    timecode_text = _likely_first_timecode(shot, shot_seconds[0], length)
    hint = "if the first timecode of the take is different, set it: "
    hint += argument("first_timecode", timecode_text)
    hint += ", or `first_timecode` under [timeline] in animtool.toml or in "
    hint += "metadata.animtool of the clip"
    return message, hint


def _duration_text(seconds: Fraction) -> str:
    """Return a duration as text, with hours if it is close to whole hours.

    >>> _duration_text(Fraction(3601)), _duration_text(Fraction(-12))
    ('about an hour (3601 s)', '12 s')
    """
    duration = abs(seconds)
    hours = round(duration / SECONDS_PER_HOUR)
    seconds_text = f"{float(duration):.7g} s"
    if hours and abs(duration - hours * SECONDS_PER_HOUR) < HOUR_TOLERANCE:
        return f"about {'an hour' if hours == 1 else f'{hours} hours'} ({seconds_text})"
    return seconds_text


def _likely_first_timecode(shot: Shot, shot_seconds: Fraction, length: Fraction) -> str:
    """Return the full hour at which the take likely starts, else ``HH:MM:SS:FF``."""
    media_timecode = shot.timecode
    assert media_timecode is not None
    label = media_timecode.label(shot_seconds)
    hour_text = f"{label[:2]}:00:00{';' if media_timecode.drop_frame else ':'}00"
    try:
        begin_seconds = (
            parse_timecode(hour_text, media_timecode.rate) / media_timecode.rate
        )
    except ValueError:
        return "HH:MM:SS:FF"
    is_plausible = (
        begin_seconds <= media_timecode.first + shot_seconds < begin_seconds + length
        and begin_seconds != media_timecode.first
    )
    return hour_text if is_plausible else "HH:MM:SS:FF"
