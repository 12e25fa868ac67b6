"""Frames of one problem as a whole, and poses of a clip smoothed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
from animtool.ik import (
    Goal,
    IkOptions,
    IkResult,
    IkStatus,
    Problem,
    Targets,
    build,
    smooth,
    solve,
)
from animtool.ik import path as ik_path
from animtool.ik.chain import apply_steps, joint_steps
from animtool.ik.goals import GOAL_KINDS
from animtool.ik.path import build_frame_path, with_poses
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig


def test_misses_are_those_of_a_solve() -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    targets = reached_by(problem, random_pose(problem, 2, frames=3))
    rows = random_pose(problem, 5, frames=3)
    path = build_frame_path(problem, targets, None, IkOptions())
    result = solve(problem, rows, targets, IkOptions(iterations=3, restarts=0))
    poses = problem.chain.from_rig(result.coordinates)
    misses = path.measure_misses(poses)
    lengths = misses[:, :, 0] * problem.length
    np.testing.assert_allclose(lengths, result.positions, atol=1e-12)
    np.testing.assert_allclose(misses[:, :, 1], result.orientations, atol=1e-9)
    assert ((path.max_tolerance_ratio(misses) > 1) == ~result.converged).all()


def test_an_even_path_keeps_its_ends_and_its_goals() -> None:
    problem = build(arm(5, limit=2.5), [Goal("b4", (0.3, 0.0, 0.0))])
    pose = random_pose(problem, 3) / 2
    targets = reached_by(problem, np.repeat(pose, 20, axis=0))
    path = build_frame_path(problem, targets, None, IkOptions())
    start = solve(problem, pose, reached_by(problem, pose)).coordinates
    other = solve(problem, pose + 0.3, reached_by(problem, pose)).coordinates
    rows = np.concatenate([np.repeat(start, 10, axis=0), np.repeat(other, 10, axis=0)])
    poses = problem.chain.from_rig(rows)
    even, misses = path.with_even_speed(poses)
    np.testing.assert_array_equal(even[[0, -1]], poses[[0, -1]])
    assert (path.max_tolerance_ratio(misses) <= 1).all()
    steps = np.linalg.norm(joint_steps(problem.chain, even[:-1], even[1:]), axis=1)
    jump = np.linalg.norm(joint_steps(problem.chain, poses[9], poses[10]))
    assert steps.max() < 2 * jump / 19


def test_a_stretch_of_a_path_has_its_own_targets_and_drifts() -> None:
    problem = build(mixed_rig(), every_goal()[:1])
    rows = random_pose(problem, 1, frames=8)
    path = build_frame_path(problem, reached_by(problem, rows), rows, IkOptions())
    part = path.select_frames(slice(2, 6))
    np.testing.assert_array_equal(part.targets, path.targets[2:6])
    np.testing.assert_array_equal(part.preserved_steps, path.preserved_steps[2:5])
    poses = problem.chain.from_rig(rows)[2:6]
    np.testing.assert_allclose(part.steps(poses), 0.0, atol=1e-12)


SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=examples(15), deadline=None)
FPS = 30.0


def wander(problem: Problem, seed: int, frames: int = 40) -> FloatArray:
    """Return a path ``(F, Q)`` through a few poses, with a tremble."""
    chain = problem.chain
    keys = chain.from_rig(random_pose(problem, seed, frames=4))
    rng = np.random.default_rng(seed)
    rows = []
    for at in np.linspace(0, 3, frames, endpoint=False):
        i = int(at)
        step = joint_steps(chain, keys[i], keys[i + 1]) * (at - i)
        rows.append(apply_steps(chain, keys[i], step + rng.normal(0, 0.01, len(step))))
    return chain.into_rig(np.array(rows), random_pose(problem, seed, frames=frames))


def followed(problem: Problem, seed: int) -> tuple[IkResult, Targets]:
    """Return poses that reach targets which exist, not smoothly."""
    targets = reached_by(problem, wander(problem, seed))
    start = random_pose(problem, seed)[0]
    return solve(problem, start, targets, IkOptions(warm=True)), targets


def redundant() -> Problem:
    return build(arm(6, limit=2.0), [Goal("b5", (0.3, 0.0, 0.0))])


def acceleration(result: IkResult) -> float:
    chain = result.problem.chain
    poses = chain.from_rig(result.coordinates)
    steps = joint_steps(chain, poses[:-1], poses[1:])
    return float((np.diff(steps, axis=0) ** 2).sum())


@pytest.mark.slow
@FEW
@given(SEEDS, st.sampled_from([0.02, 0.1, 0.5]))
def test_goals_that_are_met_stay_met_and_limits_are_kept(
    seed: int, seconds: float
) -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    result, targets = followed(problem, seed)
    smoother = smooth(result, targets, seconds, fps=FPS)
    assert not (result.converged & ~smoother.converged).any()
    assert smoother.positions[result.converged].max() <= 1e-6 * problem.length
    assert beyond_limits(problem, smoother.coordinates) == 0.0
    assert acceleration(smoother) <= acceleration(result)


@FEW
@given(SEEDS)
def test_no_time_changes_nothing(seed: int) -> None:
    result, targets = followed(redundant(), seed)
    assert smooth(result, targets, 0.0, fps=FPS) is result


def test_more_time_makes_it_smoother() -> None:
    result, targets = followed(redundant(), 3)
    sums = [
        acceleration(smooth(result, targets, seconds, fps=FPS))
        for seconds in (0.0, 0.03, 0.1, 0.3)
    ]
    assert sums == sorted(sums, reverse=True)
    assert sums[-1] < 0.5 * sums[0]


@pytest.mark.parametrize("seed", range(6))
def test_time_backwards_gives_the_same_backwards(seed: int) -> None:
    problem = redundant()
    result, targets = followed(problem, seed)
    assert isinstance(targets.positions, np.ndarray)
    turned = replace(
        result,
        coordinates=result.coordinates[::-1].copy(),
        statuses=result.statuses[::-1],
    )
    back = Targets(targets.positions[::-1])
    here = smooth(result, targets, 0.05, fps=FPS)
    there = smooth(turned, back, 0.05, fps=FPS)
    apart = here.coordinates - there.coordinates[::-1]
    change = here.coordinates - result.coordinates
    assert (apart**2).mean() <= 0.3**2 * (change**2).mean()
    assert acceleration(there) == pytest.approx(acceleration(here), rel=0.1)


def test_the_same_clip_gives_the_same_bytes() -> None:
    result, targets = followed(redundant(), 5)
    once = smooth(result, targets, 0.1, fps=FPS)
    again = smooth(result, targets, 0.1, fps=FPS)
    assert once.coordinates.tobytes() == again.coordinates.tobytes()


def test_what_is_missed_is_missed_as_before() -> None:
    problem = build(arm(4, limit=2.0), [Goal("b3", (0.3, 0.0, 0.0), orientation=1.0)])
    turn = np.linspace(0, 1, 30)
    far = np.stack([3 * np.cos(turn), 3 * np.sin(turn), 0 * turn], axis=1)[:, None]
    targets = Targets(far, np.tile([0.0, 0.0, 0.0, 1.0], (30, 1, 1)))
    result = solve(problem, None, targets, IkOptions(warm=True, restarts=5))
    smoother = smooth(result, targets, 0.1, fps=FPS)
    assert not result.converged.any()
    np.testing.assert_allclose(smoother.positions, result.positions, atol=1e-5)
    np.testing.assert_allclose(smoother.orientations, result.orientations, atol=1e-5)


def test_poses_that_miss_are_no_longer_reached() -> None:
    result, targets = followed(redundant(), 3)
    path = build_frame_path(result.problem, targets, None, IkOptions())
    poses = result.problem.chain.from_rig(result.coordinates)
    misses = np.zeros((len(poses), 1, len(GOAL_KINDS)))
    assert with_poses(result, poses, misses, path).statuses == result.statuses
    misses[1:] = np.arange(1.0, 1.0 + len(GOAL_KINDS))
    found = with_poses(result, poses, misses, path)
    assert found.statuses[0] is result.statuses[0] is IkStatus.CONVERGED
    assert set(found.statuses[1:]) == {IkStatus.NEAREST}
    assert found.reached[:, 0].tolist() == [True, *[False] * (len(poses) - 1)]
    assert found.positions[1, 0] == result.problem.chain.length
    angles = (found.orientations[1, 0], found.aims[1, 0], found.poles[1, 0])
    assert angles == (2.0, 3.0, 4.0)
    conflict = replace(result, statuses=(IkStatus.CONFLICT,) * len(poses))
    again = with_poses(conflict, poses, misses, path)
    assert again.statuses[:2] == (IkStatus.CONVERGED, IkStatus.CONFLICT)


def test_the_motion_of_a_clip_is_kept() -> None:
    # A tremble of the clip itself stays, where the goals leave it alone.
    problem = redundant()
    rng = np.random.default_rng(0)
    start = random_pose(problem, 1) + rng.normal(0, 0.02, (40, 6))
    targets = reached_by(problem, start)
    result = solve(problem, start, targets)
    kept = smooth(result, targets, 0.2, fps=FPS, start=start)
    np.testing.assert_allclose(kept.coordinates, start, atol=1e-6)
    lost = smooth(result, targets, 0.2, fps=FPS)
    assert np.abs(lost.coordinates - start).max() > 1e-3


@pytest.mark.parametrize(("seconds", "fps"), [(-1.0, 24.0), (np.nan, 24.0), (0.1, 0.0)])
def test_a_time_or_rate_that_makes_no_sense_is_refused(
    seconds: float, fps: float
) -> None:
    result, targets = followed(redundant(), 1)
    with pytest.raises(OptionError) as caught:
        smooth(result, targets, seconds, fps=fps)
    assert {fault.code for fault in caught.value.faults} == {"IK014"}


def test_limbs_that_ease_and_stretch_are_smoothed_as_they_are_solved() -> None:
    goal = Goal("b3", (0.3, 0.0, 0.0), root="b0", soft=0.1, stretch=0.2)
    problem = build(arm(4), [goal])
    away = np.linspace(1.0, 2.2, 60)
    turn = np.linspace(0, 1, 60)
    points = [away * np.cos(turn), away * np.sin(turn), 0.1 * turn]
    targets = Targets(np.stack(points, axis=1)[:, None])
    result = solve(problem, [0.1, 0.4, 0.3, 0.2], targets, IkOptions(warm=True))
    assert result.stretches.max() > 1.1
    smoother = smooth(result, targets, 0.1, fps=FPS)
    assert smoother.statuses == result.statuses
    np.testing.assert_array_equal(smoother.stretches, result.stretches)
    np.testing.assert_allclose(smoother.positions, result.positions, atol=1e-5)
    assert acceleration(smoother) <= acceleration(result)


@pytest.mark.parametrize("seed", range(3))
def test_blocks_of_a_long_path_join_smoothly(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    problem = redundant()
    result, targets = followed(problem, seed)
    whole = smooth(result, targets, 0.01, fps=FPS)
    monkeypatch.setattr(ik_path, "MIN_BLOCK_FRAMES", 5)
    blocks = smooth(result, targets, 0.01, fps=FPS)
    assert not np.array_equal(blocks.coordinates, whole.coordinates)
    assert not (result.converged & ~blocks.converged).any()
    assert acceleration(blocks) <= 1.05 * acceleration(whole)


@pytest.mark.parametrize(("gain", "is_geared"), [(0.5, True), (2.0, False)])
def test_a_revolution_that_moves_followers_is_kept(
    gain: float, is_geared: bool
) -> None:
    """Of half a revolution a geared joint turns; of two it is where it was."""
    bone, axis = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    lead = Joint("lead", -1, JointType.PIN, axis=axis)
    mimic = Mimic("lead", gain)
    tail = Joint("tail", 0, JointType.PIN, translation=bone, axis=axis, mimic=mimic)
    free = Joint("free", 1, JointType.PIN, translation=bone, axis=axis)
    tip = Joint("tip", 2, JointType.FIXED, translation=bone)
    rig = Rig("gear", (lead, tail, free, tip))
    angles = np.linspace(2.5, 4.0, 40)
    angles[angles > np.pi] -= 2 * np.pi
    coordinates = np.stack([angles, gain * angles, np.linspace(0.2, 0.4, 40)], axis=1)
    local = local_from_coordinates(rig, coordinates)
    world = forward_kinematics(rig, local.translations, local.rotations)
    targets = Targets(positions=world.positions[:, 3:])
    problem = build(rig, [Goal("tip")])
    assert problem.chain.is_geared.tolist() == [is_geared, False]
    steps = joint_steps(problem.chain, coordinates[:1, ::2], coordinates[-1:, ::2])
    assert abs(steps[0, 0]) == pytest.approx(4.78 if is_geared else 1.5, abs=0.01)
    result = solve(problem, coordinates, targets)
    smoothed = smooth(result, targets, 0.1, fps=24)
    assert smoothed.converged.all()
    assert smoothed.positions.max() < 1e-5
