"""Numbers of shoulders, steps, reach and grids, each function by itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems.crowds.test_bodies import level, library

from animtool.maths import so3
from animtool.sim.colliders import Box, Collider, Plane, Poses, Sphere
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.bodies import AgentBodies, _gait_weights
from animtool.systems.crowds.footing import Footing, limit_landings
from animtool.systems.crowds.gaits import (
    rotations_about_x,
    sample_rows,
    standing_ankle,
    swing_progress,
)
from animtool.systems.crowds.ground import GroundFrame
from animtool.systems.crowds.obstacles import _obstacle_bounds, is_blocked
from animtool.systems.crowds.reach import (
    LegReach,
    Stances,
    _rate_for_margin,
    step_rates,
)
from animtool.systems.crowds.routes import NavGrid
from animtool.systems.crowds.shoulders import step_shoulders

TURNED = so3.exp(np.array([0.0, np.pi / 2, 0.0]))


def test_shoulders_turn_in_a_quarter_of_a_second_and_back_in_six_tenths() -> None:
    """Whoever turned to a side stays turned to it; what is hardly turned is not."""
    shoulders = np.array([0.0, 0.0, 0.9, 0.5, -0.2, 0.017, 0.017])
    pressed = np.array([1.0, -0.5, 0.0, 0.3, 1.0, 0.0, 0.01])
    target = np.array([0.9, -0.45, 0.0, 0.27, -0.9, 0.0, 0.009])
    time = np.array([0.25, 0.25, 0.6, 0.6, 0.25, 0.6, 0.6])
    expected = target + (shoulders - target) * np.exp(-0.1 / time)
    expected[5] = 0.0
    assert_allclose(step_shoulders(shoulders, pressed, 0.1), expected)


@pytest.mark.parametrize("columns", [3, 4])
def test_rows_between_rows_and_behind_the_last(columns: int) -> None:
    """Of quaternions the nearer of both that mean the same."""
    table = np.zeros((3, 2, columns))
    table[0, :, 0], table[1, :, 0], table[2, :, 0] = 1.0, -1.0, 0.5
    at = np.array([0.0, 0.25, 1.5, 2.5, 9.0])
    side = -1.0 if columns == 4 else 1.0
    quarter = 0.75 + side * -0.25
    half = -0.5 + side * 0.25
    found = sample_rows(table, at)[:, 1, 0]
    assert_allclose(found[:3], [1.0, quarter, half])
    assert_allclose(found[3], 0.5)
    again = sample_rows(table, at[:4], is_cyclic=True)[:, 0, 0]
    assert_allclose(again[3], 0.75)


def test_a_foot_that_stands_turns_about_its_ball_or_its_heel() -> None:
    walker: Any = SimpleNamespace(
        ankle_heights=np.array([0.1, 0.12]),
        ball_offsets=np.array([[0.01, -0.08, 0.15]] * 2),
    )
    up, down = 0.3, -0.2
    found = standing_ankle(walker, 1, rotations_about_x(np.array([up, down, 0.0])))
    sine, cosine = np.sin(up), np.cos(up)
    ball = [0.01, -0.08 * cosine - 0.15 * sine, 0.15 * cosine - 0.08 * sine]
    assert_allclose(found[0], [0.01 - ball[0], 0.04 - ball[1], 0.15 - ball[2]])
    assert_allclose(found[1], [0, 0.12 * np.cos(down), 0.12 * np.sin(down)])
    assert_allclose(found[2], [0, 0.12, 0], atol=1e-15)
    assert_allclose(
        swing_progress(np.array([0, 0.25, 0.5, 1])), [0, 0.103515625, 0.5, 1]
    )


@pytest.mark.parametrize(
    ("k", "other", "x"),
    [
        # Feet go 0.1 to either side of a body; 0.6 of 0.2 m is the least.
        (0, -0.1, 0.1), (0, -0.01, 0.11), (0, 0.05, 0.17), (0, 0.23, 0.35),
        (0, 0.25, 0.1), (1, 0.1, -0.1), (1, 0.01, -0.11), (1, -0.23, -0.35),
        (1, -0.25, -0.1),
    ],
)  # fmt: skip
@pytest.mark.parametrize("size", [1.0, 1.5])
def test_a_foot_lands_on_its_side_of_the_other_where_that_is_near(
    k: int, other: float, x: float, size: float
) -> None:
    """Of a body at (3, 4) that looks along x: its left is against z."""
    gaits: Any = SimpleNamespace(walker=SimpleNamespace(leg_length=1.0))
    steps = np.array([[[0.1, 0.3, 0.2], [-0.1, 0.25, -0.1]]])
    blend: Any = SimpleNamespace(steps=steps)
    own = Footing(gaits, np.array([size]), level)
    places = np.zeros((1, 2, 3))
    places[0, 1 - k, :2] = 3.0, 4.0 - size * other
    found = own.find_landings(
        k, blend, np.array([[3.0, 4.0]]), np.array([np.pi / 2]), places
    )
    ahead, yaw = steps[0, k, 1:]
    expected = [3 + size * ahead, 4 - size * x, np.pi / 2 + yaw]
    assert_allclose(found, [expected], atol=1e-12)


def test_where_a_foot_lands_follows_no_faster_than_it_can() -> None:
    """Halfway of a swing it moves by half: 2.5 m/s and 6 rad/s of it at most."""
    aims = np.zeros((4, 2, 3))
    lands = np.array([[0.3, 0.4, 0.0], [0.3, 0.4, 0.0], [0.03, 0.04, 2.0], [1, 1, -2]])
    swings = np.array([[0.5, 0], [0.5, 0], [0.5, 0], [0.0, 0]])
    new = np.array([False, True, False, False])
    scales = np.array([1.0, 1.0, 1.0, 2.0])
    found = limit_landings(aims, lands, swings, new, scales, 0.02, 0)
    assert_allclose(found[0], [0.06, 0.08, 0.0])
    assert_allclose(found[1], lands[1])
    assert_allclose(found[2], [0.03, 0.04, 0.24])
    # Who has not left the ground goes all the way.
    assert_allclose(found[3], lands[3])


def test_gaits_are_blended_by_how_far_points_are_along_the_ways_between() -> None:
    known = np.array([[1.0, 0.0], [3.0, 0.0], [1.0, 2.0]])
    points = np.array([[1.5, 0.0], [0.0, 0.0], [9.0, 0.0], [1.0, 1.0], [2.0, 1.0]])
    expected = [[0.75, 0.25, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0.5]]
    found = _gait_weights(points, known)
    assert_allclose(found[:4], expected)
    assert_allclose(found[4], [1 / 3, 1 / 3, 1 / 3])
    assert_array_equal(_gait_weights(points, known[:1]), np.ones((5, 1)))
    assert_allclose(_gait_weights(points[:1], known[[0, 0, 1]]).sum(), 1.0)


def reach() -> LegReach:
    """Return that of legs of 1 m, whose ankles are 0.1 m high where feet stand."""
    walker = SimpleNamespace(
        leg_length=1.0,
        ankle_heights=np.array([0.1, 0.1]),
        ball_offsets=np.zeros((2, 3)),
    )
    gaits: Any = SimpleNamespace(walker=walker)
    return LegReach(gaits, (), np.zeros((2, 3)))


def test_the_room_of_a_foot_is_what_its_leg_leaves() -> None:
    """Of hips that go down by 0.09 of a leg; in poses by 0.11 at most."""
    thighs = np.array([[0.0, 0.9, 0.0], [0.0, 1.0, 0.0], [0.0, 1.2, 0.0]])
    feet = np.array([[0.3, 0.0, 0.4, 0.5], [0.3, 0.0, -0.4, 0.0], [0.6, 0, 0, 0]])
    room, ways = reach().reach_margin(0, thighs, feet, np.zeros(3))
    low = np.array([0.8, 0.9, 1.1]) - 0.09
    far = np.sqrt(np.maximum(0.998**2 - low**2, 0))
    assert_allclose(room, far - [0.5, 0.5, 0.6])
    assert_allclose(ways, [[0.6, 0.8], [0.6, -0.8], [1, 0]])
    lowered = reach().hip_lowering(1, thighs, feet, np.zeros(3))
    need = 0.9 - np.sqrt(0.998**2 - 0.25)
    assert_allclose(lowered, [0.0, need, 0.11])
    assert 0 < need < 0.11


def test_a_leg_steps_before_its_room_ends() -> None:
    """Rooms of 0.5 and -0.1 m, at 1 m/s; turning over a foot; in the air too soon."""
    assert_allclose(
        _rate_for_margin(np.array([0.5, 0.01, 0.5]), 0.05, np.array([1.0, 1.0, -1.0])),
        [2, 20, 0],
    )
    one = reach()
    count = 6
    feet = np.zeros((count, 2, 4))
    feet[:, :, 0] = 0.2
    thighs = np.tile([0.0, 0.7, 0.0], (count, 2, 1))
    begins, stands = np.full((count, 2), 0.2), np.full((count, 2), 0.6)
    swings = np.zeros((count, 2), np.bool_)
    went, turning = np.zeros((count, 2)), np.zeros(count)
    far = np.sqrt(0.998**2 - 0.51**2) - 0.2
    went[0] = [-2.0, 0.0]  # the hips leave both feet
    went[1] = [2.0, 0.0]  # and come to them
    feet[2, 0, 3], turning[2] = 0.2, -1.0  # the left foot turned out, turns on
    feet[3, 0, 3], turning[3] = -0.2, 1.0  # turned in
    swings[4, 1] = True  # in the air before its stance ended
    feet[5, 1, 0] = 0.9  # out of reach
    pitches = np.zeros((2, count, 2))
    rate = np.full(count, 0.5)
    stances = Stances(begins, stands, swings, feet, thighs, pitches, rate)
    rates, ends = step_rates(one, stances, went, turning)
    expected = [2 / far * 0.4, 0.5, 1 / 0.4 * 0.4, 1 / 0.3 * 0.4, 2.5, 2.5]
    assert_allclose(rates, expected)
    assert ends.tolist() == [[False, False]] * 5 + [[False, True]]
    assert_array_equal(rate, np.full(count, 0.5))


def test_what_is_near_obstacles_is_looked_at() -> None:
    """A turned box, a ball and a floor; a wall without an end is near everything."""
    frame = GroundFrame(np.array([1.0, 5.0, 2.0]), TURNED)
    box = Collider(Box((2.0, 9.0, 1.0)), Poses.fixed((1.0, 5.0, 2.0), TURNED))
    ball = Collider(Sphere(0.5, (0.0, 1.0, 0.0)), Poses.fixed((1.0, 5.0, -1.0)))
    floor = Collider(Plane(), Poses.fixed((0.0, 0.0, 0.0)))
    low, high = np.full(2, -20.0), np.full(2, 20.0)
    first, last = _obstacle_bounds([box, ball, floor], frame, low, high, 0.25)
    # The ball is 3 m against z of the world, which is along x of the ground.
    assert_allclose(first, [-1.25, -0.75])
    assert_allclose(last, [3.75, 0.75])
    cut = _obstacle_bounds(
        [box], frame, np.array([-1.0, -9]), np.array([9.0, 0.1]), 0.25
    )
    assert_allclose(cut, [[-1.0, -0.75], [1.25, 0.1]])
    for normal in ((1.0, 0.0, 0.0), (0.5, 0.9, 0.0)):
        wall = Collider(Plane(normal), Poses.fixed((0.0, 0.0, 0.0), TURNED))
        assert_array_equal(
            _obstacle_bounds([wall], frame, low, high, 0.25), [low, high]
        )
    slope = Collider(Plane((0.2, 0.9, 0.0)), Poses.fixed((0.0, 0.0, 0.0)))
    first, last = _obstacle_bounds([slope], frame, low, high, 0.0)
    assert not (first < last).any()


def test_who_is_off_the_grid_is_lost() -> None:
    free = np.array([[True, False], [True, True]])
    grid = NavGrid(np.zeros(2), 1.0, free)
    x = np.array([[0.0, 0.1], [0.1, 0.9], [1.0, 1.0], [-9.0, 0.0]])
    assert is_blocked(grid, x).tolist() == [False, True, False, False]


@pytest.mark.slow
def test_agents_stand_as_the_first_clip_that_stands() -> None:
    """Of two that do; and react as the first that is neither a step nor a stand."""
    one, other = (
        library("walk", "stand", "stumble"),
        library("walk", "wave", "stand"),
    )
    assert [one.idle.name, other.idle.name] == ["stand", "wave"]


def test_a_step_leaves_the_state_before_as_it_was() -> None:
    bodies = AgentBodies(library("walk", "stand"), np.ones(2), level)
    x = np.zeros((2, 2))
    before = AgentMotion(x, x, np.array([0.0, 1.0]))
    state = bodies.initial_state(before, np.array([0.1, 0.6]))
    for k in range(12):
        v = np.tile([0.0, 1.0], (2, 1))
        after = AgentMotion(before.points + 0.1 * v, v, before.headings)
        kept = {name: getattr(state, name).copy() for name in type(state).__slots__}
        made = bodies.advance(state, before, after, 0.1, np.array([k == 3, False]))
        for name, values in kept.items():
            assert_array_equal(getattr(state, name), values)
        assert not np.shares_memory(made.aims, state.aims)
        state, before = made, after
    assert (state.swings >= 0).any()
