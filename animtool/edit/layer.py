"""Putting one take on top of another, added to it or in its place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.clock import time_codes
from animtool.edit.combine import (
    Strength,
    add,
    check_same_rig,
    continuous,
    mix,
    other_frames,
)
from animtool.edit.frames import exact
from animtool.edit.tree import joints_matching
from animtool.keyed import Interpolation, Weight, chosen, weights_at
from animtool.motion import Motion
from animtool.passes import (
    MOTION_PARTS,
    OptionChecks,
    Pass,
    PassContext,
    Scope,
    named_take,
)
from animtool.rig.skeleton import Rig
from animtool.take import Take, TakeStream


class LayerMode(StrEnum):
    """What a layer does to what is below it."""

    ADDITIVE = "additive"
    OVERRIDE = "override"


@dataclass(frozen=True, slots=True)
class LayerOptions:
    """What is put on top, where and how strongly.

    Attributes:
        take: File of the other take.
        mode: ``override`` blends towards the other take; ``additive`` adds it, and
            it must be a difference (see the pass of that name).
        weight: [1], one number or pairs ``[frame, weight]``; 0 to 1 for
            ``override``, any for ``additive``.
        interpolation: How a weight curve runs from pair to pair.
        joints: Names or patterns of the joints that change; none is all of them,
            and shapes and controls too.
        children: Take what is below these joints too.
        delay: By how much the other take starts later than this one [time code].
    """

    take: Path | None = None
    mode: LayerMode = LayerMode.OVERRIDE
    weight: float | tuple[tuple[float, float], ...] = 1.0
    interpolation: Interpolation = Interpolation.LINEAR
    joints: tuple[str, ...] = ()
    children: bool = False
    delay: float = 0.0


def layer(
    take: Take,
    other: Take,
    *,
    mode: LayerMode | str = LayerMode.OVERRIDE,
    weight: Weight = 1.0,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    joints: str | Sequence[str] = (),
    children: bool = False,
    delay: float = 0.0,
) -> Take:
    """Return a take with another on top, see `LayerOptions`.

    The result has the frames of ``take``. The other take starts with it, ``delay``
    later, is resampled to its rate and held at its own ends.

    Raises:
        OptionError: A joint is not in the rig (SCN012), a weight is not finite or
            out of bounds (SCN014), its curve malformed (SCN015), the rigs differ
            (SCN017), or a mode or interpolation is none (SCN025).
    """
    plan = _Plan(
        other,
        chosen(LayerMode, mode, "mode"),
        weight,
        chosen(Interpolation, interpolation, "interpolation"),
        _limited(take.rig, joints, children),
        delay,
    )
    return plan.over(TakeStream.of(take)).collect()


def _limited(rig: Rig, joints: str | Sequence[str], children: bool) -> list[int] | None:
    return joints_matching(rig, joints, children=children) if joints else None


@dataclass(frozen=True, slots=True)
class _Plan:
    other: Take
    mode: LayerMode
    weight: Weight
    interpolation: Interpolation
    joints: list[int] | None
    delay: float

    def over(self, stream: TakeStream) -> TakeStream:
        check_same_rig(stream.rig, self.other.rig)
        self._weights(time_codes(Fraction(1), Fraction(1), 1))
        return replace(stream, blocks=self._blocks(stream))

    def _weights(self, times: FloatArray) -> FloatArray:
        bounded = self.mode is LayerMode.OVERRIDE
        return weights_at(self.weight, times, self.interpolation, bounded=bounded)

    def _blocks(self, stream: TakeStream) -> Iterator[Motion]:
        start = Fraction(1) if stream.start is None else stream.start
        delay = exact(self.delay, "delay") / stream.step
        operation = mix if self.mode is LayerMode.OVERRIDE else add
        steady = isinstance(self.weight, (int, float))
        first, previous = 0, None
        for block in stream.blocks:
            begin = start + first * stream.step
            weights = self._weights(time_codes(begin, stream.step, block.frames))
            rate = stream.fps / stream.step
            above = other_frames(self.other, rate, first, block.frames, delay)
            strength = Strength(weights, steady, self.joints)
            motion = continuous(operation(block, above, strength), previous)
            yield motion
            first, previous = first + block.frames, motion.rotations.values[-1]


def _run(stream: TakeStream, options: LayerOptions, context: PassContext) -> TakeStream:
    plan = _Plan(
        context.take(options.take),
        chosen(LayerMode, options.mode, "mode"),
        options.weight,
        chosen(Interpolation, options.interpolation, "interpolation"),
        _limited(stream.rig, options.joints, options.children),
        options.delay,
    )
    return plan.over(stream)


def _checks(options: LayerOptions) -> OptionChecks:
    bounded = options.mode is LayerMode.OVERRIDE
    return {
        "take": lambda: named_take(options.take),
        "weight": lambda: weights_at(options.weight, np.zeros(0), bounded=bounded),
        "delay": lambda: exact(options.delay, "delay"),
    }


PASS = Pass(
    "layer",
    "Put another take on top",
    LayerOptions,
    Scope.FRAME,
    _run,
    _checks,
    changes=MOTION_PARTS,
)
