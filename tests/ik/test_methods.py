"""The methods beside the solver: what they share, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.faults import raises
from support.ik import arm, beyond_limits, limb, mixed_rig, random_pose, reached_by
from support.suite import examples

from animtool.core.errors import OptionError
from animtool.ik import (
    Goal,
    IkMethod,
    IkOptions,
    IkStatus,
    Problem,
    Targets,
    build,
    solve,
)
from animtool.ik.solving import supported_methods
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Joint, JointType, Rig

SEEDS = st.integers(0, 2**32 - 1)
PLAIN = [IkMethod.GRADIENT, IkMethod.NEWTON, IkMethod.CCD, IkMethod.FABRIK]
TIP = Goal("b4", (0.3, 0.0, 0.0))


def balls(limits: BallLimit | None = None) -> Rig:
    """Return five balls in a row."""
    joints = [
        replace(j, type=JointType.BALL, axis=(0.0, 0.0, 1.0), limits=limits)
        for j in arm(5).joints
    ]
    return Rig("rope", tuple(joints))


def tree() -> Rig:
    """Return a trunk of two balls and two arms of two on it."""
    parents = {
        "hips": -1,
        "chest": 0,
        "left": 1,
        "elbow_l": 2,
        "right": 1,
        "elbow_r": 4,
    }
    places = {
        "chest": (0.0, 0.5, 0.0),
        "left": (0.2, 0.3, 0.0),
        "right": (-0.2, 0.3, 0.0),
    }
    places |= {"elbow_l": (0.4, 0.0, 0.0), "elbow_r": (-0.4, 0.0, 0.0)}
    return Rig(
        "tree",
        tuple(
            Joint(name, parent, JointType.BALL, places.get(name, (0.0, 0.0, 0.0)))
            for name, parent in parents.items()
        ),
    )


@pytest.mark.parametrize("method", list(IkMethod))
def test_every_method_brings_a_limb_to_its_goal(method: IkMethod) -> None:
    problem = build(limb(), [Goal("elbow", (0.27, 0.0, 0.0))])
    targets = reached_by(problem, random_pose(problem, 6))
    start = random_pose(problem, 5)
    result = solve(problem, start, targets, IkOptions(method, tolerance=1e-5))
    assert result.converged.all()
    assert result.problem is problem


@pytest.mark.parametrize("method", PLAIN)
@pytest.mark.parametrize("seed", range(5))
def test_chains_of_balls_are_moved_to_their_goals(method: IkMethod, seed: int) -> None:
    problem = build(balls(), [TIP])
    targets = reached_by(problem, random_pose(problem, seed))
    result = solve(problem, None, targets, IkOptions(method, tolerance=1e-5))
    assert result.statuses == (IkStatus.CONVERGED,)


@settings(max_examples=examples(15))
@given(SEEDS, st.sampled_from(PLAIN), st.booleans())
def test_limits_are_kept_wherever_the_goal_is(
    seed: int, method: IkMethod, pins: bool
) -> None:
    cone = BallLimit((0.6, 0.4), (-0.3, 0.3))
    problem = build(arm(5, 0.7) if pins else balls(cone), [TIP])
    targets = Targets(np.random.default_rng(seed).normal(size=(1, 1, 3)))
    result = solve(problem, None, targets, IkOptions(method, iterations=300))
    assert beyond_limits(problem, result.coordinates) == 0.0
    assert np.isfinite(result.coordinates).all()
    assert result.statuses[0] in {
        IkStatus.CONVERGED,
        IkStatus.STALLED,
        IkStatus.BUDGET,
    }


@pytest.mark.parametrize("method", PLAIN)
def test_a_pose_out_of_reach_is_near_the_nearest(method: IkMethod) -> None:
    problem = build(balls(), [TIP])
    result = solve(problem, None, Targets([[[1.0, 3.0, 1.0]]]), IkOptions(method))
    assert result.statuses[0] in {IkStatus.STALLED, IkStatus.BUDGET}
    nearest = np.linalg.norm([1.0, 3.0, 1.0]) - 1.9
    assert nearest - 1e-9 <= result.positions[0, 0] < 1.02 * nearest


@pytest.mark.parametrize("method", PLAIN)
def test_a_straight_limb_bends_to_a_goal_on_its_own_line(method: IkMethod) -> None:
    problem = build(balls(), [TIP])
    options = IkOptions(method, tolerance=1e-4)
    result = solve(problem, None, Targets([[[1.2, 0.0, 0.0]]]), options)
    assert result.converged.all()


@pytest.mark.parametrize("method", PLAIN)
def test_a_budget_ends_every_method(method: IkMethod) -> None:
    problem = build(balls(), [TIP])
    options = IkOptions(method, iterations=2, tolerance=1e-12)
    result = solve(problem, None, Targets([[[0.3, 0.9, 0.4]]]), options)
    assert result.statuses == (IkStatus.BUDGET,)
    assert result.iterations[0] == 2


@pytest.mark.parametrize("method", PLAIN)
def test_trees_serve_all_their_goals(method: IkMethod) -> None:
    goals = [Goal("elbow_l", (0.3, 0, 0)), Goal("elbow_r", (-0.3, 0, 0))]
    problem = build(tree(), goals)
    targets = reached_by(problem, random_pose(problem, 2))
    options = IkOptions(method, tolerance=1e-3, iterations=20000)
    assert solve(problem, None, targets, options).converged.all()


@pytest.mark.parametrize("method", [IkMethod.NEWTON, IkMethod.CCD, IkMethod.GRADIENT])
def test_orientations_aims_and_slides_are_served(method: IkMethod) -> None:
    goals = [
        Goal("hand", (0.1, 0.0, 0.0), orientation=0.5),
        Goal("other", (0.0, 0.2, 0.0), position=0.0, aim=0.3),
    ]
    problem = build(mixed_rig(), goals)
    start = random_pose(problem, 8)
    targets = reached_by(problem, random_pose(problem, 9))
    options = IkOptions(method, tolerance=1e-3, angle_tolerance=1e-2, iterations=50000)
    assert solve(problem, start, targets, options).converged.all()


def test_newton_needs_few_steps_where_descent_needs_many() -> None:
    problem = build(arm(6), [Goal("b5", (0.2, 0.0, 0.0), orientation=1.0)])
    pose = random_pose(problem, 4)
    targets = reached_by(problem, pose + 0.2)
    newton, gradient = (
        solve(problem, pose, targets, IkOptions(method))
        for method in (IkMethod.NEWTON, IkMethod.GRADIENT)
    )
    assert newton.converged.all()
    assert newton.iterations[0] < 12
    assert gradient.iterations[0] > 5 * newton.iterations[0]


def test_limbs_stretch_whatever_the_method() -> None:
    problem = build(balls(), [replace(TIP, offset=(0, 0, 0), soft=0.1, stretch=0.5)])
    targets = Targets([[[1.2, 1.2, 0.6]]])
    for method in PLAIN:
        result = solve(problem, None, targets, IkOptions(method, tolerance=1e-4))
        assert result.converged.all()
        assert result.stretches[0, 0] > 1.1


def test_methods_that_cannot_serve_a_problem_say_why() -> None:
    plain = Goal("b4", (0.3, 0.0, 0.0))
    cases: list[tuple[IkMethod, Problem]] = [
        (IkMethod.TWO_BONE, build(arm(5), [plain])),
        (IkMethod.FABRIK, build(arm(5), [replace(plain, orientation=1.0)])),
        (IkMethod.FABRIK, build(mixed_rig(), [Goal("hand", (0.1, 0.0, 0.0))])),
        (IkMethod.CCD, build(arm(5), [replace(plain, pole=1.0)])),
        (IkMethod.CCD, build(arm(5), [plain], rest_weight=1.0)),
        (IkMethod.NEWTON, build(arm(5), [plain, Goal("b2", priority=1)])),
        (IkMethod.GRADIENT, build(arm(5), [plain, Goal("b2", priority=1)])),
    ]
    for method, problem in cases:
        nothing = np.zeros((1, len(problem.goals), 3))
        targets = Targets(nothing, np.ones((1, len(problem.goals), 4)), None, nothing)
        with pytest.raises(OptionError) as caught:
            solve(problem, None, targets, IkOptions(method))
        fault = caught.value.faults[0]
        assert fault.code == "IK015"
        assert fault.hint is not None
        assert "auto, damped" in fault.hint
        assert method not in supported_methods(problem)


@pytest.mark.parametrize("name", ["magic", "two_bone"])
def test_names_of_methods_are_checked(name: str) -> None:
    pins = [Joint(f"b{i}", i - 1, JointType.PIN, translation=(i, 0, 0)) for i in (0, 1)]
    problem = build(Rig("pins", tuple(pins)), [Goal("b1", offset=(1.0, 0.0, 0.0))])
    with raises(OptionError, "IK015", match=name):
        solve(problem, None, Targets([[[1.0, 1.0, 0.0]]]), IkOptions(method=name))  # type: ignore[arg-type]


def test_fabrik_names_the_joints_that_travel() -> None:
    rig = balls()
    root = replace(rig.joints[0], type=JointType.FREE)
    problem = build(replace(rig, joints=(root, *rig.joints[1:])), [TIP])
    with raises(OptionError, "IK015", match=f"{root.name} may translate") as caught:
        solve(problem, None, Targets([[[1.0, 0.2, 0.0]]]), IkOptions(IkMethod.FABRIK))
    (fault,) = caught.value.faults
    assert fault.code == "IK015"
    assert "auto, damped" in (fault.hint or "")
    assert "a root below" in (fault.hint or "")
