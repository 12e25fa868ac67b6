"""Keeping a range of a take's frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction

from animtool.edit.frames import check_range, exact, frame_refusal
from animtool.motion import Motion
from animtool.passes import OptionChecks, Pass, PassContext, Scope, TakePart
from animtool.take import Take, TakeStream

# Time codes are written to a few digits; a frame this near [frame] is meant.
ON_FRAME = Fraction(1, 1_000_000)


@dataclass(frozen=True, slots=True)
class TrimOptions:
    """Which frames to keep.

    Attributes:
        first: First time code to keep; None is the take's own.
        last: Last time code to keep; None is the take's own.
    """

    first: float | None = None
    last: float | None = None


def trim(take: Take, first: float | None = None, last: float | None = None) -> Take:
    """Return the frames of a take from one time code to another, both included.

    Frames stay as they are and keep their time codes; where a time code lies
    between two frames, the range begins behind it or ends before it.

    Raises:
        OptionError: The take has no frame in the range (SCN013).
    """
    return _trimmed(TakeStream.of(take), TrimOptions(first, last)).collect()


def _trimmed(
    stream: TakeStream, options: TrimOptions, context: PassContext | None = None
) -> TakeStream:
    # The frames of a shot at the ends of the range may lie between two samples.
    in_shot = context is not None and context.in_shot
    check_range(options.first, options.last)
    start = Fraction(1) if stream.start is None else stream.start
    low, high = 0, None
    if options.first is not None:
        away = (exact(options.first, "first") - start) / stream.step
        whole = math.floor(away + ON_FRAME) if in_shot else math.ceil(away - ON_FRAME)
        low = max(0, whole)
    if options.last is not None:
        away = (exact(options.last, "last") - start) / stream.step
        high = math.ceil(away - ON_FRAME) if in_shot else math.floor(away + ON_FRAME)
    if high is not None and high < low:
        raise frame_refusal(
            f"no frame is from {_shown(options.first, start)} to {options.last:g}"
        )
    moved = stream.start if low == 0 else start + low * stream.step
    return replace(stream, start=moved, blocks=_kept(stream, low, high, start))


def _checks(options: TrimOptions) -> OptionChecks:
    return {"last": lambda: check_range(options.first, options.last)}


def _shown(frame: float | None, start: Fraction) -> str:
    return f"{float(start) if frame is None else frame:g}"


def _kept(
    stream: TakeStream, low: int, high: int | None, start: Fraction
) -> Iterator[Motion]:
    count = 0
    # The source is read to its end, as its notices are complete only then.
    for block in stream.blocks:
        begin = max(0, low - count)
        end = block.frames if high is None else min(block.frames, high + 1 - count)
        if begin < end:
            yield block.select(slice(begin, end))
        count += block.frames
    if low >= count:
        last = start + (count - 1) * stream.step
        raise frame_refusal(
            f"the first frame to keep is {float(start + low * stream.step):g}, and "
            f"the take has {float(start):g}-{float(last):g}"
        )


PASS = Pass(
    "trim",
    "Keep a range of frames",
    TrimOptions,
    Scope.FRAME,
    _trimmed,
    _checks,
    reads=frozenset({TakePart.CLOCK}),
    changes=frozenset({TakePart.CLOCK}),
)
