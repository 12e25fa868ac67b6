"""Distances between poses of a chain."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.ik import every_goal, mixed_rig, random_pose

from animtool.ik import Goal, build
from animtool.ik.tangent import difference, moved, unwound, with_periods
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_a_pose_moved_by_the_difference_is_the_other(seed: int) -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    start, end = problem.chain.from_rig(random_pose(problem, seed, frames=2))
    step = difference(problem.chain, start, end)
    assert step.shape == (problem.degrees,)
    back = difference(problem.chain, moved(problem.chain, start, step), end)
    np.testing.assert_allclose(back, 0.0, atol=1e-12)


def test_many_poses_are_compared_with_one() -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    poses = problem.chain.from_rig(random_pose(problem, 1, frames=4))
    steps = difference(problem.chain, poses[0], poses)
    assert steps.shape == (4, problem.degrees)
    np.testing.assert_allclose(moved(problem.chain, poses[0], steps[2:3])[0], poses[2])


def wheel(limits: RangeLimit | None) -> Rig:
    joints = (Joint("wheel", -1, JointType.PIN, limits=limits),)
    return Rig("wheel", joints)


def test_pins_without_limits_go_the_short_way_round() -> None:
    chain = build(wheel(None), [Goal("wheel", (1.0, 0.0, 0.0))]).chain
    poses = np.array([[3.0], [-3.0], [-2.8]])
    step = difference(chain, poses[0], poses[1])
    np.testing.assert_allclose(step, 2 * np.pi - 6.0)
    np.testing.assert_allclose(np.diff(unwound(chain, poses)[:, 0]).max(), step)


def test_pins_between_limits_do_not_though_these_leave_no_gap() -> None:
    for limits in (RangeLimit(-3.1, 3.1), RangeLimit(-4.0, 4.0)):
        chain = build(wheel(limits), [Goal("wheel", (1.0, 0.0, 0.0))]).chain
        poses = np.array([[3.0], [-3.0]])
        np.testing.assert_allclose(difference(chain, poses[0], poses[1]), -6.0)
        np.testing.assert_array_equal(unwound(chain, poses), poses)
        low, high = with_periods(chain)[0, 14:16]
        np.testing.assert_allclose([low, high], [limits.low, limits.high])
