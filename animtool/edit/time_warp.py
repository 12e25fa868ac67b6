"""Retiming a take by a curve from its new frames to its old ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray
from animtool.clock import Clock
from animtool.edit.combine import continuous
from animtool.edit.frames import check_count, exact, frame_refusal
from animtool.edit.travel import nearby_places
from animtool.keyed import Interpolation, Keys, key_arrays, keyed
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
class TimeWarpOptions:
    """The curve of time.

    Attributes:
        curve: Pairs ``[frame of the result, frame of the take]``, the former
            ascending; none leaves the take as it is.
        interpolation: How time runs from pair to pair.
    """

    curve: tuple[tuple[float, float], ...] = ()
    interpolation: Interpolation = Interpolation.LINEAR


def time_warp(
    take: Take,
    curve: Keys,
    interpolation: Interpolation | str = Interpolation.LINEAR,
) -> Take:
    """Return the take retimed, from the curve's first frame to its last.

    The result has the frames of the take's own grid, carried on beyond its ends
    where the curve reaches there. The curve may go back in time or stand still.

    Args:
        take: F frames.
        curve: Pairs ``[frame of the result, frame of the take]``, time codes.
        interpolation: ``smooth`` never leaves the range of two neighbouring pairs.

    Raises:
        OptionError: The curve is malformed (SCN015), shows frames that the take has
            not or none of the grid (SCN013), or has too many (SCN021).
    """
    clock = take.clock
    times, values = key_arrays(curve, "curve")
    _check_inside(clock, values)
    low = math.ceil((exact(times[0], "curve") - clock.start) / clock.step)
    high = math.floor((exact(times[-1], "curve") - clock.start) / clock.step)
    if low > high:
        message = f"the curve from {times[0]:g} to {times[-1]:g} holds no whole frame"
        raise frame_refusal(message)
    check_count(high - low + 1)
    start, step = float(clock.start), float(clock.step)
    at = replace(clock, start=clock.start + low * clock.step, count=high - low + 1)
    shown = keyed(times, values, at.times, interpolation)
    motion = take.motion.map(nearby_places((shown - start) / step, clock.count).blend)
    return replace(take, clock=at, motion=continuous(motion).map(Channel.compact))


def _check_inside(clock: Clock, values: FloatArray) -> None:
    first, last = clock.times[[0, -1]] if clock.count else np.zeros(2)
    slack = 1e-6 * float(clock.step)
    outside = values[(values < first - slack) | (values > last + slack)]
    if len(outside):
        message = f"the curve shows frame {outside[0]:g}, and the take has "
        raise frame_refusal(f"{message}{first:g}-{last:g}")


def _run(take: Take, options: TimeWarpOptions, _: PassContext) -> Take:
    if not options.curve:
        return take
    return time_warp(take, options.curve, options.interpolation)


def _checks(options: TimeWarpOptions) -> OptionChecks:
    return {"curve": lambda: options.curve and key_arrays(options.curve, "curve")}


PASS = Pass(
    "time_warp",
    "Retime by a curve",
    TimeWarpOptions,
    Scope.CLIP,
    _run,
    _checks,
    reads=RETIMED_PARTS,
    changes=RETIMED_PARTS,
)
