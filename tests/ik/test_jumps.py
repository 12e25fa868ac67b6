"""Steps of joints that targets do not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.ik import arm, every_goal, mixed_rig, random_pose, reached_by

from animtool.ik import Goal, IkOptions, build, follow
from animtool.ik.chain import seamless
from animtool.ik.goals import COLUMNS
from animtool.ik.path import Path, explained, jumping, named, path_of, strain
from animtool.ik.result import Jump
from animtool.rig.limits import RangeLimit


def standing(frames: int = 6) -> tuple[Path, np.ndarray]:
    problem = build(mixed_rig(), every_goal()[:1])
    rows = np.repeat(random_pose(problem, 1), frames, axis=0)
    path = path_of(problem, reached_by(problem, rows), None, IkOptions())
    return path, problem.chain.from_rig(rows)


def test_joints_that_stand_do_not_jump() -> None:
    path, poses = standing()
    allowed = explained(path, 24.0)
    assert strain(path, poses, allowed) < 1e-12
    assert len(jumping(path, poses, allowed)) == 0


def test_a_jump_is_named_by_frame_joint_and_size() -> None:
    path, poses = standing()
    allowed = explained(path, 24.0)
    elbow = int(np.flatnonzero(path.problem.chain.nodes[:, 0] == 0)[0])
    column = path.problem.chain.nodes[elbow, 2]
    poses[4:, column] += 0.9
    (jump,) = named(path, poses, allowed)
    assert jump == Jump(4, "elbow", jump.size)
    assert jump.size == pytest.approx(0.9)
    assert strain(path, poses, allowed) > 1


@pytest.mark.parametrize(("props", "names"), [(0.0, 1), (0.03, 1), (0.08, 0)])
def test_a_jerk_is_named_that_is_no_fast_one(props: float, names: int) -> None:
    path, poses = standing(9)
    allowed = explained(path, 24.0)
    elbow = int(np.flatnonzero(path.problem.chain.nodes[:, 0] == 0)[0])
    column = path.problem.chain.nodes[elbow, 2]
    steps = np.array([0, 0, props, props, 0.2, props, props, 0, 0])
    poses[:, column] += np.cumsum(steps)
    assert strain(path, poses, allowed) < 1
    found = named(path, poses, allowed)
    assert [(jump.frame, jump.joint) for jump in found] == [(4, "elbow")] * names


def test_fast_targets_and_slow_rates_explain_more() -> None:
    path, _ = standing()
    still = explained(path, 60.0)
    assert (explained(path, 24.0) > still).all()
    moving = path.targets.copy()
    moving[3:, :, 0] += 0.5
    fast = explained(replace(path, targets=moving), 60.0)
    assert np.flatnonzero(fast > still).tolist() == [2]


def test_targets_that_are_not_asked_explain_nothing() -> None:
    path, _ = standing()
    assert isinstance(path.targets, np.ndarray)
    moving = path.targets.copy()
    moving[3:, :, 0] += 0.5
    moving[3, :, 13:] = 0
    gone = replace(path, targets=moving)
    np.testing.assert_array_equal(explained(gone, 60.0), explained(path, 60.0))


def test_targets_of_no_weight_explain_nothing() -> None:
    """A goal that does not turn to its target: turns of the target are no reason."""
    problem = build(mixed_rig(), [Goal("hand", orientation=0.0)])
    rows = np.repeat(random_pose(problem, 1), 6, axis=0)
    path = path_of(problem, reached_by(problem, rows), None, IkOptions())
    moving = path.targets.copy()
    moving[3:, :, COLUMNS["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    turned = replace(path, targets=moving)
    np.testing.assert_array_equal(explained(turned, 60.0), explained(path, 60.0))


def test_the_motion_of_a_clip_is_no_jump() -> None:
    problem = build(mixed_rig(), every_goal()[:1])
    rows = random_pose(problem, 1, frames=5)
    targets = reached_by(problem, rows)
    path = path_of(problem, targets, rows, IkOptions())
    poses = problem.chain.from_rig(rows)
    np.testing.assert_allclose(path.steps(poses), 0.0, atol=1e-12)
    assert len(jumping(path, poses, explained(path, 24.0))) == 0


@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_a_whole_turn_has_no_end_to_jump_over(low: float) -> None:
    rig = arm(2)
    limits = RangeLimit(low, low + 2 * np.pi)
    joints = (replace(rig.joints[0], limits=limits), rig.joints[1])
    problem = build(replace(rig, joints=joints), [Goal("b1", (0.4, 0.0, 0.0))])
    base = np.linspace(low - 0.5, low + 0.5, 60)
    rows = np.stack([np.where(base < low, base + 2 * np.pi, base), 0 * base + 0.5], 1)
    found = follow(problem, rows[0], reached_by(problem, rows))
    assert found.converged.all()
    assert found.jumps == ()
    assert (found.coordinates[:, 0] >= low).all()
    # Where the range is wider, it matters which of its turns a joint is in.
    steps = np.array([[2 * np.pi, 0.1]])
    np.testing.assert_allclose(seamless(problem.chain, steps), [[0, 0.1]], atol=1e-12)
    hair = RangeLimit(low - 0.005, low + 2 * np.pi + 0.005)
    joints = (replace(rig.joints[0], limits=hair), rig.joints[1])
    wider = build(replace(rig, joints=joints), [Goal("b1", (0.4, 0.0, 0.0))])
    np.testing.assert_allclose(seamless(wider.chain, steps), [[0, 0.1]], atol=1e-12)
    wide = build(arm(2, 2 * np.pi), [Goal("b1", (0.4, 0.0, 0.0))])
    np.testing.assert_array_equal(seamless(wide.chain, steps), steps)
