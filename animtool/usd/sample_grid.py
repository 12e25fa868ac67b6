"""The evenly spaced time codes at which a SkelAnimation is read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from animtool.errors import Fault, FormatError
from animtool.usd.library import take_range

__all__ = ["SampleGrid", "sample_grid", "time_fraction"]

# Time codes are doubles of fractions such as 1001 + 1/5: this finds them again.
LARGEST_STEP_DENOMINATOR = 10_000
# Sub-frame samples about each frame make a grid finer than the samples; beyond this
# it is no grid but a curve's own keys.
FINEST_GRID = 8
# More frames than any take of unevenly spaced keys: there, a key has gone astray.
MOST_FRAMES = 100_000


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Evenly spaced time codes that hold every sample.

    Attributes:
        start: Time code of the first frame.
        step: Time codes from one to the next.
        count: Number of frames.
        even: Whether samples are so spaced, or some fall between frames.
    """

    start: Fraction
    step: Fraction
    count: int
    even: bool


@dataclass(frozen=True, slots=True)
class _Span:
    """First frame, and the last where the take or its stage states one."""

    first: Fraction
    last: Fraction | None


def _span(stage: Any, animation: Any) -> _Span:
    own = take_range(animation)
    if own is not None:
        return _Span(*own)
    stated = stage.HasAuthoredTimeCodeRange()
    last = time_fraction(stage.GetEndTimeCode()) if stated else None
    return _Span(time_fraction(stage.GetStartTimeCode()), last)


def sample_grid(
    stage: Any, animation: Any, times: list[float], where: str
) -> SampleGrid:
    """Return the frames of an animation.

    Args:
        stage: Whose range holds where the animation states none.
        animation: The SkelAnimation.
        times: Time codes of all that moves it, ascending.
        where: The animation, for messages.

    Raises:
        FormatError: The samples spread over more time codes than any take (USD016).
    """
    return _grid(times, _span(stage, animation), where)


def _grid(times: list[float], span: _Span, where: str) -> SampleGrid:
    if not times and span.last is not None:
        # Nothing moves, for as long as the take or its stage lasts.
        still = min(max(0, math.floor(span.last - span.first)), MOST_FRAMES) + 1
        return SampleGrid(span.first, Fraction(1), still, True)
    if len(times) < 2:
        start = time_fraction(times[0]) if times else span.first
        return SampleGrid(start, Fraction(1), 1, True)
    exact = [time_fraction(time) for time in times]
    gaps = {b - a for a, b in pairwise(exact)}
    step = _common_divisor(gaps)
    count = int((exact[-1] - exact[0]) / step) + 1
    if count > FINEST_GRID * len(times):
        first, last = math.floor(exact[0]), math.ceil(exact[-1])
        if last - first > MOST_FRAMES:
            message = f"{len(times)} samples spread over {last - first} time codes"
            raise FormatError(Fault("USD016", message, where, (), "a stray sample?"))
        return SampleGrid(Fraction(first), Fraction(1), last - first + 1, False)
    # Samples within a frame before the first serve its motion blur.
    start = span.first
    early = (start - exact[0]) / step
    if exact[0] < start < exact[0] + 1 and early.denominator == 1 and early < count:
        return SampleGrid(start, step, count - int(early), len(gaps) == 1)
    return SampleGrid(exact[0], step, count, len(gaps) == 1)


def time_fraction(time: float) -> Fraction:
    """Return the fraction that a time code of a stage stands for.

    >>> time_fraction(1001.2)
    Fraction(5006, 5)
    """
    return Fraction(time).limit_denominator(LARGEST_STEP_DENOMINATOR)


def _common_divisor(gaps: set[Fraction]) -> Fraction:
    """Return the largest step that every gap is a multiple of."""
    denominator = math.lcm(*(gap.denominator for gap in gaps))
    return Fraction(math.gcd(*(int(gap * denominator) for gap in gaps)), denominator)
