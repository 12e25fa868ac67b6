"""Steps of joints beyond those of the motion that a solve started from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.ik import arm, every_goal, mixed_rig, random_pose, reached_by

from animtool.core.array_types import FloatArray
from animtool.ik import Goal, IkOptions, build, follow
from animtool.ik.goals import TARGET_COLUMNS
from animtool.ik.jumps import Jump, find_jumps, jump_threshold
from animtool.ik.path import FramePath, build_frame_path, full_revolutions, goal_steps
from animtool.maths import so3
from animtool.rig.joints import LocalTransforms
from animtool.rig.limits import RangeLimit


def turning(angles: FloatArray) -> LocalTransforms:
    """Return one joint that turns about z by angles ``(F,)`` [rad]."""
    rotations = so3.from_axis_angle(np.array([0.0, 0.0, 1.0]), angles)[:, None]
    return LocalTransforms(np.zeros((len(angles), 1, 3)), rotations)


def found(
    after: FloatArray,
    before: FloatArray | None = None,
    moves: float = 0.0,
    fps: float = 24.0,
) -> tuple[Jump, ...]:
    source = None if before is None else turning(before)
    goals = np.full(len(after) - 1, moves)
    return find_jumps(["j"], source, turning(after), goals, fps=fps, length=1.0)


def with_jump(size: float, frames: int = 24, at: int = 12) -> FloatArray:
    """Return a slow turn with a jump of a size [rad]."""
    angles = np.linspace(0.0, 0.3, frames)
    angles[at:] += size
    return angles


def test_slow_turns_and_what_the_source_does_are_no_jumps() -> None:
    assert found(with_jump(0.0)) == ()
    assert found(with_jump(1.5), with_jump(1.5)) == ()
    assert found(with_jump(1.5)[:1]) == ()


def test_a_jump_has_frame_joint_size_and_that_of_the_source() -> None:
    (jump,) = found(with_jump(0.9), with_jump(0.2))
    assert (jump.frame, jump.joint, jump.slides) == (12, "j", False)
    assert jump.size == pytest.approx(0.9 + 0.3 / 23)
    assert jump.source == pytest.approx(0.2 + 0.3 / 23)


@pytest.mark.parametrize("fps", [6.0, 12.0, 24.0, 60.0, 120.0])
def test_every_turn_over_thirty_degrees_is_a_jump(fps: float) -> None:
    """At low rates too, and amid fast motion."""
    angles = np.cumsum(np.full(24, np.radians(20.0)))
    angles[12:] += np.radians(11.0)
    assert 12 in [jump.frame for jump in found(angles, fps=fps)]
    assert jump_threshold(fps) <= 0.5


def test_pops_of_the_motion_rule_are_jumps() -> None:
    """19.5 degrees in a smooth take, that stay or come back (MOT202)."""
    stays = with_jump(np.radians(19.5), frames=48)
    assert [jump.frame for jump in found(stays)] == [12]
    back = np.linspace(0.0, 0.3, 48)
    back[20] += np.radians(19.5)
    assert [jump.frame for jump in found(back)] == [20, 21]


@pytest.mark.parametrize(("near", "count"), [(0.0, 1), (0.03, 1), (0.08, 0)])
def test_a_jerk_is_a_jump_that_is_no_fast_one(near: float, count: int) -> None:
    steps = np.array([0, 0, near, near, 0.2, near, near, 0, 0])
    jumps = found(np.concatenate([[0.0], np.cumsum(steps)]))
    assert [jump.frame for jump in jumps] == [5] * count


@pytest.mark.parametrize(("moves", "by_goals"), [(0.0, False), (0.5, True)])
def test_goals_that_move_as_fast_explain_a_jump(moves: float, by_goals: bool) -> None:
    (jump,) = found(with_jump(0.9), moves=moves)
    assert jump.by_goals is by_goals


@pytest.mark.parametrize(("length", "count"), [(2.0, 1), (3.0, 0)])
def test_slides_are_lengths_and_count_by_the_chain(length: float, count: int) -> None:
    still = turning(np.zeros(24))
    moved = still.translations.copy()
    # Over so many frames that no single one jerks out of rest.
    moved[:, 0, 1] = np.cumsum(np.full(24, 2.5 * jump_threshold(24)))
    goals = np.zeros(23)
    slid = replace(still, translations=moved)
    jumps = find_jumps(["rod"], still, slid, goals, fps=24, length=length)
    assert len(jumps) == 23 * count
    for jump in jumps:
        assert jump.slides
        assert jump.size == pytest.approx(2.5 * jump_threshold(24))


def standing(frames: int = 6) -> FramePath:
    problem = build(mixed_rig(), every_goal()[:1])
    rows = np.repeat(random_pose(problem, 1), frames, axis=0)
    return build_frame_path(problem, reached_by(problem, rows), None, IkOptions())


def test_goals_that_stand_or_are_not_asked_do_not_move() -> None:
    path = standing()
    assert (goal_steps(path.problem, path.targets) == 0).all()
    moving = path.targets.copy()
    moving[3:, :, 0] += 0.5
    assert np.flatnonzero(goal_steps(path.problem, moving)).tolist() == [2]
    moving[3, :, 13:] = 0
    assert (goal_steps(path.problem, moving) == 0).all()


def test_targets_of_no_weight_do_not_move() -> None:
    """A goal that does not turn to its target: turns of the target are no reason."""
    problem = build(mixed_rig(), [Goal("hand", orientation=0.0)])
    rows = np.repeat(random_pose(problem, 1), 6, axis=0)
    path = build_frame_path(problem, reached_by(problem, rows), None, IkOptions())
    moving = path.targets.copy()
    moving[3:, :, TARGET_COLUMNS["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    assert (goal_steps(problem, moving) == goal_steps(problem, path.targets)).all()


@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_a_whole_turn_has_no_end_to_jump_over(low: float) -> None:
    rig = arm(2)
    limits = RangeLimit(low, low + 2 * np.pi)
    one_turn = replace(
        rig, joints=(replace(rig.joints[0], limits=limits), rig.joints[1])
    )
    problem = build(one_turn, [Goal("b1", (0.4, 0.0, 0.0))])
    base = np.linspace(low - 0.5, low + 0.5, 60)
    rows = np.stack([np.where(base < low, base + 2 * np.pi, base), 0 * base + 0.5], 1)
    result = follow(problem, rows[0], reached_by(problem, rows))
    assert result.converged.all()
    assert result.jumps == ()
    assert (result.coordinates[:, 0] >= low).all()
    assert (full_revolutions(one_turn, rows) == 0).all()
    # Where the range is wider, it matters which of its turns a joint is in.
    hair = RangeLimit(low - 0.005, low + 2 * np.pi + 0.005)
    almost = replace(rig, joints=(replace(rig.joints[0], limits=hair), rig.joints[1]))
    assert (full_revolutions(almost, rows) == 0).all()
    wide = full_revolutions(arm(2, 2 * np.pi), rows)
    assert wide[:, 0].max() == 2 * np.pi
    assert (wide[:, 1] == 0).all()


@pytest.mark.parametrize("at", [0, 1, -2, -1])
def test_steps_at_the_ends_are_no_jerks_as_nobody_knows_what_is_beyond(at: int) -> None:
    steps = np.zeros(8)
    steps[at] = 0.2
    jumps = found(np.concatenate([[0.0], np.cumsum(steps)]))
    assert [jump.frame for jump in jumps] == [at % 8 + 1] * (at in {1, -2})


def test_the_largest_step_is_a_part_of_a_turn_and_a_speed() -> None:
    """0.1 rad and 8 rad/s, and never more than 0.5 rad."""
    steps = [jump_threshold(fps) for fps in (24.0, 80.0, 20.0, 8.0)]
    assert steps == pytest.approx([0.1 + 1 / 3, 0.2, 0.5, 0.5])
