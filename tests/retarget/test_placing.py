"""Feet, legs and hands that are put where they are to be, in numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.feet import foot

from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.contacts import FootContacts
from animtool.retarget.bending import bend_limb, shortest_rotations
from animtool.retarget.feet import (
    _ankle_rise,
    _ankle_to_toe,
    _heading_rotation,
    _hip_lift,
    _hip_shifts,
    _local_maxima,
    _raise_above_ground,
    _smooth_step,
    _toe_height,
    _toe_roll,
    fill_between,
    plant_feet,
    smooth_path_to_targets,
    upper_envelope,
)
from animtool.retarget.hands import (
    AnkleHeights,
    _are_hands_joined,
    _arm_length,
    _shift_into_reach,
    _soften_heights,
    arm_joints,
    elbow_hinge,
)
from animtool.retarget.legs import (
    _leg_reach,
    _planted_ankle_height,
    ball_of_foot,
    leg_joints,
    limb_rotations,
    swivel_leg,
    up_index,
)
from animtool.retarget.props import PropMotion
from animtool.retarget.roled_skeleton import Ball, RoledSkeleton
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

X, Y, Z = np.eye(3)


def turn(axis: np.ndarray, degrees: float) -> np.ndarray:
    return so3.from_axis_angle(axis, np.radians(degrees))


def test_the_way_that_is_best_at_once_solves_its_equations() -> None:
    """Of weights, places and bends; of fewer than three frames nobody bends."""
    rng = np.random.default_rng(2)
    draw, places = rng.random(7), rng.normal(size=(7, 2))
    bends = np.diff(np.eye(7), 2, axis=0)
    system = np.diag(draw + 1e-6) + 3.0 * bends.T @ bends
    assert_allclose(
        smooth_path_to_targets(draw, places, 3.0), np.linalg.solve(system, places)
    )
    assert not smooth_path_to_targets(0 * draw, places, 3.0).any()
    assert not smooth_path_to_targets(draw[:2], places[:2], 3.0).any()
    three = np.diag(draw[:3] + 1e-6) + 3.0 * np.outer([1, -2, 1], [1, -2, 1])
    found = smooth_path_to_targets(draw[:3], places[:3], 3.0)
    assert_allclose(found, np.linalg.solve(three, places[:3]))


def test_what_is_not_known_fades_to_nothing_from_what_is() -> None:
    values = np.zeros((60, 1))
    known = np.zeros(60, np.bool_)
    known[[0, 1, 30]] = True
    values[known, 0] = [1.0, 1.0, -2.0]
    fill_between(values, known, 30.0)
    assert_allclose(values[known, 0], [1, 1, -2])
    draw = np.where(known, 1e9, 1.0)
    bends = np.diff(np.eye(60), 2, axis=0)
    system = np.diag(draw + 1e-6) + (0.06 * 30) ** 4 * bends.T @ bends
    full = np.zeros(60)
    full[known] = np.array([1, 1, -2]) * 1e9
    assert_allclose(values[:, 0], np.linalg.solve(system, full), atol=1e-6)
    same = np.arange(5.0)[:, None]
    fill_between(same, np.ones(5, np.bool_), 30.0)
    fill_between(same, np.zeros(5, np.bool_), 30.0)
    assert_array_equal(same[:, 0], np.arange(5))


def test_steps_and_peaks_and_what_is_above_a_window() -> None:
    assert_allclose(_smooth_step(np.array([-1, 0, 0.5, 1, 2])), [0, 0, 0.5, 1, 1])
    assert _smooth_step(np.array([0.25])) == pytest.approx(0.103515625)
    rows = np.array([3.0, 1, 2, 2, 1, -1, -0.5, -2, 0, 4])
    expected = [True, False, True, True, False, False, False, False, False, True]
    assert _local_maxima(rows).tolist() == expected
    found = upper_envelope(np.array([0.0, 0, 0, 1, 0, 0, 0]), 1.5, 0.0)
    assert found.tolist() == [0, 1, 1, 1, 1, 1, 0]
    rolls = _toe_roll(np.array([0] * 30 + [1] * 4 + [0] * 30, np.bool_), 30.0)
    assert_allclose(rolls[30:34], 1)
    assert rolls[29] == pytest.approx(rolls[34])
    assert 0.3 < rolls[29] < 1
    assert rolls[[0, -1]].max() < 0.01
    assert rolls.min() >= 0


def test_a_heading_is_about_the_vertical_alone() -> None:
    lean = so3.multiply(turn(Y, 50), turn(X, 20))
    assert_allclose(_heading_rotation(turn(Y, 50), 1), turn(Y, 50), atol=1e-12)
    made = _heading_rotation(lean, 1)
    assert_allclose(made[[0, 2]], 0)
    assert np.linalg.norm(made) == pytest.approx(1)
    assert_allclose(_heading_rotation(turn(Z, 70), 2), turn(Z, 70), atol=1e-12)
    assert_array_equal(_heading_rotation(np.array([1.0, 0, 0, 0]), 1), so3.IDENTITY)


def test_a_toe_goes_with_its_foot_and_raises_the_ankle_where_it_stands_alone() -> None:
    heel = np.array([1, 1, 0, 0], np.bool_)
    toe = np.array([0, 1, 1, 0], np.bool_)
    tips = np.tile([0.1, -0.98, 0.15], (4, 1))
    own = foot(4, FootContacts(heel, toe, 0.08), toe=tips)
    turns = np.tile(turn(X, 90), (4, 1))
    bone = _ankle_to_toe(own, turns)
    # From 8 cm below and 15 cm ahead, pitched down by a quarter.
    assert_allclose(bone, np.tile([0, -0.15, -0.08], (4, 1)), atol=1e-12)
    assert _toe_height(own, 1) == pytest.approx(-0.08)
    assert_allclose(_ankle_rise(own, bone, 1), [0, 0, -0.08 + 0.15, 0], atol=1e-12)
    tilted = foot(4, toe=tips, flat_rotation=turn(X, 90))
    assert _toe_height(tilted, 1) == pytest.approx(-0.15)
    tips = tips.copy()
    tips[:, 1] = [-0.9, -0.97, -0.95, 3.0]
    free = foot(4, FootContacts(heel, toe, 0.08), toe=tips, flat_rotation=None)
    assert _toe_height(free, 1) == pytest.approx(-0.07)
    none = FootContacts(heel & ~heel, toe & ~toe, 0.08)
    assert _toe_height(foot(4, none, toe=tips, flat_rotation=None), 1) == pytest.approx(
        -0.025
    )
    assert not _ankle_to_toe(foot(4), turns).any()
    assert _toe_height(foot(4), 1) == 0


def test_feet_that_stand_lift_the_hips_by_the_mean_of_what_they_ask() -> None:
    """One is 10 cm too low, and one 4 cm: both stand all the time."""
    hips = np.tile([0.0, 0.9, 0.0], (40, 1))
    one, other = foot(40, height=0.10), foot(40, height=0.04)
    held = [one.ankle, other.ankle]
    none = [np.zeros(40)] * 2
    found = _hip_lift(hips, [one, other], held, none, 30.0, 1)
    assert_allclose(found, 0.07, atol=1e-6)
    found = _hip_lift(hips, [one, other], held, [np.full(40, 0.02)] * 2, 30.0, 1)
    assert_allclose(found, 0.09, atol=1e-6)
    assert_allclose(_hip_lift(hips, [one], held[:1], none[:1], 30.0, 1), 0.1, atol=1e-6)


def test_no_toe_is_below_the_ground_in_the_air() -> None:
    toe = np.full(20, 0.05)
    toe[8:12] = -0.03
    stands = np.zeros(20, np.bool_)
    stands[:4] = stands[16:] = True
    made = np.zeros(20)
    _raise_above_ground(made, toe, 0.02, stands, 30.0)
    assert_allclose(made[stands], 0)
    assert ((toe + made)[~stands] > 0.02 - 2e-4).all()
    assert (toe + made)[8:12] == pytest.approx(0.02, abs=5e-3)
    fine = np.zeros(20)
    _raise_above_ground(fine, toe, -0.0301, stands, 30.0)
    assert not fine.any()
    _raise_above_ground(fine, toe, -0.02991, stands, 30.0)
    assert not fine.any()
    _raise_above_ground(fine, toe, 0.02, stands & ~stands, 30.0)
    assert not fine.any()


@pytest.mark.parametrize(
    ("straight", "level", "share"),
    [
        (1.0, so3.IDENTITY, 0.9995),
        (0.995, so3.IDENTITY, 1 - 1.4 * 0.005),
        (0.995, None, 0.995),
        (0.9, so3.IDENTITY, 0.98),
    ],
)
def test_hips_come_down_until_legs_are_as_straight_as_they_may(
    straight: float, level: Any, share: float
) -> None:
    """Hips are 1.1 m above an ankle that is 0.3 m aside; the leg is 1 m."""
    hips = np.tile([0.0, 1.2, 0.0], (50, 1))
    one = foot(
        50, straightness=np.full(50, straight), flat_rotation=level, leg_length=1.0
    )
    ankle = np.tile([0.3, 0.1, 0.0], (50, 1))
    down, rise = _hip_shifts(hips, [one], [ankle], 30.0, 1)
    assert_allclose(down, 1.1 - np.sqrt(share**2 - 0.09), atol=1e-4)
    assert_allclose(rise, 0, atol=1e-6)


@pytest.mark.parametrize(("high", "rise"), [(0.3, 0.1), (0.45, 0.0), (-0.3, 0.0)])
def test_hips_rise_for_legs_that_fold_no_further(high: float, rise: float) -> None:
    """An ankle comes no nearer than half a metre to the hip, 0.3 m aside."""
    hips = np.tile([0.0, 1.0, 0.0], (50, 1))
    one = foot(50, min_reach=0.5, leg_length=1.0)
    ankle = np.tile([0.3, 1.0 - high, 0.0], (50, 1))
    found = _hip_shifts(hips, [one], [ankle], 30.0, 1)[1]
    assert_allclose(found, rise, atol=1e-4)


def test_who_stands_all_the_time_stays() -> None:
    """The hips as high as the ankle says, what slides is in its middle."""
    frames = 30
    hips = np.tile([0.5, 1.0, 0.2], (frames, 1))
    ankle = np.tile([0.1, -0.85, 0.0], (frames, 1))
    ankle[:, 2] = np.linspace(-0.01, 0.01, frames)
    one = foot(frames, ankle=ankle, leg_length=0.95)
    made = plant_feet(hips, [one], 30.0, 1)
    assert_allclose(made.hips, np.tile([0.5, 0.93, 0.2], (frames, 1)), atol=1e-5)
    assert_allclose(made.ankles[0], np.tile([0.6, 0.08, 0.2], (frames, 1)), atol=1e-6)
    assert made.sole_heights == [0.08]
    assert made.max_lowering == 0
    assert made.is_planted[0].all()
    short = plant_feet(hips, [foot(frames, ankle=ankle, leg_length=0.8)], 30.0, 1)
    assert short.max_lowering == pytest.approx(
        0.85 - np.sqrt((0.9995 * 0.8) ** 2 - 0.01), abs=2e-4
    )


@pytest.mark.parametrize(
    ("goal", "reached"),
    [
        ([0.0, -0.6, 0.3], 1.0),
        ([0.0, -0.3, -0.2], 1.0),
        ([0, -2.0, 0], 0.45),
        ([0, -0.05, 0], 2),
    ],
)
def test_a_limb_bends_in_its_own_plane_to_its_goal(goal: Any, reached: float) -> None:
    """Bones of 0.5 and 0.4 m; beyond its reach it goes the way of the goal."""
    hip = np.array([[1.0, 2, 3]])
    knee, ankle = hip + np.array([0, -0.5, 0]), hip + np.array([0, -0.82, -0.24])
    own = so3.IDENTITY[None]
    aim = hip + np.array(goal)
    thigh, shin = bend_limb(hip, (knee, ankle), aim, (own, own), X[None])
    found = so3.rotate(thigh, knee - hip) + so3.rotate(shin, ankle - knee)
    way = np.array(goal, float)
    if reached == 1:
        assert_allclose(found[0], way, atol=1e-9)
    else:
        far = 0.9 * 0.9995 if reached < 1 else 0.1
        assert_allclose(found[0], way / np.linalg.norm(way) * far, atol=1e-7)
    # About x, so that the knee stays ahead.
    assert_allclose(so3.rotate(thigh, X[None])[0], X, atol=1e-9)


def test_a_straight_limb_bends_about_its_hinge() -> None:
    hip, own = np.zeros((1, 3)), so3.IDENTITY[None]
    knee, ankle = np.array([[0, -0.5, 0.0]]), np.array([[0, -1.0, 0.0]])
    for hinge in (X, Z, -X):
        goal = np.array([[0, -0.8, 0.0]])
        thigh, shin = bend_limb(hip, (knee, ankle), goal, (own, own), hinge[None])
        bent = so3.multiply(so3.conjugate(thigh), shin)[0]
        angle = 2 * np.arccos(0.8)
        assert_allclose(so3.log(bent), angle * hinge, atol=1e-9)
    # It is straighter than it need be, and may stay so.
    thigh, shin = bend_limb(hip, (knee, ankle), ankle, (own, own), X[None])
    assert_allclose(so3.angle_between(shin, own), 0, atol=1e-7)


def test_the_shortest_turn_and_the_opposite_way() -> None:
    ways = np.array([[2.0, 0, 0], [0, 3, 0], [1, 0, 0]])
    aims = np.array([[0, 5.0, 0], [0, 1, 0], [-4, 0, 0]])
    found = shortest_rotations(ways, aims)
    assert_allclose(found[0], turn(Z, 90), atol=1e-12)
    assert_allclose(found[1], so3.IDENTITY, atol=1e-12)
    # Any would do; of what is opposite along y half a turn about x.
    assert_allclose(found[2], [1, 0, 0, 0])


def leg(kind: JointType = JointType.BALL, limits: Any = None) -> RoledSkeleton:
    """Return a person of a left leg: bones of 0.5 and 0.4 m, its knee rests bent."""
    joints = (
        Joint("hips", -1, translation=(0.0, 1.0, 0.0)),
        Joint("thigh", 0, translation=(0.1, 0.0, 0.0)),
        Joint(
            "shin", 1, kind, translation=(0.0, -0.5, 0.0), limits=limits,
            axis=(1.0, 0.0, 0.0), rotation=tuple(turn(X, 30).tolist()),
        ),
        Joint("foot", 2, translation=(0.0, -0.4, 0.0)),
    )  # fmt: skip
    roles = ("hips", "thigh_l", "shin_l", "foot_l")
    return RoledSkeleton.of(Rig("leg", joints), roles)


@pytest.mark.parametrize(
    ("kind", "limits", "expected"),
    [
        (JointType.BALL, None, (0.1, 0.9)),
        (JointType.PIN, None, (0.1, 0.9)),
        # From rest, which is 30 degrees off straight.
        (JointType.PIN, (-30.0, 60.0), (np.sqrt(0.41), 0.9)),
        (
            JointType.PIN,
            (-20.0, 30.0),
            (np.sqrt(0.61), np.sqrt(0.41 + 0.4 * np.cos(np.radians(10)))),
        ),
        (
            JointType.PIN,
            (0.0, 150.0),
            (0.1, np.sqrt(0.41 + 0.4 * np.cos(np.radians(30)))),
        ),
    ],
)
def test_how_near_and_far_an_ankle_can_be(
    kind: JointType, limits: Any, expected: tuple[float, float]
) -> None:
    own = None if limits is None else RangeLimit(*np.radians(limits))
    person = leg(kind, own)
    found = _leg_reach(person, leg_joints(person, "l"))
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("kind", [JointType.BALL, JointType.PIN])
def test_a_limb_is_put_and_goes_round(kind: JointType) -> None:
    person = leg(kind, RangeLimit(-1.0, 2.0) if kind is JointType.PIN else None)
    limb = leg_joints(person, "l")[:3]
    joints = person.positions[None, list(limb)]
    turns = person.rotations[None, 1], person.rotations[None, 2]
    goal = joints[:, 0] + [0.2, -0.6, 0.1]
    thigh, shin = limb_rotations(person, limb, joints, goal, turns, X)
    found = so3.rotate(thigh, [0, -0.5, 0]) + so3.rotate(shin, [0, -0.4, 0])
    assert_allclose(joints[:, 0] + found, goal, atol=1e-9)
    way = goal - joints[:, 0]
    round_about = swivel_leg((thigh, shin), 3 * way, np.array([0.3]))
    turned = so3.from_axis_angle(way[0] / np.linalg.norm(way), 0.3)
    assert_allclose(round_about[0][0], so3.multiply(turned, thigh[0]), atol=1e-12)
    assert_allclose(round_about[1][0], so3.multiply(turned, shin[0]), atol=1e-12)


def test_how_high_an_ankle_stands_without_a_ground_at_rest() -> None:
    """By its own rest, or the source's scaled by feet, or by legs."""
    target = leg()
    assert up_index(target.rig) == 1
    assert up_index(Rig("z", target.rig.joints, up=UpAxis.Z)) == 2

    def standing(alike: bool, feet: Any, low: float = 0.5) -> float:
        moved = target.positions.copy()
        moved[:, 1] += low - moved[:, 1].min()
        own = RoledSkeleton(target.rig, target.roles, moved, target.rotations, feet[0])
        other = RoledSkeleton(
            target.rig, target.roles, moved, target.rotations, feet[1]
        )
        transfer: Any = SimpleNamespace(
            target=own, source=other, scale=2.0, has_similar_legs=alike
        )
        return _planted_ankle_height(transfer, "l", 0.3, 1)

    none: Any = ({}, {})
    both: Any = tuple({"l": Ball(-1, np.array(v))} for v in ([0, 0, 0.3], [0, 0.1, 0]))
    nothing: Any = (both[0], {"l": Ball(-1, np.zeros(3))})
    assert standing(True, both, 0.0) == pytest.approx(0.6)
    assert standing(False, none) == pytest.approx(0.6)
    assert standing(False, both) == pytest.approx(0.9)
    assert standing(False, nothing) == pytest.approx(0.6)
    ankle = target.positions[3, 1] - target.positions[:, 1].min()
    assert standing(False, both, 0.0899) == pytest.approx(ankle + 0.0899)
    assert standing(False, both, 0.0901) == pytest.approx(0.9)


