"""What brings legs to where feet stand: hips that come down, knees that have stops."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.maths import so3
from animtool.retarget.feet import bend_at_pin, covering, upper
from animtool.rig.limits import RangeLimit


def test_what_covers_bends_less_than_a_window_of_the_most() -> None:
    rng = np.random.default_rng(3)
    values = np.where(rng.random(200) < 0.05, rng.random(200), -1.0)
    made = covering(values, 4.0)
    assert (made >= values - 1e-4).all()
    bends = [np.abs(np.diff(each, 2)).max() for each in (made, upper(values, 8.0))]
    assert bends[0] < 0.5 * bends[1]
    assert not covering(-np.ones(9), 4.0).any()


def test_what_covers_depends_on_what_is_near() -> None:
    values = np.full(200, -1.0)
    values[20] = 1.0
    assert np.abs(covering(values, 4.0)[100:]).max() < 1e-5
    values[150] = 0.5
    whole, part = covering(values, 4.0), covering(values[100:], 4.0)
    np.testing.assert_allclose(part[30:], whole[130:], atol=1e-5)


@pytest.mark.parametrize("far", [0.5, 0.9, 1.1])
def test_a_knee_at_its_stop_brings_the_ankle_as_near_as_it_can(far: float) -> None:
    """That is on the line from the hip to the goal, whether it reaches it or not."""
    bones = np.array([0.0, -0.5, 0.0]), np.array([0.0, -0.5, 0.0])
    limits = RangeLimit(np.radians(8.0), np.radians(150.0))
    goal, axis = np.array([[0.3 * far, -far, 0.1]]), np.array([1.0, 0.0, 0.0])
    hip, thigh = np.zeros((1, 3)), so3.IDENTITY[None]
    turn, bent = bend_at_pin(hip, goal, thigh, bones, axis, np.zeros(1), limits)
    assert limits.low <= bent[0] <= limits.high
    shin = so3.rotate(so3.from_axis_angle(axis, bent), bones[1])
    ankle = so3.rotate(turn, bones[0] + shin)
    assert np.linalg.norm(np.cross(ankle, goal)) < 1e-9
    if far < 0.9:
        np.testing.assert_allclose(ankle, goal, atol=1e-9)
