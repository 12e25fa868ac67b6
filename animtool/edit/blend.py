"""Blending from one take to another."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from animtool.edit.combine import (
    Strength,
    check_same_rig,
    continuous,
    mix,
    other_frames,
)
from animtool.edit.frames import check_count, exact
from animtool.keyed import Interpolation, Weight, weights_at
from animtool.motion import Channel
from animtool.passes import (
    MOTION_PARTS,
    OptionChecks,
    Pass,
    PassContext,
    Scope,
    named_take,
)
from animtool.take import Take


@dataclass(frozen=True, slots=True)
class BlendOptions:
    """What is blended with, and when.

    Attributes:
        take: File of the other take.
        weight: Of the other take [1], one number or pairs ``[frame, weight]``.
        interpolation: How a weight curve runs from pair to pair.
        delay: By how much the other take starts later than this one [time code].
    """

    take: Path | None = None
    weight: float | tuple[tuple[float, float], ...] = 0.5
    interpolation: Interpolation = Interpolation.LINEAR
    delay: float = 0.0


def blend(
    take: Take,
    other: Take,
    *,
    weight: Weight = 0.5,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    delay: float = 0.0,
) -> Take:
    """Return the weighted mean of two takes, on the clock of the first.

    The result lasts from the first frame of ``take`` to the end of the later of
    the two; each is held at its ends. The other starts ``delay`` later.

    Raises:
        OptionError: A weight is not finite or not from 0 to 1 (SCN014), its curve
            malformed (SCN015), the rigs differ (SCN017), or there would be too many
            frames (SCN021).
    """
    check_same_rig(take.rig, other.rig)
    clock = take.clock
    late = exact(delay, "delay") / clock.step
    length = (other.clock.count - 1) * clock.rate / other.clock.rate
    count = max(clock.count, 1 + math.floor(late + length))
    check_count(count)
    whole = replace(clock, count=count)
    weights = weights_at(weight, whole.times, interpolation)
    strength = Strength(weights, isinstance(weight, (int, float)))
    one = other_frames(take, clock.rate, 0, count)
    two = other_frames(other, clock.rate, 0, count, late)
    motion = continuous(mix(one, two, strength)).map(Channel.compact)
    return replace(take, clock=whole, motion=motion)


def _run(take: Take, options: BlendOptions, context: PassContext) -> Take:
    return blend(
        take,
        context.take(options.take),
        weight=options.weight,
        interpolation=options.interpolation,
        delay=options.delay,
    )


def _checks(options: BlendOptions) -> OptionChecks:
    return {
        "take": lambda: named_take(options.take),
        "weight": lambda: weights_at(options.weight, np.zeros(0)),
        "delay": lambda: exact(options.delay, "delay"),
    }


PASS = Pass(
    "blend",
    "Blend with another take",
    BlendOptions,
    Scope.CLIP,
    _run,
    _checks,
    changes=MOTION_PARTS,
)