def test_a_ball_goes_with_its_foot_or_is_a_joint() -> None:
    person = leg()
    places = np.arange(24.0).reshape(2, 4, 3)
    turns = np.tile(turn(X, 90), (2, 4, 1))
    found = ball_of_foot(person, "l", places, turns)
    assert_array_equal(found, places[:, 3])
    for ball, expected in (
        (Ball(-1, np.array([0, 0, 0.2])), places[:, 3] + [0, -0.2, 0]),
        (Ball(2, np.zeros(3)), places[:, 2]),
    ):
        own = RoledSkeleton(
            person.rig, person.roles, person.positions, person.rotations, {"l": ball}
        )
        assert_allclose(ball_of_foot(own, "l", places, turns), expected, atol=1e-12)


def arms() -> RoledSkeleton:
    joints = (
        Joint("hips", -1), Joint("head", 0, translation=(0.0, 0.6, 0.0)),
        Joint("l0", 0, translation=(0.2, 0.5, 0.0)),
        Joint("l1", 2, translation=(0.3, 0.0, 0.0), rotation=tuple(turn(X, 40))),
        Joint("l2", 3, translation=(0.2, 0.0, 0.0)),
        Joint("r0", 0, translation=(-0.2, 0.5, 0.0)),
    )  # fmt: skip
    roles = ("hips", "head", "upper_arm_l", "forearm_l", "hand_l", "upper_arm_r")
    return RoledSkeleton.of(Rig("arms", joints), roles)


