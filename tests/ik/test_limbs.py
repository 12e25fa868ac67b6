"""Limbs that ease out and stretch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.ik import arm, limb, mixed_rig

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import (
    Goal,
    IkMethod,
    IkOptions,
    IkResult,
    IkStatus,
    Problem,
    Targets,
    build,
    solve,
)
from animtool.ik.goals import WEIGHT_COLUMNS
from animtool.ik.limbs import GoalLimb, extend_softly
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

SHOULDER = np.array([0.1, 1.2, 0.0])
METHODS = [IkMethod.AUTO, IkMethod.DAMPED]
WARM = IkOptions(IkMethod.DAMPED, warm=True)


def hand(**wishes: float) -> Problem:
    """Return two bones of 0.32 m and 0.27 m whose tip is a joint."""
    joints = (*limb().joints, Joint("hand", 1, JointType.FIXED, (0.27, 0.0, 0.0)))
    return build(Rig("limb", joints), [Goal("hand", **wishes)])


def tips(result: IkResult) -> FloatArray:
    """Return where the stretched joints put the first goal's point ``(B, 3)``."""
    rig, goal = result.problem.rig, result.problem.goals[0]
    local = local_from_coordinates(rig, result.coordinates)
    world = forward_kinematics(rig, result.local_translations(), local.rotations)
    j = rig.index(goal.joint)
    return world.positions[:, j] + world.linear[:, j] @ np.asarray(goal.offset)


def pulled(distances: FloatArray, origin: FloatArray = SHOULDER) -> Targets:
    direction = np.array([0.6, 0.8, 0.0])
    return Targets((origin + distances[:, None] * direction)[:, None])


def soft_distance(distances: FloatArray, reach: float, soft: float) -> FloatArray:
    """The exponential ease as it is published."""
    start, width = (1 - soft) * reach, soft * reach
    softened = reach - width * np.exp((start - distances) / width)
    return np.where(distances > start, softened, distances)


def test_soft_extension_never_snaps_straight() -> None:
    distances = np.linspace(0.0, 2.0, 2001)
    own = GoalLimb(0, (1, 2), np.zeros(3), 1.0, 1.0, soft=0.1, stretch=0.0)
    targets = np.zeros((len(distances), 1, WEIGHT_COLUMNS.stop))
    targets[:, 0, 0], targets[:, 0, WEIGHT_COLUMNS] = distances, 1.0
    softened = extend_softly((own,), targets).reachable_targets[:, 0, 0]
    np.testing.assert_allclose(softened, soft_distance(distances, 1.0, 0.1), atol=1e-15)
    speed = np.diff(softened) / np.diff(distances)
    assert softened.max() < 1.0
    assert (np.diff(softened) > 0).all()
    assert np.abs(np.diff(speed)).max() < 0.011
    np.testing.assert_allclose(softened[distances <= 0.9], distances[distances <= 0.9])


@pytest.mark.parametrize("method", METHODS)
def test_soft_limbs_say_what_they_leave(method: IkMethod) -> None:
    problem = hand(soft=0.1)
    distances = np.array([0.5, 0.59, 0.7])
    result = solve(problem, None, pulled(distances), IkOptions(method))
    assert result.statuses == (
        IkStatus.CONVERGED,
        IkStatus.YIELDED,
        IkStatus.NEAREST,
    )
    expected = distances - soft_distance(distances, 0.59, 0.1)
    np.testing.assert_allclose(result.positions[:, 0], expected, atol=1e-6)
    assert result.missed == [(1, 0), (2, 0)]


