"""The kernel's view of a rig: kinematics, Jacobians and curvature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ik import every_goal, mixed_rig, random_pose, reached_by

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.ik import Goal, Problem, Targets, build
from animtool.ik.chain import apply_steps, joint_steps, unwrap_angles, with_periods
from animtool.ik.goals import GOAL_KINDS, GOAL_PARTS, GoalKind, pack
from animtool.ik.solving import pack_for_chain
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig


def look(
    problem: Problem, start: FloatArray, targets: FloatArray, step: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return coordinates, residual, Jacobian and curvature after a step."""
    chain = problem.chain
    found = _kernels.linearize_ik(
        chain.nodes,
        chain.node_numbers,
        chain.goal_nodes,
        chain.goal_numbers,
        chain.from_rig(start),
        targets,
        step[None],
    )
    q, residual, jacobian, curvature = (part[0] for part in found)
    return q, residual, jacobian, curvature


def cost(
    problem: Problem, start: FloatArray, targets: FloatArray, step: FloatArray
) -> float:
    residual = look(problem, start, targets, step)[1]
    return float(residual @ residual / 2)


# Limits would stop the steps of finite differences.
def free_problem(goals: list[Goal]) -> Problem:
    rig = mixed_rig()
    joints = [
        Joint(j.name, j.parent, j.type, j.translation, j.rotation, j.axis)
        for j in rig.joints
    ]
    return build(Rig("free", tuple(joints)), goals)


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_targets_are_seen_from_the_nodes_in_shares_of_the_length(scale: float) -> None:
    problem = build(mixed_rig(), every_goal())
    rng = np.random.default_rng(0)
    shape = (4, len(problem.goals))
    points = [rng.normal(size=(*shape, 3)) for _ in range(3)]
    targets = Targets(points[0], scale * rng.normal(size=(*shape, 4)), *points[1:])
    expected = pack(targets, problem.goals)
    expected[:, :, [0, 1, 2, 7, 8, 9, 10, 11, 12]] /= problem.length
    undo = so3.conjugate(problem.chain.goal_rotations)
    expected[:, :, 3:7] = so3.multiply(so3.normalize(expected[:, :, 3:7]), undo)
    found = pack_for_chain(problem, targets)
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_poses_have_no_residual_at_their_own_targets(seed: int) -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    pose = random_pose(problem, seed)
    targets = pack_for_chain(problem, reached_by(problem, pose))
    residual = look(problem, pose, targets, np.zeros(problem.degrees))[1]
    assert np.abs(residual).max() < 1e-7


@pytest.mark.parametrize("seed", range(4))
def test_the_jacobian_is_minus_the_derivative_near_the_goals(seed: int) -> None:
    problem = free_problem(every_goal()[:2])
    pose = random_pose(problem, seed)
    targets = pack_for_chain(problem, reached_by(problem, pose))
    jacobian = look(problem, pose, targets, np.zeros(problem.degrees))[2]
    for d, direction in enumerate(np.eye(problem.degrees)):
        ahead = look(problem, pose, targets, 1e-6 * direction)[1]
        behind = look(problem, pose, targets, -1e-6 * direction)[1]
        slope = (ahead - behind) / 2e-6
        # The two rows of an aim stand on any basis across it: the length is theirs.
        plain = [*range(9)]
        np.testing.assert_allclose(slope[plain], -jacobian[plain, d], atol=1e-8)
        aimed = np.linalg.norm(jacobian[9:11, d])
        assert abs(np.linalg.norm(slope[9:11]) - aimed) < 1e-6 or aimed < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_the_gradient_is_exact_far_from_the_goals(seed: int) -> None:
    problem = free_problem(every_goal())
    pose, other = random_pose(problem, seed), random_pose(problem, seed + 50)
    targets = pack_for_chain(problem, reached_by(problem, other))
    still = np.zeros(problem.degrees)
    _, residual, jacobian, _ = look(problem, pose, targets, still)
    gradient = -jacobian.T @ residual
    for d, direction in enumerate(np.eye(problem.degrees)):
        ahead = cost(problem, pose, targets, 1e-6 * direction)
        behind = cost(problem, pose, targets, -1e-6 * direction)
        assert abs((ahead - behind) / 2e-6 - gradient[d]) < 1e-8


@pytest.mark.parametrize("kind", GOAL_KINDS, ids=GOAL_PARTS)
def test_the_gradient_of_each_kind_is_exact(kind: GoalKind) -> None:
    weights = {"position": 0.0} | {kind.name: 0.6}
    goal = Goal("piston", (0.05, 0.0, 0.0), aim_axis=(0.6, 0.0, 0.8), **weights)
    problem = free_problem([goal])
    target = np.random.default_rng(5).normal(size=(1, 1, kind.value_type.value))
    targets = pack_for_chain(problem, Targets(**{kind.targets_field: target}))
    pose, still = random_pose(problem, 3), np.zeros(problem.degrees)
    _, residual, jacobian, _ = look(problem, pose, targets, still)
    assert residual.shape == (kind.residual_count,)
    gradient = -jacobian.T @ residual
    assert np.abs(gradient).max() > 1e-3
    for d, direction in enumerate(np.eye(problem.degrees)):
        ahead = cost(problem, pose, targets, 1e-6 * direction)
        behind = cost(problem, pose, targets, -1e-6 * direction)
        assert abs((ahead - behind) / 2e-6 - gradient[d]) < 1e-8


