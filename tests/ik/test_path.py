"""Frames of one problem as a whole."""

from __future__ import annotations

import numpy as np
from support.ik import arm, every_goal, mixed_rig, random_pose, reached_by

from animtool.ik import Goal, IkOptions, build, solve
from animtool.ik.path import path_of
from animtool.ik.tangent import difference


def test_misses_are_those_of_a_solve() -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    targets = reached_by(problem, random_pose(problem, 2, frames=3))
    rows = random_pose(problem, 5, frames=3)
    path = path_of(problem, targets, None, IkOptions())
    result = solve(problem, rows, targets, IkOptions(iterations=3, restarts=0))
    poses = problem.chain.from_rig(result.coordinates)
    misses = path.measured(poses)
    lengths = misses[:, :, 0] * problem.length
    np.testing.assert_allclose(lengths, result.positions, atol=1e-12)
    np.testing.assert_allclose(misses[:, :, 1], result.orientations, atol=1e-9)
    assert ((path.excess(misses) > 1) == ~result.converged).all()


def test_an_even_path_keeps_its_ends_and_its_goals() -> None:
    problem = build(arm(5, limit=2.5), [Goal("b4", (0.3, 0.0, 0.0))])
    pose = random_pose(problem, 3) / 2
    targets = reached_by(problem, np.repeat(pose, 20, axis=0))
    path = path_of(problem, targets, None, IkOptions())
    start = solve(problem, pose, reached_by(problem, pose)).coordinates
    other = solve(problem, pose + 0.3, reached_by(problem, pose)).coordinates
    rows = np.concatenate([np.repeat(start, 10, axis=0), np.repeat(other, 10, axis=0)])
    poses = problem.chain.from_rig(rows)
    even, misses = path.evened(poses)
    np.testing.assert_array_equal(even[[0, -1]], poses[[0, -1]])
    assert (path.excess(misses) <= 1).all()
    steps = np.linalg.norm(difference(problem.chain, even[:-1], even[1:]), axis=1)
    jump = np.linalg.norm(difference(problem.chain, poses[9], poses[10]))
    assert steps.max() < 2 * jump / 19


def test_a_stretch_of_a_path_has_its_own_targets_and_drifts() -> None:
    problem = build(mixed_rig(), every_goal()[:1])
    rows = random_pose(problem, 1, frames=8)
    path = path_of(problem, reached_by(problem, rows), rows, IkOptions())
    part = path.frames(slice(2, 6))
    np.testing.assert_array_equal(part.targets, path.targets[2:6])
    np.testing.assert_array_equal(part.drifts, path.drifts[2:5])
    poses = problem.chain.from_rig(rows)[2:6]
    np.testing.assert_allclose(part.steps(poses), 0.0, atol=1e-12)
