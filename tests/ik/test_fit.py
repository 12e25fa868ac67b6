"""Whole clips fitted to goals that no pose reaches."""

from __future__ import annotations

import numpy as np
import pytest
from support.marked import FIGURE, TEMPLATE, captured, joint_errors, moving

from animtool.core.array_types import FloatArray
from animtool.ik.fit import ANCHOR_WEIGHT, FitOptions, fit
from animtool.ik.goals import GOAL_KINDS, Goal, Targets
from animtool.ik.problem import Problem, build
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

FPS = 50.0


def weighted(problem: Problem, weights: FloatArray) -> FloatArray:
    """Return weights ``(F, E)`` of positions, in lengths of a problem, of all kinds."""
    out = np.zeros((*weights.shape, len(GOAL_KINDS)))
    out[:, :, 0] = weights * problem.length
    return out


def lift(limits: RangeLimit | None = None) -> Problem:
    """Return a problem that is linear: what goes up and down."""
    slide = JointType.PRISMATIC
    joint = Joint("lift", -1, slide, axis=(0.0, 1.0, 0.0), limits=limits)
    return build(Rig("lift", (joint,)), [Goal("lift"), Goal("lift", (0.0, 1.0, 0.0))])


def test_a_linear_problem_is_that_of_linear_algebra() -> None:
    problem, rng, frames = lift(), np.random.default_rng(1), 40
    wanted = rng.normal(size=(frames, 2, 3)) * [0, 1, 0] + [[0, 0, 0], [0, 1, 0]]
    weights = rng.uniform(0, 30, (frames, 2)) * (rng.random((frames, 2)) < 0.6)
    acceleration = 20.0
    options = FitOptions(FPS, acceleration, rounds=50)
    start = np.zeros((frames, 1))
    found = fit(
        problem,
        Targets(wanted, weights=weighted(problem, weights)),
        start,
        options,
        path=start,
    )
    # In metres: sum w^2 (y - q)^2 + b (D q / L)^2 + a (q / L)^2.
    second = np.diff(np.eye(frames), 2, axis=0)
    bend = (FPS**2 / acceleration) ** 2 / problem.length**2
    matrix = bend * second.T @ second + ANCHOR_WEIGHT / problem.length**2 * np.eye(
        frames
    )
    matrix += np.diag((weights**2).sum(axis=1))
    right = (weights**2 * (wanted[:, :, 1] - [0, 1])).sum(axis=1)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(found.coordinates[:, 0], expected, atol=1e-6)
    assert found.cost_after < found.cost_before


def test_a_linear_problem_of_two_ways_is_that_of_linear_algebra() -> None:
    """Up and along, each by itself, though they are one goal of one pose."""
    slide = JointType.PRISMATIC
    joints = (
        Joint("up", -1, slide, axis=(0.0, 1.0, 0.0)),
        Joint("along", 0, slide, axis=(1.0, 0.0, 0.0), translation=(0.0, 1.0, 0.0)),
    )
    problem = build(Rig("slides", joints), [Goal("along")])
    rng, frames = np.random.default_rng(1), 30
    wanted = rng.normal(size=(frames, 1, 3)) * [1, 1, 0]
    weights = rng.uniform(5, 30, (frames, 1))
    start = np.zeros((frames, 2))
    options = FitOptions(FPS, 20.0, rounds=50)
    targets = Targets(wanted + np.array([0, 1, 0]), weights=weighted(problem, weights))
    found = fit(problem, targets, start, options, path=start)
    second = np.diff(np.eye(frames), 2, axis=0)
    bend = (FPS**2 / 20.0) ** 2 / problem.length**2
    matrix = bend * second.T @ second + ANCHOR_WEIGHT / problem.length**2 * np.eye(
        frames
    )
    matrix += np.diag(weights[:, 0] ** 2)
    right = weights**2 * wanted[:, 0, [1, 0]]
    np.testing.assert_allclose(
        found.coordinates, np.linalg.solve(matrix, right), atol=1e-6
    )


