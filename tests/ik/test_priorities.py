"""Goals that give way to others, against a general solver of constrained problems."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from support.ik import arm, mixed_rig, random_pose, reached_by
from support.suite import some_quick

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import Goal, IkOptions, IkStatus, Problem, Targets, build, solve
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics

LIMIT = 2.0
TIP = Goal("b5", (0.2, 0.0, 0.0))
MIDDLE = Goal("b2", (0.1, 0.3, 0.0), priority=1)
TURNED = Goal("b4", position=0.0, orientation=0.5, priority=7)


def missing(
    problem: Problem, q: FloatArray, targets: Targets, level: int
) -> FloatArray:
    """Return what the goals of a priority lack, weighted, lengths in shares."""
    rig = problem.rig
    local = local_from_coordinates(rig, q[None])
    world = forward_kinematics(rig, local.translations, local.rotations)
    found = []
    for e, goal in enumerate(problem.goals):
        if goal.priority != level:
            continue
        j = rig.index(goal.joint)
        linear = world.linear[0, j]
        point = world.positions[0, j] + linear @ np.asarray(goal.offset)
        away = np.asarray(targets.positions)[0, e] - point
        found.append(goal.position * away / problem.length)
        wanted = np.asarray(targets.rotations)[0, e]
        turn = so3.multiply(wanted, so3.conjugate(so3.from_matrix(linear)))
        found.append(goal.orientation * so3.log(turn))
    return np.concatenate(found)


def cost(problem: Problem, q: FloatArray, targets: Targets, level: int) -> float:
    return float(np.sum(missing(problem, q, targets, level) ** 2))


def reference(problem: Problem, q: FloatArray, targets: Targets) -> list[float]:
    """Return the least costs near a pose, priority by priority."""
    costs: list[float] = []
    constraints: list[dict[str, object]] = []
    for level in sorted({goal.priority for goal in problem.goals}):
        found = minimize(
            lambda x, level=level: 100 * cost(problem, x, targets, level),
            q,
            method="SLSQP",
            bounds=[(-LIMIT, LIMIT)] * len(q),
            constraints=constraints,
            options={"ftol": 1e-15, "maxiter": 500},
        )
        q = found.x
        costs.append(cost(problem, q, targets, level))
        held = missing(problem, q, targets, level)

        def left(x: FloatArray, level: int = level, held: FloatArray = held) -> object:
            return missing(problem, x, targets, level) - held

        constraints.append({"type": "eq", "fun": left})
    return costs


def wishes(problem: Problem, seed: int, reach: float) -> Targets:
    """Return targets of which the first is at a share of the reach, others anywhere."""
    rng = np.random.default_rng(seed)
    targets = reached_by(problem, random_pose(problem, seed))
    positions = np.array(targets.positions)
    if reach > 1:
        positions[0, 0] *= reach * problem.length / np.linalg.norm(positions[0, 0])
    positions[0, 1:] += rng.normal(size=positions[0, 1:].shape) * 0.5
    rotations = np.array(targets.rotations)
    rotations[0, 1:] = so3.normalize(rng.normal(size=rotations[0, 1:].shape))
    return Targets(positions, rotations)


@pytest.mark.parametrize("seed", some_quick(range(4), 2))
@pytest.mark.parametrize("reach", [0.7, 1.5])
@pytest.mark.parametrize("goals", [[TIP, MIDDLE], [TIP, MIDDLE, TURNED]])
def test_each_priority_is_as_good_as_those_before_it_let_it(
    goals: list[Goal], reach: float, seed: int
) -> None:
    problem = build(arm(6, LIMIT), goals)
    targets = wishes(problem, seed, reach)
    result = solve(problem, None, targets)
    q = result.coordinates[0]
    levels = sorted({goal.priority for goal in goals})
    found = [cost(problem, q, targets, level) for level in levels]
    expected = reference(problem, q, targets)
    if reach < 1:
        assert result.positions[0, 0] <= 1e-6 * problem.length
    for got, least in zip(found, expected, strict=True):
        assert math.sqrt(got) <= math.sqrt(least) * (1 + 1e-3) + 1e-6


def test_the_hard_goal_is_reached_whatever_the_soft_one_weighs() -> None:
    soft = replace(MIDDLE, position=1e4)
    problem = build(arm(6, LIMIT), [TIP, soft])
    for seed in range(5):
        result = solve(problem, None, wishes(problem, seed, 0.7))
        assert result.positions[0, 0] <= 1e-6 * problem.length


def test_only_the_order_of_priorities_matters() -> None:
    targets = wishes(build(arm(6, LIMIT), [TIP, MIDDLE]), 1, 0.7)
    near, far = (
        solve(build(arm(6, LIMIT), [TIP, replace(MIDDLE, priority=p)]), None, targets)
        for p in (1, 9)
    )
    np.testing.assert_array_equal(near.coordinates, far.coordinates)


def test_what_gives_way_is_told_from_what_is_out_of_reach() -> None:
    problem = build(arm(1), [Goal("b0", (1, 0, 0)), Goal("b0", (1, 0, 0), priority=1)])
    targets = Targets(
        [
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
            [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0]],
            [[0.0, 1.5, 0.0], [1.0, 0.0, 0.0]],
        ]
    )
    result = solve(problem, [0.3], targets)
    assert result.statuses == (
        IkStatus.YIELDED,
        IkStatus.NEAREST,
        IkStatus.NEAREST,
    )
    np.testing.assert_allclose(result.coordinates[:, 0], np.pi / 2, atol=1e-4)


def test_hard_goals_that_contradict_each_other_meet_in_the_middle() -> None:
    problem = build(arm(1), [Goal("b0", (1, 0, 0)), Goal("b0", (1, 0, 0))])
    targets = Targets(
        [
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
            [[0.0, 2.0, 0.0], [1.0, 0.0, 0.0]],
        ]
    )
    result = solve(problem, [0.3], targets)
    assert result.statuses == (IkStatus.CONFLICT, IkStatus.NEAREST)
    np.testing.assert_allclose(
        result.coordinates[:, 0], [np.pi / 4, np.arctan(2)], atol=1e-6
    )


def test_a_goal_missed_for_the_pose_preferred_is_not_out_of_reach() -> None:
    goals = [Goal("b5", (0.2, 0.0, 0.0))]
    problem = build(arm(6), goals, rest_weight=1e-3)
    targets = reached_by(problem, random_pose(problem, 3))
    far = Targets(np.concatenate([targets.positions, [[[9.0, 0.0, 0.0]]]]))
    result = solve(problem, None, far)
    assert result.statuses == (IkStatus.YIELDED, IkStatus.NEAREST)
    assert result.positions[0, 0] > 1e-5


@pytest.mark.parametrize("iterations", [1, 5, 20, 100, 400])
def test_a_budget_that_ends_between_priorities_hides_no_miss(iterations: int) -> None:
    problem = build(arm(6, LIMIT), [TIP, MIDDLE, TURNED])
    targets = wishes(problem, 2, 0.7)
    result = solve(problem, None, targets, IkOptions(iterations=iterations))
    lacking = missing(problem, result.coordinates[0], targets, MIDDLE.priority)
    miss = np.linalg.norm(lacking[:3]) * problem.length
    assert abs(result.positions[0, 1] - miss) < 1e-9
    assert (0, 1) in result.missed
    assert IkStatus.CONVERGED not in result.statuses


def test_warm_frames_hold_the_hard_goal() -> None:
    problem = build(
        mixed_rig(), [Goal("hand", (0.1, 0.0, 0.0)), Goal("other", priority=1)]
    )
    pose = random_pose(problem, 3)
    path = np.repeat(pose, 40, axis=0)
    path[:, 0] += np.linspace(0, 1, 40)
    targets = reached_by(problem, path)
    positions = np.array(targets.positions)
    positions[:, 1] += [0.0, 2.0, 0.0]
    result = solve(problem, pose[0], Targets(positions), IkOptions(warm=True))
    assert set(result.statuses) == {IkStatus.YIELDED}
    assert result.positions[:, 0].max() <= 1e-6 * problem.length
    assert np.ptp(result.positions[:, 1]) < 1e-3 * result.positions[:, 1].max()


@pytest.mark.parametrize("priority", [-1, 0.5])
def test_priorities_are_whole_numbers_from_zero(priority: float) -> None:
    with pytest.raises(OptionError) as caught:
        build(arm(1), [Goal("b0", (1, 0, 0), priority=priority)])  # type: ignore[arg-type]
    assert caught.value.code == "IK002"
