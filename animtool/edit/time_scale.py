"""Playing a take faster, slower or backwards."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from animtool.edit.combine import continuous
from animtool.edit.frames import check_count, exact, frame_refusal
from animtool.edit.travel import even_places
from animtool.errors import Fault, OptionError
from animtool.motion import Channel
from animtool.passes import (
    RETIMED_PARTS,
    OptionChecks,
    Pass,
    PassContext,
    Scope,
)
from animtool.take import Take


@dataclass(frozen=True, slots=True)
class TimeScaleOptions:
    """How fast the take plays.

    Attributes:
        speed: Factor: 2 is twice as fast, negative is backwards.
        pivot: Time code that stays where it is; None is the first frame.
    """

    speed: float = 1.0
    pivot: float | None = None


def time_scale(take: Take, speed: float, pivot: float | None = None) -> Take:
    """Return the take at another speed, sampled on its own frame grid.

    Time code t of the result shows ``pivot + (t - pivot) · speed`` of the take.
    The speed is taken as the decimal it is written as, so that frames which
    coincide are the source's exactly.

    Raises:
        OptionError: The speed is 0 or not finite (SCN016), no frame of the grid is
            left (SCN013), or there would be more than 10 million (SCN021).
    """
    _check_speed(speed)
    clock = take.clock
    rate = exact(speed, "speed")
    fixed = clock.start if pivot is None else exact(pivot, "pivot")
    # All in frames of the take, 0 being its first.
    centre = (fixed - clock.start) / clock.step
    ends = sorted(centre + (edge - centre) / rate for edge in (0, clock.count - 1))
    low, high = math.ceil(ends[0]), math.floor(ends[1])
    if low > high:
        raise frame_refusal(f"at speed {speed:g} no frame of the take's grid is left")
    check_count(high - low + 1)
    index = np.arange(low, high + 1)
    places = even_places(index, centre / rate - centre, rate, clock.count)
    motion = take.motion.map(places.blend)
    return replace(
        take,
        clock=replace(clock, start=clock.start + low * clock.step, count=len(index)),
        motion=continuous(motion).map(Channel.compact),
    )


def _check_speed(speed: float) -> None:
    if not math.isfinite(speed) or speed == 0:
        message = f"speed is {speed}; it must be finite and not 0"
        raise OptionError(Fault("SCN016", message))


def _checks(options: TimeScaleOptions) -> OptionChecks:
    return {"speed": lambda: _check_speed(options.speed)}


def _run(take: Take, options: TimeScaleOptions, _: PassContext) -> Take:
    return time_scale(take, options.speed, options.pivot)


PASS = Pass(
    "time_scale",
    "Play at another speed",
    TimeScaleOptions,
    Scope.CLIP,
    _run,
    _checks,
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
)