def test_arms_are_told_by_three_joints() -> None:
    person = arms()
    assert arm_joints(person, "l") == [2, 3, 4]
    assert arm_joints(person, "r") is None
    assert _arm_length(person, "l") == pytest.approx(0.5)
    assert _arm_length(person, "r") == 0
    # Across an arm along x and as level as can be, seen from the forearm.
    found = so3.rotate(turn(X, 40), elbow_hinge(person, [2, 3, 4]))
    assert_allclose(found, [0, 0, -1], atol=1e-12)


def test_both_hands_come_nearer_as_one() -> None:
    goals = [np.array([[1.2, 0.0, 0]]), np.array([[1.0, 0.0, 0.5]])]
    starts = [np.zeros((1, 3)), np.array([[0.5, 0, 0.5]])]
    found = _shift_into_reach(goals, starts, [1.0, 0.9])
    assert_allclose(found[0], [[1.0, 0, 0]], atol=1e-6)
    assert_allclose(found[1] - found[0], goals[1] - goals[0], atol=1e-12)
    near = _shift_into_reach(goals, starts, [1.2, 0.9])
    assert near[0] is goals[0]


def test_heights_are_softened_from_a_share_of_the_arm_on() -> None:
    found = _soften_heights(np.array([-0.3, -0.2, 0.0, 0.1, 0.2]), 0.2)
    assert_allclose(found, [0, 0, 0.05, 0.09 / 0.8, 0.2])
    assert_array_equal(AnkleHeights.ground_offset(None, 2.0, 1), [0, 0, 0])
    assert_allclose(
        AnkleHeights.ground_offset(AnkleHeights(0.1, 0.5), 2.0, 2), [0, 0, 0.3]
    )