@pytest.mark.parametrize("method", METHODS)
def test_bones_stretch_only_as_far_as_needed_and_may(method: IkMethod) -> None:
    problem = hand(stretch=0.5)
    distances = np.array([0.3, 0.58, 0.7, 0.8, 2.0])
    result = solve(problem, None, pulled(distances), IkOptions(method))
    expected = np.clip(distances / 0.59, 1.0, 1.5)
    np.testing.assert_allclose(result.stretches[:, 0], expected, atol=1e-12)
    assert result.converged.tolist() == [True] * 4 + [False]
    assert result.statuses[-1] is IkStatus.NEAREST
    away = np.linalg.norm(tips(result) - pulled(distances).positions[:, 0], axis=1)
    np.testing.assert_allclose(away, result.positions[:, 0], atol=1e-9)
    np.testing.assert_allclose(away[-1], 2.0 - 1.5 * 0.59, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_ease_passes_into_stretch_without_a_kink(method: IkMethod) -> None:
    problem = hand(soft=0.2, stretch=1.0)
    distances = np.linspace(0.4, 0.9, 501)
    options = IkOptions(method, tolerance=1e-9, warm=True)
    result = solve(problem, [0, 0, 0, 1, 0.5], pulled(distances), options)
    assert result.converged.all()
    assert result.positions.max() < 1e-8
    speed = np.diff(result.stretches[:, 0]) / np.diff(distances)
    assert (speed >= 0).all()
    assert np.abs(np.diff(speed)).max() < 0.02
    # The elbow keeps a bend, and opens without a jump.
    assert np.abs(result.coordinates[:, 4]).min() > 0.1
    assert np.abs(np.diff(result.coordinates[:, 4])).max() < 0.01


def test_an_offset_from_the_last_joint_does_not_stretch() -> None:
    problem = build(limb(), [Goal("elbow", (0.27, 0.0, 0.0), stretch=1.0)])
    result = solve(problem, None, pulled(np.array([0.7])))
    np.testing.assert_allclose(result.stretches[0, 0], 1 + 0.11 / 0.32)
    np.testing.assert_allclose(tips(result), pulled(np.array([0.7])).positions[:, 0])


@pytest.mark.parametrize("wishes", [{"soft": 0.2}, {"soft": 0.2, "stretch": 0.3}])
def test_any_limb_with_a_root_extends(wishes: dict[str, float]) -> None:
    rig = Rig("rope", tuple(replace(j, type=JointType.BALL) for j in arm(5).joints))
    goal = Goal("b4", root="b1", **wishes)
    pose = np.tile(so3.exp([0.2, 0.3, -0.3]), 5)
    problem = build(rig, [goal], pose=pose)
    assert problem.joints == ("b1", "b2", "b3")
    origin = problem.limbs[0].origin * problem.length
    distances = np.linspace(0.8, 2.0, 200)
    result = solve(problem, pose, pulled(distances, origin), WARM)
    reach = 1.2
    extent = soft_distance(distances, reach, 0.2)
    grown = np.clip((distances - extent) / reach, 0, wishes.get("stretch", 0.0))
    np.testing.assert_allclose(result.stretches[:, 0], 1 + grown, atol=1e-12)
    expected = np.maximum(distances - extent - grown * reach, 0.0)
    np.testing.assert_allclose(result.positions[:, 0], expected, atol=3e-6)
    assert np.abs(np.diff(result.coordinates, axis=0)).max() < 0.1


def test_two_limbs_stretch_by_themselves() -> None:
    trunk = Joint("trunk", -1, JointType.FIXED)
    limbs = [
        Joint(f"{side}{i}", parent, JointType.BALL, translation=(x, 0.0, 0.0))
        for side, x, first in (("l", 0.3, 1), ("r", -0.3, 4))
        for i, parent in enumerate((0, first, first + 1))
    ]
    goals = [Goal("l2", root="l0", stretch=1.0), Goal("r2", root="r0", soft=0.1)]
    problem = build(Rig("two", (trunk, *limbs)), goals)
    targets = Targets([[[0.3, 0.9, 0.0], [-0.3, 0.5, 0.0]]])
    result = solve(problem, None, targets)
    np.testing.assert_allclose(result.stretches, [[1.5, 1.0]])
    assert result.converged.all()


@pytest.mark.parametrize(
    ("rig", "goals"),
    [
        (arm(6), [Goal("b5", root="b2", soft=0.1), Goal("b1", (0.1, 0.0, 0.0))]),
        (mixed_rig(), [Goal("hand", soft=0.1)]),
        (mixed_rig(), [Goal("hand", root="elbow", stretch=0.1)]),
        (arm(6), [Goal("b5", stretch=0.1), Goal("b4", stretch=0.1)]),
        (arm(1), [Goal("b0", (0.3, 0.0, 0.0), stretch=0.1)]),
        (arm(3), [Goal("b2", position=0.0, orientation=1.0, soft=0.1)]),
    ],
)
def test_limbs_that_cannot_extend_are_refused(rig: Rig, goals: list[Goal]) -> None:
    with pytest.raises(OptionError) as caught:
        build(rig, goals)
    assert caught.value.code == "IK008"


@pytest.mark.parametrize("wrong", [{"soft": 1.0}, {"soft": -0.1}, {"stretch": -1.0}])
def test_shares_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(OptionError) as caught:
        build(arm(3), [replace(Goal("b2"), **wrong)])
    assert caught.value.code == "IK002"


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("least", [0.2, 0.6])
def test_a_limb_that_limits_keep_bent_stretches_from_there(
    least: float, way: float
) -> None:
    rig = hand().rig
    ends = sorted((way * least, way * 2.5))
    elbow = replace(rig.joints[1], limits=RangeLimit(*ends))
    bent = replace(rig, joints=(rig.joints[0], elbow, *rig.joints[2:]))
    reach = float(np.sqrt(0.32**2 + 0.27**2 + 2 * 0.32 * 0.27 * np.cos(least)))
    problem = build(bent, [Goal("hand", stretch=0.2)])
    assert problem.limbs[0].max_length * problem.length == pytest.approx(reach)
    distances = reach * np.array([0.9, 0.999, 1.01, 1.1, 1.19])
    targets = pulled(distances)
    result = solve(problem, None, targets)
    assert result.converged.all()
    wanted = np.asarray(targets.positions)[:, 0]
    np.testing.assert_allclose(tips(result), wanted, atol=2e-6)
    grown = np.maximum(distances / reach, 1.0)
    np.testing.assert_allclose(result.stretches[:, 0], grown, rtol=1e-9)


def test_bones_that_are_a_part_of_the_reach_grow_by_more_of_their_own() -> None:
    """Of a reach of 0.8 bones are 0.6: half of these makes 0.3, and 1.1 in all."""
    origin = np.array([0.1, 0.2, 0.3])
    own = GoalLimb(0, (1, 2), origin, 0.8, 0.6, soft=0.0, stretch=0.5)
    targets = np.zeros((4, 1, WEIGHT_COLUMNS.stop))
    targets[:, 0, :3] = origin + np.array([0.5, 1.0, 1.2, 1.2])[:, None] * [0, 1, 0]
    targets[:3, 0, WEIGHT_COLUMNS.start] = 1.0
    found = extend_softly((own,), targets)
    np.testing.assert_allclose(found.bone_scales[:, 0], [1.0, 1 + 1 / 3, 1.5, 1.0])
    off = found.reachable_targets[:, 0, 1] - origin[1]
    np.testing.assert_allclose(off, [0.5, 1.0, 1.1, 1.2])
