"""What is said of a take on its rig, and in which frames."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from animtool.core.errors import Fault
from animtool.core.shot import FrameRange
from animtool.motion.scores import PassScores, Score, ScoreUnit
from animtool.retarget.verdict import FrameNumbers, TakeStatus, assess_take


def scores(drift: float = 0.0, limbs: float = 0.0) -> PassScores:
    return PassScores(
        (
            Score("drift", drift, ScoreUnit.LENGTH, 1e-3),
            Score("limbs", limbs, ScoreUnit.ANGLE, 0.05),
        )
    )


def test_a_good_take_is_good() -> None:
    for own in (scores(), scores(0.002, 0.1), scores(math.nan, math.nan)):
        assert assess_take(own, {}, {}).status is TakeStatus.GOOD


def test_frames_to_look_at_are_in_runs() -> None:
    drift = np.zeros(60)
    drift[[10, 11, 13, 40]] = 0.02
    found = assess_take(scores(0.02), {"drift": drift}, {})
    assert found.status is TakeStatus.LOOK
    (reason,) = found.reasons
    assert (reason.what, reason.frames) == ("drift", ((10, 13), (40, 40)))
    # As much as the source itself drifts is no fault of the retargeting.
    assert assess_take(scores(0.02), {}, {"drift": 0.03}).status is TakeStatus.GOOD


def test_what_is_not_the_motion_is_not_usable() -> None:
    assert assess_take(scores(limbs=1.0), {}, {}).status is TakeStatus.UNUSABLE
    forced = assess_take(scores(), {}, {}, [Fault("MAP010", "too little")])
    assert (forced.status, forced.reasons[0].what) == (
        TakeStatus.UNUSABLE,
        "too little",
    )


@pytest.mark.parametrize(
    ("numbers", "runs"),
    [
        (FrameNumbers(), ((11, 14), (41, 41))),
        (FrameNumbers(Fraction(1001), Fraction(1, 2)), ((1006, 1008), (1021, 1021))),
        (FrameNumbers(frames=FrameRange(12, 20)), ((12, 14),)),
    ],
)
def test_frames_are_numbered_as_in_the_output(
    numbers: FrameNumbers, runs: tuple[tuple[int, int], ...]
) -> None:
    drift = np.zeros(60)
    drift[[10, 13, 40]] = 0.02
    drift[11:13] = 0.02
    found = assess_take(scores(0.02), {"drift": drift}, {}).in_output_frames(numbers)
    assert found.reasons[0].frames == runs
    outside = assess_take(scores(0.02), {"drift": drift}, {}).in_output_frames(
        FrameNumbers(frames=FrameRange(100, 120))
    )
    assert outside.status is TakeStatus.GOOD