@pytest.mark.parametrize(
    ("apart", "speed", "held"),
    [(0.39, 0.0, True), (0.41, 0.0, False), (0.1, 0.24, True), (0.1, 0.26, False)],
)
def test_hands_hold_each_other_that_are_near_and_go_together(
    apart: float, speed: float, held: bool
) -> None:
    """Within 0.4 of an arm of a metre, and by a quarter of it a second."""
    ways = np.zeros((12, 3))
    ways[:, 1] = apart
    ways[:, 2] = speed * (np.arange(12) - 5.5) / 30.0
    assert _are_hands_joined(ways, 1.0, 30.0).tolist() == [held] * 12
    assert not _are_hands_joined(ways, 0.0, 30.0).any()
    assert not _are_hands_joined(ways[:2], 1.0, 30.0).any()


@pytest.mark.parametrize(
    ("far", "speed", "way", "held"),
    [
        (1.4, 0.0, 1.0, True), (1.6, 0.0, 1.0, False), (0.5, 0.24, 1.0, True),
        (0.5, 0.26, 1.0, False), (0.5, 0.0, 0.11, True), (0.5, 0.0, 0.09, False),
    ],
)  # fmt: skip
def test_a_prop_is_held_that_goes_with_a_hand(
    far: float, speed: float, way: float, held: bool
) -> None:
    """Nearer than 1.5 arms, steady within a quarter a second, carried for a tenth."""
    count = 20
    places = np.zeros((count, 3))
    places[:, 0] = np.linspace(0, way, count)
    turns = np.tile(turn(Y, 90), (count, 1))
    prop = PropMotion(3, places, turns)
    wrist = places + np.array([0, 0, far])
    wrist[:, 1] += speed * np.arange(count) / 30.0
    assert_allclose(prop.in_prop_frame(wrist)[0], [-far, 0, 0], atol=1e-12)
    assert prop.find_gripped_frames(wrist, 1.0, 30.0).all() == held
    assert prop.find_gripped_frames(wrist, 1.0, 30.0).any() == held
    assert not prop.find_gripped_frames(wrist, 0.0, 30.0).any()
    assert not prop.find_gripped_frames(wrist[:2], 1.0, 30.0).any()
