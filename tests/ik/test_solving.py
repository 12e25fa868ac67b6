"""Laws of solving, and inputs that must not break it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from support.faults import raises
from support.ik import (
    arm,
    beyond_limits,
    every_goal,
    mixed_rig,
    random_pose,
    reached_by,
)
from support.suite import examples

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import Goal, IkOptions, IkStatus, Targets, build, follow, solve
from animtool.ik.goals import GOAL_KINDS
from animtool.ik.solving import OPTION_RANGES
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

ROOT = Path(__file__).parents[2]
SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=examples(25))


@FEW
@given(SEEDS)
def test_poses_that_exist_are_found_within_the_limits(seed: int) -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    start, wanted = random_pose(problem, seed), random_pose(problem, seed ^ 1)
    result = solve(problem, start, reached_by(problem, wanted))
    assert result.statuses == (IkStatus.CONVERGED,)
    assert beyond_limits(problem, result.coordinates) == 0.0


@FEW
@given(SEEDS)
def test_limits_are_kept_where_the_goals_are_out_of_reach(seed: int) -> None:
    problem = build(mixed_rig(), every_goal()[:2], joints=["spine", "elbow", "hand"])
    targets = Targets(
        np.random.default_rng(seed).normal(size=(1, 2, 3)) * 3,
        np.ones((1, 2, 4)),
        np.zeros((1, 2, 3)),
    )
    result = solve(problem, None, targets, IkOptions(restarts=10))
    assert beyond_limits(problem, result.coordinates) == 0.0
    assert np.isfinite(result.coordinates).all()


@FEW
@given(SEEDS, st.sampled_from([1e-4, 0.37, 1e4]))
def test_the_scale_of_the_world_does_not_matter(seed: int, scale: float) -> None:
    rig = arm(5, limit=2.0)
    large = Rig(
        "large",
        tuple(
            replace(j, translation=tuple(scale * x for x in j.translation))
            for j in rig.joints
        ),
    )
    small = build(rig, [Goal("b4", (0.3, 0.0, 0.0))])
    problem = build(large, [Goal("b4", (0.3 * scale, 0.0, 0.0))])
    start, wanted = random_pose(small, seed), random_pose(small, seed ^ 1)
    reference = solve(small, start, reached_by(small, wanted))
    result = solve(problem, start, reached_by(problem, wanted))
    assert result.statuses == reference.statuses
    tolerance = IkOptions().tolerance * problem.length
    if reference.converged.all():
        assert result.positions.max() <= tolerance


@FEW
@given(SEEDS)
def test_moving_the_world_moves_the_answer_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = so3.exp(rng.uniform(-2, 2, 3)), rng.uniform(-5, 5, 3)
    rig = arm(6, limit=2.5)
    first = rig.joints[0]
    moved = Rig(
        "moved",
        (
            replace(first, translation=tuple(shift), rotation=tuple(turn)),
            *rig.joints[1:],
        ),
    )
    goals = [Goal("b5", (0.3, 0.0, 0.0), orientation=1.0)]
    at_home, away = build(rig, goals), build(moved, goals)
    start, wanted = random_pose(at_home, seed), random_pose(at_home, seed ^ 1)
    targets = reached_by(at_home, wanted)
    here = solve(at_home, start, targets)
    there = solve(
        away,
        start,
        Targets(
            so3.rotate(turn, targets.positions) + shift,
            so3.multiply(turn, targets.rotations),
        ),
    )
    assert here.statuses == there.statuses
    if here.iterations[0] < 15:
        np.testing.assert_allclose(here.coordinates, there.coordinates, atol=1e-4)


def test_the_order_of_joints_does_not_matter() -> None:
    # A tree with its branches told in two orders.
    trunk = Joint("trunk", -1, JointType.BALL)
    left = Joint("left", 0, JointType.PIN, translation=(0.5, 1.0, 0.0))
    right = Joint("right", 0, JointType.PIN, translation=(-0.5, 1.0, 0.0))
    goals = [Goal("left", (0.4, 0, 0)), Goal("right", (-0.4, 0, 0))]
    one = build(Rig("one", (trunk, left, right)), goals)
    two = build(Rig("two", (trunk, right, left)), goals)
    pose = np.array([[*so3.exp([0.2, 0.3, -0.4]), 0.5, -0.8]])
    targets = reached_by(one, pose)
    first, second = solve(one, None, targets), solve(two, None, targets)
    assert first.converged.all()
    swapped = second.coordinates[:, [0, 1, 2, 3, 5, 4]]
    np.testing.assert_allclose(first.coordinates, swapped, atol=1e-9)


def test_the_same_seed_gives_the_same_bytes_alone_or_in_a_batch() -> None:
    problem = build(arm(6, limit=1.2), [Goal("b5", (0.2, 0, 0), orientation=1.0)])
    start = random_pose(problem, 1, frames=20)
    targets = reached_by(problem, random_pose(problem, 2, frames=20))
    whole = solve(problem, start, targets)
    again = solve(problem, start, targets)
    assert whole.coordinates.tobytes() == again.coordinates.tobytes()
    for b in range(20):
        alone = solve(
            problem,
            start[b],
            Targets(targets.positions[b : b + 1], targets.rotations[b : b + 1]),
        )
        assert alone.coordinates.tobytes() == whole.coordinates[b].tobytes()


def test_a_straight_arm_bends_to_a_target_on_its_own_line() -> None:
    problem = build(arm(3), [Goal("b2", (0.4, 0.0, 0.0))])
    result = solve(problem, None, Targets([[[0.5, 0.0, 0.0]]]))
    assert result.statuses == (IkStatus.CONVERGED,)


def test_out_of_reach_is_the_nearest_point_with_the_distance_left() -> None:
    problem = build(arm(3), [Goal("b2", (0.4, 0.0, 0.0))])
    result = solve(problem, None, Targets([[[2.0, 0.7, 0.0]]]))
    assert result.statuses == (IkStatus.NEAREST,)
    distance = np.linalg.norm([2.0, 0.7, 0.0])
    assert abs(result.positions[0, 0] - (distance - 1.2)) < 1e-9


def test_bones_without_length_are_answered() -> None:
    joints = tuple(Joint(f"b{i}", i - 1, JointType.PIN) for i in range(4))
    goal = Goal("b3", orientation=1.0)
    problem = build(Rig("point", joints), [goal])
    targets = Targets([[[1.0, 0.0, 0.0]], [[0.0] * 3]], [[[0.0, 0.0, 0.0, 1.0]]] * 2)
    result = solve(problem, None, targets)
    assert result.statuses == (IkStatus.NEAREST, IkStatus.CONVERGED)
    assert np.isfinite(result.coordinates).all()


def test_a_budget_ends_the_search() -> None:
    problem = build(arm(6, limit=0.3), [Goal("b5", orientation=1.0)])
    targets = Targets([[[-1.0, 0.2, 0.1]]], [[[1.0, 0.0, 0.0, 0.0]]])
    result = solve(problem, None, targets, IkOptions(iterations=3))
    assert result.statuses == (IkStatus.BUDGET,)
    assert result.iterations[0] == 3


def test_targets_beyond_the_range_of_numbers_have_a_status() -> None:
    problem = build(arm(3), [Goal("b2", (0.4, 0.0, 0.0))])
    result = solve(problem, None, Targets([[[1e300, 0.0, 0.0]]]))
    assert result.statuses == (IkStatus.NOT_FINITE,)
    assert np.isfinite(result.coordinates).all()


def test_warm_frames_start_where_the_last_ended() -> None:
    problem = build(arm(6), [Goal("b5", (0.2, 0.0, 0.0), orientation=1.0)])
    pose = random_pose(problem, 4)
    path = pose + np.linspace(0, 0.5, 50)[:, None]
    result = solve(problem, pose[0], reached_by(problem, path), IkOptions(warm=True))
    assert result.converged.all()
    assert np.abs(np.diff(result.coordinates, axis=0)).max() < 0.1
    assert result.iterations.max() <= 5


def test_frames_out_of_reach_follow_the_nearest_branch_without_a_search_each() -> None:
    problem = build(arm(4, limit=0.5), [Goal("b3", (0.4, 0.0, 0.0))])
    turn = np.linspace(0, 2 * np.pi, 400)
    path = np.stack([np.cos(turn), np.sin(turn), 0.4 * np.sin(3 * turn)], axis=-1)
    targets = Targets(1.3 * path[:, None])
    warm = solve(problem, None, targets, IkOptions(warm=True))
    cold = solve(problem, None, targets)
    assert set(warm.statuses) == {IkStatus.NEAREST}
    assert np.median(warm.descents) <= 3
    assert np.median(warm.iterations) < np.median(cold.iterations) / 4
    worse = warm.positions[:, 0] > 1.01 * cold.positions[:, 0]
    gaps = np.diff(np.flatnonzero(np.concatenate([[True], ~worse, [True]])))
    assert gaps.max() <= 8
    assert worse.mean() < 0.05


def test_ordered_frames_with_starts_of_their_own_search_once() -> None:
    problem = build(arm(4, limit=0.5), [Goal("b3", (0.4, 0.0, 0.0))])
    turn = np.linspace(0, 1, 40)
    path = np.stack([np.cos(turn), np.sin(turn), 0.4 * np.sin(3 * turn)], axis=-1)
    targets = Targets(1.3 * path[:, None])
    starts = 0.3 * np.sin(turn[:, None] + np.arange(4))
    alone = solve(problem, starts, targets)
    ordered = solve(problem, starts, targets, IkOptions(ordered=True))
    assert set(ordered.statuses) == {IkStatus.NEAREST}
    assert np.median(ordered.descents) <= 5 < np.median(alone.descents)
    # What the first search found is kept up with.
    assert (ordered.positions < 1.01 * alone.positions + 1e-3).mean() > 0.9
    assert beyond_limits(problem, ordered.coordinates) == 0.0


def test_ordered_frames_in_reach_are_solved_from_their_own_starts() -> None:
    problem = build(mixed_rig(), every_goal()[:1])
    first = random_pose(problem, 3)
    starts = np.repeat(first, 3, axis=0)
    targets = reached_by(problem, starts)
    ordered = solve(problem, starts, targets, IkOptions(ordered=True))
    assert ordered.converged.all()
    np.testing.assert_allclose(ordered.coordinates, starts, atol=1e-9)


@FEW
@given(SEEDS)
def test_what_a_frame_does_not_ask_for_is_as_if_the_goal_had_no_such_weight(
    seed: int,
) -> None:
    goals = every_goal()[:2]
    problem = build(mixed_rig(), goals)
    start, wanted = random_pose(problem, seed), random_pose(problem, seed ^ 1)
    targets = reached_by(problem, wanted)
    weights = np.ones((1, 2, len(GOAL_KINDS)))
    weights[0, 0, 1] = weights[0, 1, 2] = 0.0
    without = build(
        mixed_rig(),
        [replace(goals[0], orientation=0.0), replace(goals[1], aim=0.0)],
        joints=problem.joints,
    )
    less = solve(problem, start, replace(targets, weights=weights))
    plain = solve(without, start, replace(targets, rotations=None, aims=None))
    assert less.statuses == plain.statuses == (IkStatus.CONVERGED,)
    np.testing.assert_allclose(less.coordinates, plain.coordinates, atol=1e-9)
    assert not less.orientations.any()
    assert not less.aims.any()


def test_weights_of_a_frame_multiply_those_of_the_goal() -> None:
    # Out of reach both ways: the weights decide where it stands between.
    goals = [Goal("b0", (1.0, 0.0, 0.0)), Goal("b0", (1.0, 0.0, 0.0), position=0.5)]
    targets = Targets([[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
    heavy = [replace(goals[0], position=0.3), replace(goals[1], position=1.0)]
    expected = solve(build(arm(1), heavy), [0.3], targets).coordinates
    weights = np.array([[[0.3] * len(GOAL_KINDS), [2.0] * len(GOAL_KINDS)]])
    got = solve(build(arm(1), goals), [0.3], replace(targets, weights=weights))
    np.testing.assert_allclose(got.coordinates, expected, atol=1e-9)


def test_a_frame_that_asks_for_nothing_stays_where_it_is() -> None:
    problem = build(arm(6), [Goal("b5", (0.2, 0.0, 0.0), orientation=1.0)])
    pose = random_pose(problem, 4)
    path = pose + np.linspace(0, 0.5, 9)[:, None]
    targets = reached_by(problem, path)
    weights = np.ones((9, 1, len(GOAL_KINDS)))
    weights[3:6] = 0.0
    positions = np.array(targets.positions)
    positions[3:6] = np.nan
    idle = replace(targets, positions=positions, weights=weights)
    result = solve(problem, pose[0], idle, IkOptions(warm=True))
    assert result.converged.all()
    stayed = np.broadcast_to(result.coordinates[2], (3, 6))
    np.testing.assert_array_equal(result.coordinates[3:6], stayed)
    assert not result.iterations[3:6].any()


def test_a_goal_with_a_root_leaves_what_is_above_it() -> None:
    problem = build(arm(6), [Goal("b5", (0.2, 0.0, 0.0), root="b3")])
    start, wanted = random_pose(problem, 1), random_pose(problem, 2)
    wanted[:, :3] = start[:, :3]
    frozen = build(arm(6), [Goal("b5", (0.2, 0.0, 0.0), root="b3")], pose=start[0])
    result = solve(frozen, start, reached_by(frozen, wanted))
    assert result.converged.all()
    np.testing.assert_array_equal(result.coordinates[:, :3], start[:, :3])


def test_the_pose_preferred_decides_what_the_goals_leave_open() -> None:
    rig = arm(6)
    goals = [Goal("b5", (0.2, 0.0, 0.0))]
    wanted = random_pose(build(rig, goals), 7)
    problem = build(rig, goals, rest_weight=1e-4)
    start = random_pose(problem, 8)
    result = solve(problem, start, reached_by(problem, wanted), prefer=wanted)
    np.testing.assert_allclose(result.coordinates, wanted, atol=1e-2)


def test_a_preference_is_sought_from_a_start_that_reaches_the_goals_too() -> None:
    goals = [Goal("b5", (0.2, 0.0, 0.0))]
    problem = build(arm(6), goals, rest_weight=1e-6)
    start, wanted = random_pose(problem, 9), np.zeros(6)
    targets = reached_by(problem, start)
    result = solve(problem, start, targets, prefer=wanted)
    assert np.linalg.norm(result.coordinates) < 0.9 * np.linalg.norm(start)
    assert result.positions.max() < 1e-4


def test_poses_of_new_starts_stay_random_in_nothing() -> None:
    # Hands on both sides of a box before the knees, which the rest pose does not find.
    rig = load_rig(ROOT / "rigs" / "biped" / "biped.rig.yaml")
    goals = [
        Goal(f"wrist_{side}", (x, -0.022, 0.0), orientation=1.0, root="spine_1")
        for side, x in (("l", 0.07), ("r", -0.07))
    ]
    problem = build(rig, goals)
    palms = so3.normalize([[-0.38, -0.38, -0.6, 0.6], [-0.38, 0.38, 0.6, 0.6]])
    targets = Targets([[[0.2, 0.6, 0.5], [-0.2, 0.6, 0.5]]], palms[None])
    result = solve(problem, None, targets, IkOptions(near=True))
    assert result.converged[0]
    assert result.descents[0] > 1
    local = local_from_coordinates(rig, result.coordinates)
    places = forward_kinematics(rig, local.translations, local.rotations).positions[0]
    for name in ("spine_4", "neck_1", "head"):
        assert abs(places[rig.index(name), 0]) < 1e-4
    left, right = (places[rig.index(f"elbow_{side}")] for side in "lr")
    np.testing.assert_allclose(left, right * [-1, 1, 1], atol=1e-4)


def test_limits_that_hold_are_named() -> None:
    problem = build(arm(3, limit=0.1), [Goal("b2", (0.4, 0.0, 0.0))])
    result = solve(problem, None, Targets([[[0.2, 0.9, 0.0]]]))
    assert result.limits_active() == ["b0", "b1", "b2"]
    assert "nearest" in repr(result)


@pytest.mark.parametrize("start", [np.zeros(2), np.full(3, np.nan), np.zeros((2, 3))])
def test_starts_that_do_not_fit_are_refused(start: np.ndarray) -> None:
    problem = build(arm(3), [Goal("b2")])
    with pytest.raises(OptionError) as caught:
        solve(problem, start, Targets(np.zeros((1, 1, 3))))
    expected = "IK013" if start.shape == (3,) else "IK012"
    assert caught.value.code == expected


def test_an_aim_at_what_is_very_far_is_no_silent_success() -> None:
    goal = Goal("b2", position=0.0, aim=1.0, aim_axis=(0.6, 0.8, 0.0))
    problem = build(arm(3), [goal])
    result = solve(problem, None, Targets(aims=[[[1e300, 0.0, 0.0]]]))
    rotation = np.asarray(reached_by(problem, result.coordinates).rotations)[0, 0]
    axis = so3.rotate(rotation, np.array(goal.aim_axis))
    np.testing.assert_allclose(axis, [1.0, 0.0, 0.0], atol=1e-5)
    assert result.converged.all()


def test_options_are_checked_all_at_once() -> None:
    problem = build(arm(3), [Goal("b2")])
    options = IkOptions(tolerance=0.0, restarts=-1, seconds=-1.0)
    with pytest.raises(OptionError) as caught:
        solve(problem, None, Targets(np.zeros((1, 1, 3))), options)
    assert [fault.code for fault in caught.value.faults] == ["IK014"] * 3


@pytest.mark.parametrize("name", list(OPTION_RANGES))
def test_counts_are_taken_as_far_as_there_is_room(name: str) -> None:
    problem, targets = build(arm(3), [Goal("b2")]), Targets([[[1.0, 0.0, 0.0]]])
    low, most = OPTION_RANGES[name]
    for value in (low, most):
        solve(problem, None, targets, replace(IkOptions(), **{name: value}))
    for value in (low - 1, most + 1, 1.5):
        with raises(OptionError, "IK014", match=name):
            solve(problem, None, targets, replace(IkOptions(), **{name: value}))


@pytest.mark.parametrize("point", [[-0.6, -0.4, 0.0], [0.2, 1.5, 0.0]])
def test_a_long_chain_with_tight_limits_ends_at_the_nearest_pose(
    point: list[float],
) -> None:
    """Like bounded minimisation of the distance over the angles."""
    count, most = 160, 0.012
    pins = [
        Joint(
            *(f"p{i}", i - 1, JointType.PIN, (0.0 if i == 0 else 1 / count, 0.0, 0.0)),
            axis=(0.0, 0.0, 1.0),
            limits=RangeLimit(-most, most),
        )
        for i in range(count)
    ]
    rig = Rig("snake", tuple(pins))
    problem = build(rig, [Goal(f"p{count - 1}", offset=(1 / count, 0.0, 0.0))])
    result = solve(problem, None, Targets(positions=[[point]]))

    def miss(angles: FloatArray) -> tuple[float, FloatArray]:
        total = np.cumsum(angles)
        bones = np.stack([np.cos(total), np.sin(total)]) / count
        missed = bones.sum(axis=1) - point[:2]
        behind = np.cumsum(bones[:, ::-1], axis=1)[:, ::-1]
        return missed @ missed / 2, missed[1] * behind[0] - missed[0] * behind[1]

    nearest = min(
        minimize(
            *(miss, np.full(count, start * most)),
            jac=True,
            method="L-BFGS-B",
            bounds=[(-most, most)] * count,
        ).fun
        for start in (-0.9, 0.0, 0.9)
    )
    assert result.positions[0, 0] < np.sqrt(2 * nearest) + 1e-5
    assert np.abs(result.coordinates).max() <= most + 1e-12


def test_joints_that_do_not_move_are_where_the_problem_has_them() -> None:
    bone = (1.0, 0.0, 0.0)
    pins = [
        Joint(name, j - 1, JointType.PIN, translation=bone, axis=(0, 0, 1))
        for j, name in enumerate(("base", "upper", "lower"))
    ]
    rig, goal = Rig("arm", tuple(pins)), Goal("lower", offset=bone)
    start, target = [0.8, 0.0, 0.3], [2.0, 1.2, 0.0]
    problem = build(rig, [goal], joints=["upper", "lower"])
    for call in (solve, follow):
        with raises(OptionError, "IK016", match="'base' .* 45.8"):
            call(problem, start, Targets(positions=[[target]]))
    with raises(OptionError, "IK016", match="Session"):
        solve(problem, [start, [0.1, 0, 0]], Targets(positions=[[target], [target]]))
    above = build(rig, [Goal("upper", offset=bone)], joints=["upper"])
    assert above.fixed_columns.tolist() == [0]
    fitting = build(rig, [goal], joints=["upper", "lower"], pose=start)
    result = solve(fitting, start, Targets(positions=[[target]]))
    reached = result.world().positions[0, 2] + so3.rotate(
        result.world().rotations[0, 2], np.array(bone)
    )
    np.testing.assert_allclose(reached, target, atol=1e-5)
    for near in (None, [1e-7, 0.2, 0.3]):
        assert solve(problem, near, Targets(positions=[[target]])).converged.all()
    # A revolution is where it was, and so is a rotation of zeros or the other sign.
    whole = [2 * np.pi, 0.2, 0.3]
    assert solve(problem, whole, Targets(positions=[[target]])).converged.all()
    body = (Joint("body", -1), *(replace(pin, parent=j) for j, pin in enumerate(pins)))
    problem = build(Rig("body", body), [goal], joints=["upper", "lower"])
    for sign in (0.0, 1.0, -1.0):
        poses = problem.pose * np.where(np.arange(problem.coordinates) < 7, sign, 1.0)
        assert solve(problem, poses, Targets(positions=[[target]])).converged.all()
    moved = problem.pose + np.eye(problem.coordinates)[0]
    with raises(OptionError, "IK016", match="'body' .* 1 m "):
        solve(problem, moved, Targets(positions=[[target]]))
