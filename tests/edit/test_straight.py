"""By how much straight lines between frames may be off."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from animtool.core.clock import Clock
from animtool.edit.between import TakeSampler
from animtool.edit.resample import resampled
from animtool.edit.retiming import time_scale, time_warp
from animtool.edit.straight import interpolation_deviations
from animtool.edit.travel import even_positions
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig

RIG = Rig("two", (Joint("hips", -1), Joint("arm", 0, translation=(0.0, 1.0, 0.0))))


def swinging(frames: int = 49, *, still: bool = False) -> Take:
    """Return hips that go to and fro by 0.2 m, and an arm that turns by 40°."""
    phase = np.zeros(frames) if still else np.arange(frames) * np.pi / 12
    moves = np.zeros((frames, 2, 3))
    moves[:, 0, 0], moves[:, 1, 1] = 0.2 * np.sin(phase), 1.0
    turns = np.tile(so3.IDENTITY, (frames, 2, 1))
    turns[:, 1] = so3.from_axis_angle([1, 0, 0], np.radians(40) * np.sin(phase))
    motion = Motion(Channel.from_dense(moves), Channel.from_dense(turns))
    return Take(RIG, Clock(Fraction(24), Fraction(1), Fraction(1), frames), motion)


def test_the_estimate_is_the_error_of_a_sine() -> None:
    places = even_positions(np.arange(96), 0, Fraction(1, 2), 49)
    errors = {
        e.channel: e
        for e in interpolation_deviations(TakeSampler.from_take(swinging()), places)
    }
    # Halfway between two frames about a peak.
    drop = 1 - np.cos(np.pi / 24)
    assert errors["translations"].size == pytest.approx(0.2 * drop, rel=0.02)
    assert errors["rotations"].size == pytest.approx(np.radians(40) * drop, rel=0.02)
    assert errors["translations"].row == 0
    assert errors["rotations"].row == 1


@pytest.mark.parametrize(
    ("frames", "still", "said"), [(49, False, 1), (49, True, 0), (2, False, 0)]
)
def test_it_is_said_of_what_moves(frames: int, still: bool, said: int) -> None:
    take = swinging(frames, still=still)
    for shown in (
        resampled(take, 50),
        time_scale(take, 0.3),
        time_warp(take, [(1, 1), (3.5, frames)]),
    ):
        codes = [notice.code for notice in shown.notices]
        assert codes.count("TAKE007") == said


def test_it_is_not_said_on_frames_nor_where_nobody_sees_it() -> None:
    take = swinging()
    for shown in (time_scale(take, 2), time_scale(take, -1, 49), resampled(take, 12)):
        assert not shown.notices
    fine = replace(take, clock=replace(take.clock, fps=Fraction(240)))
    assert resampled(fine, 480).notices
    slow = swinging(2001)
    moves = slow.motion.translations
    slow = replace(
        slow,
        motion=replace(
            slow.motion,
            translations=replace(moves, values=moves.values * 1e-3),
            rotations=Channel.static(RIG.rest_rotations, 2001),
        ),
    )
    for shown in (resampled(slow, 50), resampled(take, 50, smooth=True)):
        assert "TAKE007" not in [notice.code for notice in shown.notices]
