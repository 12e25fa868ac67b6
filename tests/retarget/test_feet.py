"""What brings legs to where feet stand: hips that come down, knees that have stops."""

from __future__ import annotations

import numpy as np
import pytest
from support.feet import foot

from animtool.maths import so3
from animtool.motion.contacts import FootContacts
from animtool.retarget.bending import bend_at_pin
from animtool.retarget.feet import (
    _foot_weight,
    _pinned_path,
    _planted_rotations,
    smooth_cover,
    upper_envelope,
)
from animtool.rig.limits import RangeLimit


def test_what_covers_bends_less_than_a_window_of_the_most() -> None:
    rng = np.random.default_rng(3)
    values = np.where(rng.random(200) < 0.05, rng.random(200), -1.0)
    made = smooth_cover(values, 4.0)
    assert (made >= values - 1e-4).all()
    bends = [
        np.abs(np.diff(each, 2)).max() for each in (made, upper_envelope(values, 8.0))
    ]
    assert bends[0] < 0.5 * bends[1]
    assert not smooth_cover(-np.ones(9), 4.0).any()


def test_what_covers_depends_on_what_is_near() -> None:
    values = np.full(200, -1.0)
    values[20] = 1.0
    assert np.abs(smooth_cover(values, 4.0)[100:]).max() < 1e-5
    values[150] = 0.5
    whole, part = smooth_cover(values, 4.0), smooth_cover(values[100:], 4.0)
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


def test_a_foot_carries_all_where_the_take_cuts_its_stance_off() -> None:
    """Within a take weight comes and goes over 0.15 s: 3 frames at 20 a second."""
    third, more = 17 / 81, 64 / 81  # of t³ (10 - 15 t + 6 t²)
    stands = np.zeros(40, np.bool_)
    stands[:8] = stands[14:24] = stands[33:] = True
    found = _foot_weight(stands, 20.0)
    np.testing.assert_allclose(found[5:9], [more, third, 0, 0])
    np.testing.assert_allclose(found[:5], 1)
    inside = [0, third, more, 1, 1, 1, 1, more, third, 0]
    np.testing.assert_allclose(found[14:24], inside)
    np.testing.assert_allclose(found[33:36], [0, third, more])
    np.testing.assert_allclose(found[36:], 1)
    np.testing.assert_allclose(_foot_weight(np.ones(9, np.bool_), 20.0), 1)
    # A stance of four frames has two of them to come and two to go.
    stands = np.array([0, 0, 1, 1, 1, 1, 0, 0], np.bool_)
    np.testing.assert_allclose(_foot_weight(stands, 20.0)[2:6], [0, 0.5, 0.5, 0])


@pytest.mark.parametrize(("lean", "kept"), [(10.0, 0.0), (-19.0, 0.0), (25.0, 25.0)])
def test_soles_are_level_but_where_they_lean_far(lean: float, kept: float) -> None:
    """Up to 20 degrees a flat foot is put level; its heading stays as it is."""
    heading = so3.from_axis_angle([0.0, 1.0, 0.0], np.radians(40.0))
    leans = so3.from_axis_angle([1.0, 0.0, 0.0], np.radians([lean] * 6))
    turns = so3.multiply(heading, leans)
    found = _planted_rotations(foot(6, rotation=turns), 30.0, 1)
    expected = so3.from_axis_angle([1.0, 0.0, 0.0], np.radians(kept))
    expected = so3.multiply(heading, expected)
    assert so3.angle_between(found, expected).max() < 1e-9


@pytest.mark.parametrize(("above", "high"), [(0.04, 0.0), (0.05, 0.05), (0.2, 0.2)])
def test_who_kneels_stands_on_toes_that_have_no_joint(
    above: float, high: float
) -> None:
    """Above a twentieth of its leg an ankle stays as far above where it stands."""
    one = foot(8, height_change=np.full(8, above))
    ankle = np.tile([0.3, 0.4, 0.1], (8, 1)) + np.linspace(-0.01, 0.01, 8)[:, None]
    found = _pinned_path(ankle, np.zeros((8, 3)), one, 30.0, 1)
    np.testing.assert_allclose(found, np.tile([0.3, 0.08 + high, 0.1], (8, 1)))


def test_a_heel_that_stands_alone_goes_with_the_nearest_frame_of_the_whole_foot() -> (
    None
):
    """Its toe stands 0.12 m ahead of it when both stand, and is off it before."""
    heel = np.array([1] * 9, np.bool_)
    toe = np.array([0, 0, 1, 1, 1, 1, 0, 0, 0], np.bool_)
    bone = np.zeros((9, 3))
    bone[:, 2] = [0.5, 0.5, 0.10, 0.12, 0.12, 0.14, 0.5, 0.5, 0.5]
    one = foot(9, FootContacts(heel, toe, 0.08))
    found = _pinned_path(np.tile([0.0, 0.5, 1.0], (9, 1)), bone, one, 30.0, 1)
    # The toe stays at 1.12: the ankle is behind it by the bone.
    behind = [0.10, 0.10, 0.10, 0.12, 0.12, 0.14, 0.14, 0.14, 0.14]
    np.testing.assert_allclose(found[:, 2], 1.12 - np.array(behind))
    # Between two stances of the whole foot with the nearer one, in doubt the first.
    toe = np.array([1, 1, 0, 0, 0, 1, 1, 1, 1], np.bool_)
    bone[:, 2] = [0.1, 0.1, 0.5, 0.5, 0.5, 0.13, 0.13, 0.13, 0.13]
    one = foot(9, FootContacts(heel, toe, 0.08))
    found = _pinned_path(np.tile([0.0, 0.5, 1.0], (9, 1)), bone, one, 30.0, 1)
    behind = [0.1, 0.1, 0.1, 0.1, 0.13, 0.13, 0.13, 0.13, 0.13]
    np.testing.assert_allclose(found[:, 2], 1.12 - np.array(behind))


def test_a_knee_bends_the_way_that_its_stops_let_it() -> None:
    """The other way is nearer to its angle of -10 degrees, and beyond the stop.

    Without stops it bends the way that it is bent already.
    """
    bone, axis = np.array([0.0, -0.5, 0.0]), np.array([1.0, 0.0, 0.0])
    goal, hip = np.array([[0.0, -0.8, 0.0]]), np.zeros((1, 3))
    wide = 2 * np.arccos(0.8)
    thigh = so3.IDENTITY[None]
    for degrees, limits, expected in (
        (-10.0, None, -wide),
        (10.0, None, wide),
        (-10.0, RangeLimit(np.radians(-5.0), np.radians(150.0)), wide),
        (-10.0, RangeLimit(np.radians(-150.0), np.radians(5.0)), -wide),
    ):
        angle = np.radians([degrees])
        turn, bent = bend_at_pin(hip, goal, thigh, (bone, bone), axis, angle, limits)
        np.testing.assert_allclose(bent, expected)
        shin = so3.rotate(so3.from_axis_angle(axis, bent), bone)
        np.testing.assert_allclose(so3.rotate(turn, bone + shin), goal, atol=1e-12)
