"""Following clips through time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.ik import arm, limb, random_pose, reached_by

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import (
    FollowOptions,
    Goal,
    IkOptions,
    Problem,
    Targets,
    build,
    follow,
    solve,
)
from animtool.ik.goals import targets_of_frames
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Rig

ROOT = Path(__file__).parents[2]


def planar(limit: float = 2.6) -> Problem:
    """Three links that turn about one axis: one degree of freedom to spare."""
    rig = arm(3, limit)
    joints = tuple(replace(joint, axis=(0.0, 0.0, 1.0)) for joint in rig.joints)
    return build(Rig("planar", joints), [Goal("b2", (0.4, 0.0, 0.0))])


def around(turns: float, frames: int, radius: float = 0.6) -> FloatArray:
    """Return points on a circle ``(F, 1, 3)``."""
    angle = np.linspace(0, 2 * np.pi * turns, frames)
    points = [radius * np.cos(angle), radius * np.sin(angle), 0 * angle]
    return np.stack(points, axis=1)[:, None]


def steps(coordinates: FloatArray) -> FloatArray:
    return np.abs(np.diff(coordinates, axis=0)).max(axis=1)


def test_a_clip_is_followed_frame_by_frame() -> None:
    problem = planar()
    targets = Targets(around(0.2, 50))
    result = follow(problem, [0.2, 0.8, 0.4], targets)
    assert result.converged.all()
    assert result.jumps == ()
    assert steps(result.coordinates).max() < 0.1


def test_a_path_leaves_early_for_another_branch() -> None:
    # The base may turn so far that only an arm bent the other way gets on.
    joints = list(planar().rig.joints)
    joints[0] = replace(joints[0], limits=RangeLimit(-1.1, 3.0))
    problem = build(Rig("one side", tuple(joints)), [Goal("b2", (0.4, 0.0, 0.0))])
    targets = Targets(around(0.35, 120))
    start = [-1.0, 2.0, -0.2]
    jumping = solve(problem, start, targets, IkOptions(warm=True))
    result = follow(problem, start, targets, FollowOptions(fps=30))
    assert result.converged.all()
    assert result.jumps == ()
    assert steps(result.coordinates).max() <= steps(jumping.coordinates).max()


def stiff() -> Problem:
    """Two links that turn about one axis, the second one way only."""
    fixed = arm(2, 3.0)
    joints = (
        replace(fixed.joints[0], axis=(0.0, 0.0, 1.0), limits=RangeLimit(-3.3, 3.3)),
        replace(fixed.joints[1], axis=(0.0, 0.0, 1.0), limits=RangeLimit(0.0, 2.5)),
    )
    return build(Rig("stiff", joints), [Goal("b1", (0.4, 0.0, 0.0))])


def test_no_way_is_looked_for_where_no_pose_could_be_on_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Out of reach and back: a straight limb bends as fast as it has to.
    far = 0.8 * np.concatenate([np.linspace(0.7, 1.1, 57), np.linspace(1.1, 0.7, 57)])
    points = np.stack([far, 0 * far, 0 * far], axis=1)[:, None]
    searched: list[str] = []
    for name in ("_search_full_clip", "_with_shorter_jump"):
        monkeypatch.setattr(
            f"animtool.ik.clip_solver.{name}",
            lambda _, result, *_place, name=name: searched.append(name) or result,
        )
    problem, start, options = stiff(), [-0.7, 1.4], FollowOptions(fps=200)
    result = follow(problem, start, Targets(points), options)
    assert [jump.joint for jump in result.jumps] == ["b1", "b1"]
    assert searched == []
    plain = solve(problem, start, Targets(points), IkOptions(warm=True))
    np.testing.assert_array_equal(result.coordinates, plain.coordinates)
    # Where another way would do, it is looked for.
    follow(problem, start, Targets(around(1.5, 200)), FollowOptions(fps=50))
    assert searched


@pytest.mark.slow
def test_a_jump_that_cannot_be_avoided_is_named() -> None:
    problem = planar()
    points = around(0.1, 20)
    points[10:, :, :2] *= -1
    # Nothing lies between the halves, but that the targets jump explains the joints.
    jumps = follow(problem, [0.2, 0.8, 0.4], Targets(points)).jumps
    assert {(jump.frame, jump.by_goals) for jump in jumps} == {(10, True)}
    # One and a half times around: the base has to turn back.
    targets = Targets(around(1.5, 200))
    result = follow(stiff(), [-0.7, 1.4], targets, FollowOptions(fps=50))
    assert result.converged.all()
    (jump,) = result.jumps
    assert jump.joint == "b0"
    assert jump.size == pytest.approx(2 * np.pi, abs=0.1)
    assert steps(result.coordinates).argmax() + 1 == jump.frame


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes() -> None:
    problem = planar(2.0)
    targets = Targets(around(0.6, 90))
    options = FollowOptions(fps=30, smooth=0.05)
    once = follow(problem, [0.2, 0.8, 0.4], targets, options)
    again = follow(problem, [0.2, 0.8, 0.4], targets, options)
    assert once.coordinates.tobytes() == again.coordinates.tobytes()


@pytest.mark.parametrize("smooth", [0.0, 0.1])
def test_the_rate_of_frames_does_not_matter(smooth: float) -> None:
    problem = planar()
    start = [0.2, 0.8, 0.4]
    many = around(0.3, 121)
    fine = follow(problem, start, Targets(many), FollowOptions(fps=60, smooth=smooth))
    coarse = follow(
        problem, start, Targets(many[::2]), FollowOptions(fps=30, smooth=smooth)
    )
    np.testing.assert_allclose(fine.coordinates[::2], coarse.coordinates, atol=0.02)


def test_frames_of_a_clip_start_at_their_own_pose() -> None:
    problem = planar()
    pose = random_pose(problem, 4)[0] / 3
    clip = pose + 0.2 * np.sin(np.arange(60) / 7)[:, None]
    targets = reached_by(problem, clip)
    assert isinstance(targets.positions, np.ndarray)
    kept = follow(problem, clip, targets)
    np.testing.assert_allclose(kept.coordinates, clip, atol=1e-9)
    ease = np.sin(np.linspace(0, np.pi, 60)) ** 2
    moved = targets.positions * (1 - 0.15 * ease[:, None, None])
    result = follow(problem, clip, Targets(moved), FollowOptions(fps=30, smooth=0.05))
    assert result.converged.all()
    assert result.jumps == ()
    assert steps(result.coordinates - clip).max() < 0.1


def test_a_clip_that_comes_back_is_left_and_joined() -> None:
    # In the middle the clip's own poses are bent to the other side.
    problem = planar()
    targets = Targets(around(0.1, 60))
    path = follow(problem, [-0.4, 0.9, 0.4], targets).coordinates
    other = follow(problem, [0.9, -0.9, -0.4], targets).coordinates
    start = path.copy()
    start[25:35] = other[25:35]
    result = follow(problem, start, targets, FollowOptions(fps=30))
    assert result.converged.all()


def test_limbs_are_followed_in_closed_form() -> None:
    rig = limb()
    problem = build(rig, [Goal("elbow", (0.27, 0.0, 0.0))])
    points = around(0.2, 40, 0.4) + np.array([0.1, 1.2, 0.0])
    result = follow(problem, [*so3.IDENTITY, 0.3], Targets(points))
    assert result.positions.max() < 1e-12
    assert result.jumps == ()


def test_one_frame_and_none_are_clips() -> None:
    problem = planar()
    one = follow(problem, None, Targets(around(0.1, 1)), FollowOptions(smooth=0.1))
    assert one.converged.all()
    none = follow(problem, None, Targets(np.zeros((0, 1, 3))))
    assert len(none.coordinates) == 0


@pytest.mark.parametrize(
    "options",
    [
        FollowOptions(fps=0.0),
        FollowOptions(smooth=-1.0),
        FollowOptions(branches=-1),
        FollowOptions(back=-1.0),
        FollowOptions(solving=IkOptions(tolerance=0.0)),
    ],
)
def test_options_that_make_no_sense_are_refused(options: FollowOptions) -> None:
    with pytest.raises(OptionError) as caught:
        follow(planar(), None, Targets(around(0.1, 3)), options)
    assert {fault.code for fault in caught.value.faults} == {"IK014"}


@pytest.mark.parametrize("first", [60.0, 0.0])
def test_the_first_pose_is_another_if_that_leads_round(first: float) -> None:
    # The flange turns by 360 degrees each way, so that it has to begin far to one side.
    rig = load_rig(ROOT / "rigs" / "arm" / "arm.rig.yaml")
    problem = build(rig, [Goal("tool", root="axis_1", orientation=1.0)])
    share = np.linspace(0, 1, 100)
    points = np.stack([0.5 + 0 * share, 0.15 * np.sin(6 * share), 0.3 + 0 * share], 1)
    down = so3.from_axis_angle([0, 1, 0], np.pi / 2)
    yaw = so3.from_axis_angle([0, 0, 1], np.radians(first + 380 * share))
    targets = Targets(points[:, None], so3.multiply(yaw, down)[:, None])
    nearest = solve(problem, None, targets_of_frames(targets, slice(0, 1)))
    result = follow(problem, None, targets, FollowOptions(fps=25))
    assert result.converged.all()
    assert result.jumps == ()
    # The fourth axis turns by one turn: at its ends it is turned alike.
    turns = np.diff(result.coordinates, axis=0)
    turns[:, 3] -= 2 * np.pi * np.round(turns[:, 3] / (2 * np.pi))
    assert np.abs(turns).max() < 0.15
    assert np.abs(result.coordinates[0] - nearest.coordinates[0]).max() > 3
    # A clip may begin in another turn of the flange, which is turned alike.
    clip = np.repeat(nearest.coordinates, 100, axis=0)
    kept = follow(problem, clip, targets, FollowOptions(fps=25))
    turns = (kept.coordinates[0] - nearest.coordinates[0]) / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 0.02
    assert kept.jumps == ()
