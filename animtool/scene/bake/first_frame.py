"""The first output frame of a take that starts between two frames.

In a stage of 24 time codes a second, frame 1001 of a referenced 25 fps take is at time
code 960.96.
"""

from __future__ import annotations

import math
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.clock import Clock, frame_label
from animtool.core.errors import Fault, Severity
from animtool.core.rates import rate_label
from animtool.core.shot import FrameRange

# A start that is this close to a frame is on it: rates in metadata are rounded [frame].
START_ROUNDING = Fraction(1, 100)


def start_frame_at_rate(
    start: Fraction, source_fps: Fraction, fps: Fraction, *, is_rounded: bool = True
) -> Fraction:
    """Return the first frame, at another rate, of a take that starts between frames.

    An integer start keeps its number.

    Args:
        start: Time code of the first frame.
        source_fps: Time codes a second that it counts.
        fps: Frames a second of the output.
        is_rounded: Whether to round to the nearest integer frame.

    >>> start_frame_at_rate(Fraction(24024, 25), Fraction(24), Fraction(25))
    Fraction(1001, 1)
    >>> start_frame_at_rate(Fraction(1001), Fraction(24), Fraction(25))
    Fraction(1001, 1)
    """
    if start.denominator == 1 or fps == source_fps:
        return start
    first = start * fps / source_fps
    frame = Fraction(round(first))
    return frame if is_rounded or abs(first - frame) <= START_ROUNDING else first


def integer_frames(clock: Clock, fps: Fraction, start: Fraction) -> FrameRange | None:
    """Return the integer time codes that cover a take, from its start [frame].

    The time codes of the first and the last sample are rounded up. Returns None if the
    start is an integer or each frame has one sample. ``fps`` is [frame/s].

    >>> clock = Clock(Fraction(24), Fraction(24024, 25), Fraction(24, 25), 20)
    >>> integer_frames(clock, Fraction(24), clock.start)
    FrameRange(first=961, last=980, step=1)
    """
    if start.denominator == 1 or clock.step == 1:
        return None
    last_time = start + (clock.count - 1) * fps / clock.rate
    first = math.ceil(start)
    return FrameRange(first, math.ceil(last_time)) if first <= last_time else None


def start_notice(
    source_start: Fraction | None,
    source_fps: Fraction,
    start: Fraction,
    fps: Fraction,
    first: Fraction,
) -> list[Fault]:
    """Warn if a source starts between frames and the output on a frame (TAKE008).

    Args:
        source_start: Time code of the source's first frame.
        source_fps: Time codes a second that it counts.
        start: Time code that it becomes.
        fps: Frames a second of the output.
        first: First frame of the output.
    """
    if source_start is None or source_start.denominator == 1 or first.denominator != 1:
        return []
    if start != start_frame_at_rate(source_start, source_fps, fps):
        # The first frame has another source, such as a rig layer's start.
        return []
    source_label = f"{frame_label(source_start)} at {rate_label(source_fps)}"
    message = f"the source starts at time code {source_label}"
    if fps != source_fps:
        converted_label = frame_label(source_start * fps / source_fps)
        message += f", which is {converted_label} at {rate_label(fps)}"
    message += f"; it is written from frame {frame_label(first)}"
    hint = f"choose another first frame with {argument('start')}"
    return [Fault("TAKE008", message, None, (), hint, Severity.NOTE)]
