"""Arms of six pins in closed form, beside kinematics of fifty digits."""

from __future__ import annotations

import numpy as np
import pytest
from support.arms import ARMS, arm, exact_miss, place_of
from support.ik import arm as chain_of_pins

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import (
    FollowOptions,
    Goal,
    IkMethod,
    IkOptions,
    IkStatus,
    Targets,
    build,
    follow,
    solve,
)
from animtool.ik.rig_solver import ClosedForm, closed_form
from animtool.rig.skeleton import Rig

pytestmark = pytest.mark.slow


EXACT = 1e-14
# Poses in which axes are in line, or the elbow is straight.
SINGULAR = {
    "wrist": [[0.3, 0.7, -0.4, 0.9, 0.0, 0.2], [0.3, 0.7, -0.4, 0.9, 1e-9, 0.2]],
    "parallel": [[0.3, 0.7, -0.4, 0.9, 0.0, 0.2], [0.3, 0.7, 0.0, 0.9, 0.8, 0.2]],
}


def apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the largest angle between poses ``(...)``, whole turns aside."""
    off = a - b
    off -= 2 * np.pi * np.round(off / (2 * np.pi))
    return np.asarray(np.abs(off).max(axis=-1))


def goal() -> Goal:
    return Goal("hand", position=1.0, orientation=1.0)


@pytest.mark.parametrize("name", list(ARMS))
def test_arms_reach_to_the_last_digits_on_every_branch(name: str) -> None:
    rig = arm(name)
    session = rig.ik("hand")
    rng = np.random.default_rng(3)
    counts = set()
    for _ in range(25):
        pose, start = rng.uniform(-3, 3, (2, 6))
        target = place_of(rig, pose)
        result = session.solve(hand=target, start=start)
        found = session.branches(hand=target, start=start)
        assert result.iterations[0] == 0
        assert exact_miss(rig, result.coordinates[0], target) < EXACT
        assert max(exact_miss(rig, own, target) for own in found) < EXACT
        assert apart(found, pose).min() < 1e-6
        np.testing.assert_array_equal(found[0], result.coordinates[0])
        far = np.linalg.norm(found - start, axis=1)
        assert (np.diff(far) >= -1e-9).all()
        pairs = [apart(found, own) for own in found]
        assert (np.sort(pairs)[:, 1:2] > 1e-7).all()
        counts.add(len(found))
    assert max(counts) >= 4
    assert all(count % 2 == 0 for count in counts)


@pytest.mark.parametrize("name", ["parallel", "wrist"])
def test_branches_are_all_that_steps_find(name: str) -> None:
    rig = arm(name)
    rng = np.random.default_rng(4)
    pose = rng.uniform(-2, 2, 6)
    target = place_of(rig, pose)
    found = rig.ik("hand").branches(hand=target)
    count = 300
    targets = Targets(
        np.tile(target[0], (count, 1, 1)), np.tile(target[1], (count, 1, 1))
    )
    options = IkOptions(IkMethod.DAMPED, tolerance=1e-9, angle_tolerance=1e-9)
    stepped = solve(
        build(rig, [goal()]), rng.uniform(-3, 3, (count, 6)), targets, options
    )
    poses = stepped.coordinates[stepped.converged]
    assert len(poses) > 250
    nearest = apart(poses[:, None], found[None])
    assert nearest.min(axis=1).max() < 1e-5
    assert (nearest.min(axis=0) < 1e-5).all()


@pytest.mark.parametrize(
    ("name", "pose"), [(name, pose) for name in SINGULAR for pose in SINGULAR[name]]
)
def test_singular_poses_are_exact_and_stay_by_the_start(
    name: str, pose: list[float]
) -> None:
    rig = arm(name)
    target = place_of(rig, np.array(pose))
    start = np.array(pose) + 0.01
    result = rig.ik("hand").solve(hand=target, start=start)
    assert exact_miss(rig, result.coordinates[0], target) < EXACT
    assert apart(result.coordinates[0], start) < 0.05


def test_limits_choose_among_branches() -> None:
    rig, free = arm("parallel", limit=1.6), arm("parallel")
    rng = np.random.default_rng(5)
    for _ in range(20):
        pose = rng.uniform(-1.6, 1.6, 6)
        target = place_of(rig, pose)
        inside = rig.ik("hand").branches(hand=target)
        every = free.ik("hand").branches(hand=target)
        kept = [own for own in every if (np.abs(own) <= 1.6).all()]
        assert len(inside) == len(kept) >= 1
        assert apart(inside, pose).min() < 1e-6
        assert (np.abs(inside) <= 1.6).all()


def test_limits_of_more_than_a_turn_keep_the_nearest_turn() -> None:
    rig = arm("parallel", limit=2 * np.pi)
    pose = np.array([4.0, -4.5, 5.0, 0.4, 3.9, -6.0])
    result = rig.ik("hand").solve(hand=place_of(rig, pose), start=pose + 0.05)
    np.testing.assert_allclose(result.coordinates[0], pose, atol=1e-12)


@pytest.mark.parametrize("name", list(ARMS))
def test_out_of_reach_is_at_the_nearest_as_by_steps(name: str) -> None:
    rig = arm(name)
    problem = build(rig, [goal()])
    targets = Targets([[[3.0, 1.0, 0.5]]], [[[0.0, 0.0, 0.0, 1.0]]])
    result = solve(problem, None, targets)
    assert result.statuses == (IkStatus.NEAREST,)
    stepped = solve(problem, None, targets, IkOptions(IkMethod.DAMPED))
    np.testing.assert_array_equal(result.misses, stepped.misses)
    assert len(rig.ik("hand").branches(hand=([3.0, 1.0, 0.5], [0, 0, 0, 1]))) == 0


def test_axes_that_meet_only_nearly_are_exact_all_the_same() -> None:
    rig = arm("wrist")
    joints = list(rig.joints)
    spoiled = np.array([1.0, 2e-4, -3e-4]) / np.linalg.norm([1.0, 2e-4, -3e-4])
    joints[5] = type(joints[5])(
        **{**_fields(joints[5]), "axis": tuple(spoiled), "translation": (0, 1e-4, 2e-4)}
    )
    bent = Rig("bent", tuple(joints))
    rng = np.random.default_rng(6)
    for _ in range(10):
        pose = rng.uniform(-2, 2, 6)
        target = place_of(bent, pose)
        result = bent.ik("hand").solve(hand=target, start=pose + 0.1)
        assert result.iterations[0] == 0
        assert exact_miss(bent, result.coordinates[0], target) < EXACT


def _fields(joint: object) -> dict[str, object]:
    names = ("name", "parent", "type", "translation", "rotation", "axis", "limits")
    return {name: getattr(joint, name) for name in names}


def test_a_clip_goes_on_from_frame_to_frame() -> None:
    rig = arm("parallel")
    times = np.linspace(0, 1, 60)[:, None]
    path = np.array([0.3, -0.9, 1.2, 0.4, 0.8, -0.5]) + np.sin(
        2.5 * times * [1.0, 0.5, 0.7, 0.9, 0.3, 1.2]
    )
    places = [place_of(rig, pose) for pose in path]
    targets = Targets(*(np.array(part)[:, None] for part in zip(*places, strict=True)))
    options = FollowOptions(fps=30)
    found = follow(build(rig, [goal()]), path[0], targets, options)
    np.testing.assert_allclose(found.coordinates, path, atol=1e-9)


@pytest.mark.parametrize(
    ("goals", "options"),
    [
        ([Goal("hand")], {}),
        ([goal()], {"rest_weight": 1e-3}),
        ([goal(), Goal("j2", (0.1, 0, 0))], {}),
        ([goal()], {"joints": ["j0", "j1", "j2", "j3", "j4"]}),
    ],
)
def test_other_problems_have_no_closed_form(
    goals: list[Goal], options: dict[str, object]
) -> None:
    problem = build(arm("wrist"), goals, **options)  # type: ignore[arg-type]
    assert closed_form(problem) is ClosedForm.NONE


def test_branches_need_a_closed_form() -> None:
    rig = chain_of_pins(6)
    with pytest.raises(OptionError) as caught:
        rig.ik("b5").branches(b5=([0.5, 0.5, 0.5], [0, 0, 0, 1]))
    assert caught.value.faults[0].code == "IK015"
