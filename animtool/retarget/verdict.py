"""Verdict on a retargeted take: whether it is usable, and which frames to check."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from fractions import Fraction
from typing import ClassVar

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths.runs import merge_runs, runs
from animtool.motion.scores import PassScores, Score

# Scores above this multiple of a good take's value need a look [1].
LOOK = 3.0
# Limbs farther off the source's on average are another motion [rad].
UNLIKE = np.radians(30.0)
# Runs of frames nearer to each other are joined [frames].
NEAR = 4


class TakeStatus(StrEnum):
    """What to do with a take."""

    GOOD = "good"
    LOOK = "check these frames"
    UNUSABLE = "not usable"


@dataclass(frozen=True, slots=True)
class FrameNumbers:
    """Frame numbering of an output.

    Attributes:
        start: Number of the first.
        step: From one frame of the take to the next.
        first: First that the output has; None is that of the take.
        last: Likewise.

    >>> FrameNumbers(Fraction(1001), Fraction(1, 5), 1001, 1010).run(48, 60)
    (1010, 1010)
    """

    start: Fraction = Fraction(1)
    step: Fraction = Fraction(1)
    first: int | None = None
    last: int | None = None

    def run(self, first: int, last: int) -> tuple[int, int] | None:
        """Return output numbers of a run of frames from 0; None if all are cut."""
        low = math.floor(self.start + first * self.step)
        high = math.ceil(self.start + last * self.step)
        low = low if self.first is None else max(low, self.first)
        high = high if self.last is None else min(high, self.last)
        return (low, high) if low <= high else None


@dataclass(frozen=True, slots=True)
class VerdictReason:
    """Why a take needs a look.

    Attributes:
        what: The score, or the fault.
        text: Its value with unit; empty for none.
        frames: First and last frames concerned, from 0; empty if it is
            everywhere.
    """

    what: str
    text: str = ""
    frames: tuple[tuple[int, int], ...] = ()

    def numbered(self, numbers: FrameNumbers) -> VerdictReason | None:
        """Return it with an output's frame numbers; None if they are all cut."""
        if not self.frames:
            return self
        runs = [numbers.run(first, last) for first, last in self.frames]
        frames = tuple(run for run in runs if run is not None)
        return replace(self, frames=frames) if frames else None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a take is usable, and why not, worst reason first."""

    status: TakeStatus
    reasons: tuple[VerdictReason, ...] = ()
    json_keys: ClassVar[str] = "verdict=status look_at=reasons{what value=text frames}"

    def numbered(self, numbers: FrameNumbers) -> Verdict:
        """Return the verdict on the frames of an output, in its numbering."""
        numbered = [reason.numbered(numbers) for reason in self.reasons]
        reasons = tuple(reason for reason in numbered if reason is not None)
        good = self.status is TakeStatus.LOOK and not reasons
        return Verdict(TakeStatus.GOOD if good else self.status, reasons)


def verdict_of(
    scores: PassScores,
    values: Mapping[str, FloatArray],
    least: Mapping[str, float],
    forced: Sequence[Fault] = (),
) -> Verdict:
    """Return whether a take is usable.

    Args:
        scores: Of the full take.
        values: Per-frame values of some of them ``(F,)``.
        least: Values of the source itself for some of them.
        forced: Errors ignored on request.
    """
    if forced:
        why = tuple(VerdictReason(fault.message) for fault in forced)
        return Verdict(TakeStatus.UNUSABLE, why)
    by_name = {score.name: score for score in scores.scores}
    limbs = by_name["limbs"]
    if limbs.value > UNLIKE:
        return Verdict(TakeStatus.UNUSABLE, (VerdictReason("limbs", limbs.text),))
    worse = [(s, _bound(s, least.get(s.name, math.nan))) for s in scores.scores]
    worse = [(score, bound) for score, bound in worse if score.value > bound]
    worse.sort(key=lambda each: -each[0].excess)
    reasons = tuple(
        VerdictReason(score.name, score.text, _runs(values, score.name, bound))
        for score, bound in worse
    )
    return Verdict(TakeStatus.LOOK if reasons else TakeStatus.GOOD, reasons)


def _bound(score: Score, least: float) -> float:
    """Return the value above which a score needs a look."""
    bound = score.ideal + LOOK * (score.usual - score.ideal)
    return bound if math.isnan(least) else max(bound, least)


def _runs(
    values: Mapping[str, FloatArray], name: str, bound: float
) -> tuple[tuple[int, int], ...]:
    """Return first and last frames of runs in which a score exceeds a bound."""
    samples = values.get(name)
    if samples is None:
        return ()
    near = merge_runs(runs(samples > bound), NEAR)
    return tuple((first, end - 1) for first, end in near)