def test_limits_are_kept_and_the_rest_is_best_within_them() -> None:
    problem, frames = lift(RangeLimit(-0.5, 0.5)), 30
    height = np.linspace(-2, 2, frames)
    wanted = np.zeros((frames, 2, 3))
    wanted[:, :, 1] = height[:, None] + [0, 1]
    targets = Targets(wanted, weights=weighted(problem, np.full((frames, 2), 1e4)))
    start = np.zeros((frames, 1))
    found = fit(problem, targets, start, FitOptions(FPS, np.inf), path=start)
    np.testing.assert_allclose(
        found.coordinates[:, 0], np.clip(height, -0.5, 0.5), atol=1e-7
    )


def figure() -> Problem:
    return build(FIGURE, [Goal(m.joint, m.offset) for m in TEMPLATE.markers])


def test_poses_are_found_from_afar_through_outliers() -> None:
    problem, truth = figure(), captured(moving(60, FPS, 3), FPS)
    positions = truth.markers.positions.copy()
    rng = np.random.default_rng(5)
    spikes = rng.random(positions.shape[:2]) < 0.05
    positions[spikes] += rng.normal(scale=0.3, size=(int(spikes.sum()), 3))
    start = np.zeros_like(truth.coordinates)
    start[:, 6] = start[:, 10] = start[:, 14] = start[:, 19] = 1.0
    start[:, :7] = truth.coordinates[:, :7]
    seen = np.full(positions.shape[:2], 1 / 0.001)
    targets = Targets(positions, weights=weighted(problem, seen))
    robust = fit(problem, targets, start, FitOptions(FPS, robust=8.0))
    plain = fit(problem, targets, start, FitOptions(FPS))
    assert joint_errors(robust.coordinates, truth, FIGURE).max() < 0.004
    assert joint_errors(plain.coordinates, truth, FIGURE).max() > 0.01


def test_the_same_bytes_each_time() -> None:
    problem, truth = figure(), captured(moving(20, FPS, 4), FPS)
    start = np.zeros_like(truth.coordinates)
    start[:, 6] = start[:, 10] = start[:, 14] = start[:, 19] = 1.0
    seen = np.full(truth.markers.positions.shape[:2], 1 / 0.001)
    targets = Targets(truth.markers.positions, weights=weighted(problem, seen))
    one, two = (
        fit(problem, targets, start, FitOptions(FPS, robust=8.0)) for _ in range(2)
    )
    assert one.coordinates.tobytes() == two.coordinates.tobytes()


def test_frames_before_the_first_stay() -> None:
    problem, truth = figure(), captured(moving(20, FPS, 4), FPS)
    seen = np.full(truth.markers.positions.shape[:2], 1 / 0.001)
    targets = Targets(truth.markers.positions, weights=weighted(problem, seen))
    path = truth.coordinates.copy()
    found = fit(problem, targets, path, FitOptions(FPS, robust=8.0), path=path, first=5)
    np.testing.assert_allclose(found.coordinates[:5], path[:5], atol=1e-12)
    assert joint_errors(found.coordinates, truth, FIGURE).max() < 0.002


@pytest.mark.parametrize("missing", [slice(0, 12), slice(8, 20), slice(0, 20)])
def test_frames_without_goals_stay_finite(missing: slice) -> None:
    problem, truth = figure(), captured(moving(20, FPS, 4), FPS)
    seen = np.full(truth.markers.positions.shape[:2], 1 / 0.001)
    seen[missing] = 0
    start = np.zeros_like(truth.coordinates)
    start[:, 6] = start[:, 10] = start[:, 14] = start[:, 19] = 1.0
    targets = Targets(truth.markers.positions, weights=weighted(problem, seen))
    found = fit(problem, targets, start, FitOptions(FPS, robust=8.0))
    assert np.isfinite(found.coordinates).all()
