"""Times outside the keys of a curve: held, continued, repeated or mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from animtool._types import FloatArray


class Extrapolation(StrEnum):
    """How a curve goes on before its first key or behind its last."""

    HOLD = "hold"
    LINEAR = "linear"
    CYCLE = "cycle"
    CYCLE_OFFSET = "cycle_offset"
    OSCILLATE = "oscillate"


@dataclass(frozen=True, slots=True)
class Folded:
    """Times brought into the range of the keys, and what that left over.

    Attributes:
        times: Within the range ``(F,)``.
        beyond: Time before (negative) or behind the range, where the curve goes on
            linearly; else 0 ``(F,)``.
        cycles: Whole cycles before (negative) or behind the range, where each adds
            the curve's rise; else 0 ``(F,)``.
    """

    times: FloatArray
    beyond: FloatArray
    cycles: FloatArray


def fold(
    times: FloatArray,
    start: float,
    end: float,
    pre: Extrapolation = Extrapolation.HOLD,
    post: Extrapolation = Extrapolation.HOLD,
) -> Folded:
    """Bring times into ``start`` to ``end``.

    A time that is a whole number of cycles away belongs to the cycle nearer to the
    range: behind it the value is the last key's, before it the first key's. A range
    without length is held.

    >>> fold(np.array([-1.0, 4.0, 5.0]), 0.0, 4.0, post=Extrapolation.CYCLE).times
    array([0., 4., 1.])
    """
    inside = np.clip(times, start, end)
    beyond, cycles = np.zeros(times.shape), np.zeros(times.shape)
    length = end - start
    for before, mode, edge in ((True, pre, start), (False, post, end)):
        outside = times < start if before else times > end
        if mode is Extrapolation.HOLD or not outside.any():
            continue
        away = np.abs(times[outside] - edge)
        if mode is Extrapolation.LINEAR:
            beyond[outside] = -away if before else away
        elif length > 0:
            turns = np.ceil(away / length)
            left = turns * length - away  # to the far edge of that cycle
            mirrored = (mode is Extrapolation.OSCILLATE) & (turns % 2 == 1)
            from_start = np.where(mirrored ^ before, left, length - left)
            inside[outside] = np.clip(start + from_start, start, end)
            if mode is Extrapolation.CYCLE_OFFSET:
                cycles[outside] = -turns if before else turns
    return Folded(inside, beyond, cycles)