@pytest.mark.parametrize("seed", range(4))
def test_the_curvature_of_poses_is_exact(seed: int) -> None:
    problem = free_problem([every_goal()[0], Goal("other", orientation=0.6)])
    pose, other = random_pose(problem, seed), random_pose(problem, seed + 50)
    targets = pack_for_chain(problem, reached_by(problem, other))
    step = np.random.default_rng(seed).normal(size=problem.degrees) * 1e-4
    middle = cost(problem, pose, targets, np.zeros(problem.degrees))
    ahead, behind = (cost(problem, pose, targets, s * step) for s in (1, -1))
    # Beside the pose, curvature differs from that at the pose by the step's length.
    bend = step @ look(problem, pose, targets, 0.0 * step + step)[3]
    back = step @ -look(problem, pose, targets, -step)[3]
    assert abs((ahead - 2 * middle + behind) - (bend + back) / 2) < 1e-4 * abs(bend)


def test_coordinates_come_back_as_they_went() -> None:
    problem = build(mixed_rig(), every_goal())
    pose = random_pose(problem, 3, frames=5)
    chain = problem.chain
    np.testing.assert_allclose(
        chain.into_rig(chain.from_rig(pose), pose), pose, atol=1e-15
    )


def test_a_follower_moves_with_its_leader_within_both_limits() -> None:
    rig = Rig(
        "gripper",
        (
            Joint("a", -1, JointType.PIN, limits=RangeLimit(-2.0, 2.0)),
            Joint(
                "b",
                0,
                JointType.PIN,
                translation=(1.0, 0.0, 0.0),
                limits=RangeLimit(-0.5, 0.5),
                mimic=Mimic("a", gain=-0.5, offset=0.1),
            ),
        ),
    )
    problem = build(rig, [Goal("b", (1.0, 0.0, 0.0))])
    assert problem.degrees == 1
    low, high = problem.chain.node_numbers[0, 14:16]
    np.testing.assert_allclose([low, high], [-0.8, 1.2])
    jacobian = look(
        problem,
        np.array([[0.4, 0.0]]),
        pack_for_chain(problem, Targets(np.ones((1, 1, 3)))),
        np.zeros(1),
    )[2]
    # d/da of (cos a + cos(a + b), sin a + sin(a + b)) with b = 0.1 - a / 2, over 2 m
    a, b = 0.4, -0.1
    expected = np.array(
        [-np.sin(a) - np.sin(a + b) / 2, np.cos(a) + np.cos(a + b) / 2, 0.0]
    )
    np.testing.assert_allclose(jacobian[:, 0], expected / problem.length, atol=1e-12)


SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_a_pose_moved_by_the_difference_is_the_other(seed: int) -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    start, end = problem.chain.from_rig(random_pose(problem, seed, frames=2))
    step = joint_steps(problem.chain, start, end)
    assert step.shape == (problem.degrees,)
    back = joint_steps(problem.chain, apply_steps(problem.chain, start, step), end)
    np.testing.assert_allclose(back, 0.0, atol=1e-12)


def test_many_poses_are_compared_with_one() -> None:
    problem = build(mixed_rig(), every_goal()[:2])
    poses = problem.chain.from_rig(random_pose(problem, 1, frames=4))
    steps = joint_steps(problem.chain, poses[0], poses)
    assert steps.shape == (4, problem.degrees)
    np.testing.assert_allclose(
        apply_steps(problem.chain, poses[0], steps[2:3])[0], poses[2]
    )


def wheel(limits: RangeLimit | None) -> Rig:
    joints = (Joint("wheel", -1, JointType.PIN, limits=limits),)
    return Rig("wheel", joints)


def test_pins_without_limits_go_the_short_way_round() -> None:
    chain = build(wheel(None), [Goal("wheel", (1.0, 0.0, 0.0))]).chain
    poses = np.array([[3.0], [-3.0], [-2.8]])
    step = joint_steps(chain, poses[0], poses[1])
    np.testing.assert_allclose(step, 2 * np.pi - 6.0)
    np.testing.assert_allclose(np.diff(unwrap_angles(chain, poses)[:, 0]).max(), step)


def test_pins_between_limits_do_not_though_these_leave_no_gap() -> None:
    for limits in (RangeLimit(-3.1, 3.1), RangeLimit(-4.0, 4.0)):
        chain = build(wheel(limits), [Goal("wheel", (1.0, 0.0, 0.0))]).chain
        poses = np.array([[3.0], [-3.0]])
        np.testing.assert_allclose(joint_steps(chain, poses[0], poses[1]), -6.0)
        np.testing.assert_array_equal(unwrap_angles(chain, poses), poses)
        low, high = with_periods(chain)[0, 14:16]
        np.testing.assert_allclose([low, high], [limits.low, limits.high])
