"""The closed form of a limb against geometry and against damped steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.ik import limb, random_pose, reached_by
from support.suite import examples

from animtool.ik import Goal, IkMethod, IkOptions, IkStatus, Targets, build, solve
from animtool.ik.goals import GOAL_KINDS
from animtool.ik.rig_solver import two_bone_obstacle
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import JointType, Rig

GOAL = Goal("elbow", (0.27, 0.0, 0.0))
SEEDS = st.integers(0, 2**32 - 1)


def with_elbow(**changes: object) -> Rig:
    shoulder, elbow = limb().joints
    return Rig("limb", (shoulder, replace(elbow, **changes)))


@settings(max_examples=examples(50))
@given(SEEDS, st.sampled_from([JointType.PIN, JointType.BALL]))
def test_points_in_reach_are_reached_to_rounding(seed: int, kind: JointType) -> None:
    problem = build(with_elbow(type=kind), [replace(GOAL, pole=1.0)])
    assert two_bone_obstacle(problem) is None
    start, wanted = random_pose(problem, seed), random_pose(problem, seed ^ 1)
    result = solve(problem, start, reached_by(problem, wanted))
    assert result.positions.max() < 1e-12
    assert result.poles.max() < 1e-9


@pytest.mark.parametrize("target", [[9.0, 0.0, 1.0], [0.11, 1.2, 0.0], [0.1, 1.2, 0.0]])
def test_points_out_of_reach_are_approached_as_near_as_can_be(
    target: list[float],
) -> None:
    problem = build(limb(), [GOAL])
    result = solve(problem, None, Targets([[target]]))
    distance = np.linalg.norm(np.array(target) - [0.1, 1.2, 0.0])
    nearest = max(distance - 0.59, 0.05 - distance)
    assert abs(result.positions[0, 0] - nearest) < 1e-12
    assert result.statuses == (IkStatus.NEAREST,)


def test_the_elbow_keeps_its_limits_and_what_they_forbid_is_solved_by_steps() -> None:
    bent = build(with_elbow(limits=RangeLimit(0.0, 2.0)), [GOAL])
    # On the other side at first, and too near for the elbow's range.
    targets = Targets([[[0.5, 1.4, 0.0]], [[0.2, 1.2, 0.0]]])
    result = solve(bent, [0.0, 0.0, 0.0, 1.0, 0.5], targets)
    assert result.statuses == (IkStatus.CONVERGED, IkStatus.NEAREST)
    assert 0 <= result.coordinates[:, 4].min() <= result.coordinates[:, 4].max() <= 2
    assert abs(result.coordinates[1, 4] - 2) < 1e-6


@pytest.mark.parametrize(
    "problem",
    [
        build(limb(), [replace(GOAL, orientation=1.0)]),
        build(with_elbow(axis=(1.0, 0.0, 0.0)), [GOAL]),
        build(with_elbow(type=JointType.BALL, limits=BallLimit((1.0, 1.0))), [GOAL]),
        build(limb(), [Goal("elbow")]),
        build(limb(), [GOAL], rest_weight=0.1),
        build(limb(), [GOAL], joints=["elbow"]),
    ],
)
def test_other_problems_do_not_fit(problem: object) -> None:
    assert two_bone_obstacle(problem) is not None  # type: ignore[arg-type]


def test_the_start_decides_the_side_and_the_way_it_turns() -> None:
    problem = build(limb(), [GOAL])
    target = Targets([[[0.5, 1.3, 0.1]]])
    for bend in (-1.0, 1.0):
        result = solve(problem, [0.0, 0.0, 0.0, 1.0, bend], target)
        assert np.sign(result.coordinates[0, 4]) == bend


def test_damped_steps_agree() -> None:
    problem = build(limb(), [replace(GOAL, pole=1.0)])
    start = random_pose(problem, 5, frames=20)
    targets = reached_by(problem, random_pose(problem, 6, frames=20))
    result = solve(problem, start, targets, IkOptions(IkMethod.DAMPED))
    assert result.converged.all()


def test_limbs_leave_out_what_a_frame_does_not_ask_for() -> None:
    problem = build(limb(), [replace(GOAL, pole=1.0)])
    start = random_pose(problem, 5, frames=4)
    targets = reached_by(problem, random_pose(problem, 6, frames=4))
    targets = replace(targets, poles=np.full((4, 1, 3), 0.7))
    weights = np.ones((4, 1, len(GOAL_KINDS)))
    weights[1, 0, 3] = 0.0  # no pole
    weights[2, 0, 0] = 0.0  # the pole alone
    weights[3] = 0.0
    result = solve(problem, start, replace(targets, weights=weights))
    assert result.converged.all()
    unpoled = build(limb(), [GOAL])
    plain = solve(unpoled, start[1], Targets(np.array(targets.positions)[1:2]))
    np.testing.assert_allclose(result.coordinates[1], plain.coordinates[0], atol=1e-12)
    assert result.iterations[2] > 0
    assert (result.coordinates[2] != start[2]).any()
    np.testing.assert_allclose(result.coordinates[3], start[3], atol=1e-15)
    warm = solve(
        problem, start[0], replace(targets, weights=weights), IkOptions(warm=True)
    )
    np.testing.assert_array_equal(warm.coordinates[3], warm.coordinates[2])


@pytest.mark.parametrize(
    ("start", "turn", "side"),
    [
        (-30.0, 0, 1),
        (30.0, 0, 1),
        (-100.0, 0, -1),
        (400.0, 360, 1),
        (-390.0, -360, 1),
        (-460.0, -360, -1),
    ],
)
def test_an_elbow_bends_to_the_side_and_the_turn_where_it_is(
    start: float, turn: float, side: int
) -> None:
    """It rests bent by 60 degrees: at -60 it is straight, where sides change."""
    rest = so3.from_axis_angle([0.0, 0.0, 1.0], np.radians(60.0))
    rig = with_elbow(
        rotation=tuple(rest.tolist()),
        axis=(0.0, 0.0, 1.0),
        limits=RangeLimit(-10.0, 10.0),
    )
    far, target = 0.45, Targets([[[0.1, 1.65, 0.0]]])
    begin = [0.0, 0.0, 0.0, 1.0, np.radians(start)]
    result = solve(build(rig, [GOAL]), begin, target)
    # The law of cosines.
    cosine = (far**2 - 0.32**2 - 0.27**2) / (2 * 0.32 * 0.27)
    expected = turn + side * np.degrees(np.arccos(cosine)) - 60
    assert np.degrees(result.coordinates[0, 4]) == pytest.approx(expected)
