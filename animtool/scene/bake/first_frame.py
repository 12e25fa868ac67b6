"""The first frame of a take that starts between the frames of its source's rate.

A 25 fps take that a stage of 24 time codes a second refers to has its frame 1001 at
time code 960.96.
"""

from __future__ import annotations

import math
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.clock import Clock, frame_label
from animtool.core.errors import Fault, Severity
from animtool.core.rates import rate_label
from animtool.core.shot import FrameRange

# So near to a frame a start is that frame: rates of metadata have few digits [frame].
START_ROUNDING = Fraction(1, 100)


def frame_start(
    start: Fraction, own: Fraction, fps: Fraction, *, whole: bool = True
) -> Fraction:
    """Return the first frame at another rate of a take that starts between frames.

    A whole start keeps its number.

    Args:
        start: Time code of the first frame.
        own: Time codes a second that it counts.
        fps: Frames a second of the output.
        whole: Whether that is to be a whole frame, the nearest one.

    >>> frame_start(Fraction(24024, 25), Fraction(24), Fraction(25))
    Fraction(1001, 1)
    >>> frame_start(Fraction(1001), Fraction(24), Fraction(25))
    Fraction(1001, 1)
    """
    if start.denominator == 1 or fps == own:
        return start
    first = start * fps / own
    nearest = Fraction(round(first))
    return nearest if whole or abs(first - nearest) <= START_ROUNDING else first


def whole_frames(clock: Clock, fps: Fraction, start: Fraction) -> FrameRange | None:
    """Return the whole frames of a take whose first sample becomes a time code.

    They reach to its end, and a part of a frame beyond. None where that time code is
    whole already, or where the samples are one a frame.

    >>> clock = Clock(Fraction(24), Fraction(24024, 25), Fraction(24, 25), 20)
    >>> whole_frames(clock, Fraction(24), clock.start)
    FrameRange(first=961, last=980, step=1)
    """
    if start.denominator == 1 or clock.step == 1:
        return None
    end = start + (clock.count - 1) * fps / clock.rate
    first = math.ceil(start)
    return FrameRange(first, math.ceil(end)) if first <= end else None


def start_notice(
    own: Fraction | None,
    own_fps: Fraction,
    start: Fraction,
    fps: Fraction,
    first: Fraction,
) -> list[Fault]:
    """Say so where a source starts between frames, and the output on one (TAKE008).

    Args:
        own: Time code of the source's first frame.
        own_fps: Time codes a second that it counts.
        start: Time code that it becomes.
        fps: Frames a second of the output.
        first: First frame of the output.
    """
    if own is None or own.denominator == 1 or first.denominator != 1:
        return []
    if start != frame_start(own, own_fps, fps):
        # The frames begin elsewhere, such as at those of a rig layer.
        return []
    message = (
        f"the source starts at time code {frame_label(own)} at {rate_label(own_fps)}"
    )
    if fps != own_fps:
        message += f", which is {frame_label(own * fps / own_fps)} at {rate_label(fps)}"
    message += f"; it is written from frame {frame_label(first)}"
    hint = f"choose another first frame with {argument('start')}"
    return [Fault("TAKE008", message, None, (), hint, Severity.NOTE)]
