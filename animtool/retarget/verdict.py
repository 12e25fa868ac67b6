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
from animtool.core.shot import FrameRange
from animtool.maths.runs import merge_runs, runs
from animtool.motion.scores import PassScores

# Scores above this multiple of a good take's value need a look [1].
CHECK_FACTOR = 3.0
# Mean limb deviation from the source above which it is another motion [rad].
MAX_LIMB_DEVIATION = np.radians(30.0)
# Runs of frames nearer to each other than this are joined [frames].
MAX_JOINED_GAP = 4
# Size ratios that a child, a giant or a doll explains; beyond these, a wrong unit is
# more likely, since units mostly differ by a factor of 10 or more.
LIKELY_SCALES = (1 / 9, 9.0)


def is_likely_scale(scale: float) -> bool:
    """Return whether the sizes of rig and take are too similar for different units."""
    smallest, largest = LIKELY_SCALES
    return smallest <= scale <= largest


class TakeStatus(StrEnum):
    """Whether a retargeted take is good, needs a check, or is unusable."""

    GOOD = "good"
    LOOK = "check these frames"
    UNUSABLE = "not usable"


@dataclass(frozen=True, slots=True)
class FrameNumbers:
    """Frame numbering of an output.

    Attributes:
        start: Number of the first frame.
        step: Increment between frames of the take.
        frames: Numbers in the output; None uses all of the take.

    >>> ten = FrameRange(1001, 1010)
    >>> FrameNumbers(Fraction(1001), Fraction(1, 5), ten).numbers_of_run(48, 60)
    (1010, 1010)
    """

    start: Fraction = Fraction(1)
    step: Fraction = Fraction(1)
    frames: FrameRange | None = None

    def numbers_of_run(self, first: int, last: int) -> tuple[int, int] | None:
        """Return the output frame numbers of a run of frames; None if all are cut."""
        first_number = math.floor(self.start + first * self.step)
        last_number = math.ceil(self.start + last * self.step)
        if self.frames is not None:
            first_number = max(first_number, self.frames.first)
            last_number = min(last_number, self.frames.last)
        return (first_number, last_number) if first_number <= last_number else None


@dataclass(frozen=True, slots=True)
class VerdictReason:
    """A reason to check a take.

    Attributes:
        what: The score, or the fault.
        text: The value with its unit; empty if there is no value.
        frames: First and last index of each run of frames; empty if it concerns all.
    """

    what: str
    text: str = ""
    frames: tuple[tuple[int, int], ...] = ()

    def in_output_frames(self, numbers: FrameNumbers) -> VerdictReason | None:
        """Return the reason with an output's frame numbers; None if all are cut."""
        if not self.frames:
            return self
        spans = [numbers.numbers_of_run(first, last) for first, last in self.frames]
        frames = tuple(span for span in spans if span is not None)
        return replace(self, frames=frames) if frames else None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a take is usable, and why not, worst reason first."""

    status: TakeStatus
    reasons: tuple[VerdictReason, ...] = ()
    json_keys: ClassVar[str] = "verdict=status look_at=reasons{what value=text frames}"

    def in_output_frames(self, numbers: FrameNumbers) -> Verdict:
        """Return the verdict on the frames of an output, in its numbering."""
        output_reasons = [reason.in_output_frames(numbers) for reason in self.reasons]
        reasons = tuple(reason for reason in output_reasons if reason is not None)
        is_good = self.status is TakeStatus.LOOK and not reasons
        return Verdict(TakeStatus.GOOD if is_good else self.status, reasons)

    def with_reasons(self, reasons: Sequence[VerdictReason]) -> Verdict:
        """Return the verdict with further reasons; a good take then needs a check."""
        if not reasons:
            return self
        is_unusable = self.status is TakeStatus.UNUSABLE
        status = TakeStatus.UNUSABLE if is_unusable else TakeStatus.LOOK
        return Verdict(status, (*self.reasons, *reasons))


def assess_take(
    scores: PassScores,
    values_by_score: Mapping[str, FloatArray],
    source_value_by_score: Mapping[str, float],
    ignored_errors: Sequence[Fault] = (),
) -> Verdict:
    """Return whether a take is usable, and which scores and frames to check.

    ``scores`` are those of the full take; ``values_by_score`` ``(F,)`` are per frame,
    of scores that vary, and ``source_value_by_score`` those of the source, where they
    can be measured. Ignored errors were accepted on request.
    """
    if ignored_errors:
        error_reasons = tuple(VerdictReason(fault.message) for fault in ignored_errors)
        return Verdict(TakeStatus.UNUSABLE, error_reasons)
    scores_by_name = {score.name: score for score in scores.scores}
    limb_score = scores_by_name["limbs"]
    if limb_score.value > MAX_LIMB_DEVIATION:
        return Verdict(TakeStatus.UNUSABLE, (VerdictReason("limbs", limb_score.text),))
    reasons: list[tuple[float, VerdictReason]] = []
    for score in scores.scores:
        bound = score.ideal + CHECK_FACTOR * (score.usual - score.ideal)
        source_value = source_value_by_score.get(score.name, math.nan)
        if not math.isnan(source_value):
            bound = max(bound, source_value)
        if score.value > bound:
            is_above_bound = values_by_score.get(score.name, np.zeros(0)) > bound
            frames = merge_runs(runs(is_above_bound), MAX_JOINED_GAP)
            spans = tuple((first, end - 1) for first, end in frames)
            reason = VerdictReason(score.name, score.text, spans)
            reasons.append((score.excess, reason))
    reasons.sort(key=lambda excess_and_reason: -excess_and_reason[0])
    status = TakeStatus.LOOK if reasons else TakeStatus.GOOD
    return Verdict(status, tuple(reason for _, reason in reasons))
