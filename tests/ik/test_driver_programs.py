"""Drivers in the chain of the solver: values, slopes, and goals reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.ik import FollowOptions, Goal, IkOptions, Problem, Targets, build, solve
from animtool.ik.clip_solver import follow
from animtool.ik.driver_programs import FOLLOWS_PROGRAM
from animtool.ik.options import IkMethod
from animtool.ik.solving import pack_for_chain
from animtool.ik.sub_rig import find_mimics, sub_rig, with_mimics
from animtool.maths import so3
from animtool.rig.controls import Control
from animtool.rig.drivers import Driver
from animtool.rig.expressions import FUNCTIONS, parse_expression
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PIN, BALL = JointType.PIN, JointType.BALL
TIP = np.array([0.1, 0.02, 0.01])


def expr(text: str, **units: float) -> Driver:
    return Driver(parse_expression(text, allows_coordinates=True), **units)


def limb(driver: Driver | None, **roll: object) -> Rig:
    """Return an arm whose forearm rolls by a driver, as far as its limits let it."""
    free = BallLimit(twist_axis=X)
    made = Joint("roll", 1, PIN, (0.12, 0, 0), axis=X, driven=driver)
    return Rig(
        "arm",
        (
            Joint("upper", -1, BALL, limits=free),
            Joint("elbow", 0, PIN, (0.3, 0, 0), axis=Z),
            replace(made, **roll),  # type: ignore[arg-type]
            Joint("hand", 2, BALL, (0.13, 0.01, 0.02), limits=free),
            Joint("slide", -1, JointType.PRISMATIC, axis=X),
        ),
    )


def poses(rig: Rig, count: int, seed: int = 0, wide: float = 0.6) -> FloatArray:
    """Return poses with driven joints where their drivers put them ``(B, Q)``."""
    rng = np.random.default_rng(seed)
    slices = coordinate_slices(rig)
    q = np.zeros((count, slices[-1].stop))
    for joint, own in zip(rig.joints, slices, strict=True):
        if joint.type is BALL:
            q[:, own] = so3.exp(rng.normal(0, wide, (count, 3)))
        else:
            q[:, own] = rng.uniform(0.1, 0.9, (count, 1))
    return with_mimics(rig, q, rig.names)


def tips(rig: Rig, q: FloatArray, joint: str = "hand") -> tuple[FloatArray, FloatArray]:
    local = local_from_coordinates(rig, q)
    world = forward_kinematics(rig, local.translations, local.rotations)
    j = rig.index(joint)
    points = world.positions[:, j] + world.linear[:, j] @ TIP
    return points[:, None], so3.from_matrix(world.linear[:, j])[:, None]


def linearized(
    problem: Problem, q: FloatArray, targets: Targets, steps: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return residuals and Jacobians of poses, moved by steps."""
    chain = problem.chain
    zero = np.zeros((len(q), problem.degrees))
    found = _kernels.linearize_ik(
        chain.nodes,
        chain.node_numbers,
        chain.goal_nodes,
        chain.goal_numbers,
        chain.from_rig(q),
        pack_for_chain(problem, targets),
        zero if steps is None else steps,
    )
    return found[1], found[2]


DRIVERS = [
    "hand.twist / 2",
    "hand.twist * 0.3 + elbow.angle * elbow.angle - upper.swing_z",
    "sin(hand.swing) + slide.slide * 2",
    "atan2(upper.swing_y, 1.5) + exp(-elbow.angle) - log(2 + elbow.angle)",
    "lerp(elbow.angle, hand.twist, slide.slide) / (1 + elbow.angle)",
    "smoothstep(-1, 2, elbow.angle) + tan(elbow.angle / 3) + cos(hand.twist)",
    "sqrt(1 + elbow.angle) * pow(elbow.angle + 1, 1.7) - min(elbow.angle, 7)",
    "clamp(elbow.angle, -3, 3) + max(hand.twist, -4) + abs(elbow.angle + 2)",
    "sign(elbow.angle) + floor(0.5) + ceil(0.5) - -elbow.angle",
]


def test_every_function_of_expressions_is_tried() -> None:
    assert all(any(f"{name}(" in text for text in DRIVERS) for name in FUNCTIONS)


@pytest.mark.parametrize("text", DRIVERS)
def test_values_and_slopes_are_those_of_differences(text: str) -> None:
    rig = limb(expr(text))
    problem = build(rig, [Goal("hand", tuple(TIP), orientation=1.0)])
    q = poses(rig, 5)
    targets = Targets(*tips(rig, q))
    residuals, jacobians = linearized(problem, q, targets)
    # The kernel's forward kinematics is that of Python.
    assert np.abs(residuals).max() < 1e-13
    step = 1e-6
    for d in range(problem.degrees):
        by = np.zeros((len(q), problem.degrees))
        by[:, d] = step
        ahead, behind = (
            linearized(problem, q, targets, sign * by)[0] for sign in (1, -1)
        )
        slope = (behind - ahead) / (2 * step)
        assert np.abs(jacobians[:, :, d] - slope).max() < 2e-8


@pytest.mark.parametrize("smooth", [False, True])
def test_curves_have_their_slopes(smooth: bool) -> None:
    points = ((-1.0, 0.0), (0.2, 0.1), (0.5, 0.8), (2.0, 1.0))
    rig = limb(Driver(None, "elbow.angle", points, smooth))
    problem = build(rig, [Goal("hand", tuple(TIP), orientation=1.0)])
    q = poses(rig, 8, 3)
    targets = Targets(*tips(rig, q))
    residuals, jacobians = linearized(problem, q, targets)
    assert np.abs(residuals).max() < 1e-13
    by = np.zeros((len(q), problem.degrees))
    by[:, 3] = 1e-6
    ahead, behind = (linearized(problem, q, targets, s * by)[0] for s in (1, -1))
    assert np.abs(jacobians[:, :, 3] - (behind - ahead) / 2e-6).max() < 2e-8


@pytest.mark.parametrize("text", DRIVERS)
def test_goals_are_reached_through_driven_joints(text: str) -> None:
    rig = limb(expr(text))
    problem = build(rig, [Goal("hand", tuple(TIP), orientation=1.0)])
    wanted = poses(rig, 12, 5, 0.4)
    targets = Targets(*tips(rig, wanted))
    result = solve(problem, None, targets)
    assert result.converged.all()
    found = tips(rig, result.coordinates)
    assert np.abs(found[0] - np.asarray(targets.positions)).max() < 1e-6
    again = with_mimics(rig, result.coordinates, rig.names)
    assert np.abs(again - result.coordinates).max() < 1e-12


@pytest.mark.parametrize(
    "method", [IkMethod.DAMPED, IkMethod.NEWTON, IkMethod.GRADIENT, IkMethod.CCD]
)
def test_methods_follow_drivers(method: IkMethod) -> None:
    rig = limb(expr("hand.twist / 2 + elbow.angle * 0.4"))
    problem = build(rig, [Goal("hand", tuple(TIP))])
    targets = Targets(tips(rig, poses(rig, 6, 2, 0.3))[0])
    result = solve(problem, None, targets, IkOptions(method=method))
    assert np.abs(tips(rig, result.coordinates)[0] - targets.positions).max() < 1e-4


def test_knuckles_curl_by_the_first_one_and_reach() -> None:
    middle = Driver(
        None, "k1.angle", ((0.0, 0.0), (0.8, 0.6), (1.6, 1.7)), is_smooth=True
    )
    joints = (
        Joint("k1", -1, PIN, axis=Z, limits=RangeLimit(0, 1.6)),
        Joint(
            "k2",
            0,
            PIN,
            (0.045, 0, 0),
            axis=Z,
            driven=middle,
        ),
        Joint("k3", 1, PIN, (0.03, 0, 0), axis=Z, driven=expr("k2.angle * 0.7")),
    )
    rig = Rig("finger", joints)
    problem = build(rig, [Goal("k3", tuple(TIP))])
    assert (problem.joints, problem.degrees) == (("k1", "k2", "k3"), 1)
    wanted = with_mimics(
        rig, np.linspace(0.05, 1.55, 40)[:, None] * [[1, 0, 0]], ["k1"]
    )
    result = solve(problem, None, Targets(tips(rig, wanted, "k3")[0]))
    assert result.converged.all()
    assert np.abs(result.coordinates - wanted).max() < 1e-4


def test_a_joint_that_moves_no_goal_moves_those_that_follow_it() -> None:
    rig = limb(expr("slide.slide * 3"))
    problem = build(rig, [Goal("hand", tuple(TIP), orientation=1.0)])
    assert "slide" in problem.joints
    still = build(
        rig, [Goal("hand", tuple(TIP))], joints=["upper", "elbow", "hand", "roll"]
    )
    assert "roll" not in still.joints
    assert (still.chain.nodes[:, 3] != FOLLOWS_PROGRAM).all()


@pytest.mark.parametrize("moving", [["a", "tail"], ["tail"], ["a", "lead"]])
def test_a_driver_follows_the_leader_of_a_mimic_joint(moving: list[str]) -> None:
    pin, along = JointType.PIN, (1.0, 0.0, 0.0)
    rig = Rig(
        "tied",
        (
            Joint("lead", -1, pin),
            Joint("a", -1, pin),
            Joint("tail", 1, pin, along, mimic=Mimic("lead", 2.0, 0.1)),
            Joint("mid", 2, pin, along, driven=expr("lead.angle * lead.angle")),
            Joint("tip", 3, JointType.FIXED, along),
        ),
    )
    session = rig.ik("tip", joints=moving)
    # Drivers decide, not the start.
    found = session.solve(tip=[1.5, 1.9, 0.0], start=[0.3, 0.2, 0.7, 0.5])
    miss = np.linalg.norm(found.world().positions[0, 4] - [1.5, 1.9, 0.0])
    assert found.positions[0, 0] == pytest.approx(miss, abs=1e-9)


def test_limits_of_a_driven_joint_hold() -> None:
    rig = limb(expr("hand.twist * 2"), limits=RangeLimit(-0.3, 0.3))
    problem = build(rig, [Goal("hand", tuple(TIP), orientation=1.0)])
    wanted = poses(rig, 20, 9, 0.8)
    result = solve(problem, None, Targets(*tips(rig, wanted)))
    roll = result.coordinates[:, coordinate_slices(rig)[2]]
    assert np.abs(roll).max() <= 0.3 + 1e-12
    assert result.converged.all()


def test_a_mimic_of_a_driven_joint_follows_in_the_chain() -> None:
    joints = (
        Joint("a", -1, PIN, axis=Z),
        Joint("b", 0, PIN, (0.3, 0, 0), axis=Z, driven=expr("a.angle * a.angle")),
        Joint("c", 1, PIN, (0.3, 0, 0), axis=Z, mimic=Mimic("b", -0.5, 0.1)),
    )
    rig = Rig("row", joints)
    problem = build(rig, [Goal("c", tuple(TIP))])
    wanted = with_mimics(rig, np.array([[0.7, 0, 0], [-1.2, 0, 0]]), ["a"])
    assert wanted[0].tolist() == pytest.approx([0.7, 0.49, -0.145])
    result = solve(problem, wanted * 0.8, Targets(tips(rig, wanted, "c")[0]))
    assert result.converged.all()
    assert find_mimics(rig, ["a"]) == ["b", "c"]


def test_clips_are_followed_and_smoothed_with_drivers() -> None:
    rig = limb(expr("hand.twist / 2 + sin(elbow.angle)"))
    problem = build(rig, [Goal("hand", tuple(TIP))])
    ways = poses(rig, 2, 4, 0.3)
    share = np.linspace(0, 1, 30)[:, None]
    path = with_mimics(rig, (1 - share) * ways[0] + share * ways[1], rig.names)
    targets = Targets(tips(rig, path)[0])
    options = FollowOptions(smooth=0.2)
    result = follow(problem, path[0], targets, options)
    assert result.converged.all()
    # What is returned is driven, also after it was smoothed.
    again = with_mimics(rig, result.coordinates, rig.names)
    assert np.abs(again - result.coordinates).max() < 1e-12
    assert np.abs(tips(rig, result.coordinates)[0] - targets.positions).max() < 1e-5


def test_controls_count_at_their_values() -> None:
    controls = (
        Control("gain", default=0.25),
        Control("both", driven=expr("gain + elbow.angle * 0")),
    )
    rig = replace(limb(expr("gain * hand.twist + both")), controls=controls)
    part, _ = sub_rig(rig, ["hand"])
    assert [control.name for control in part.controls] == ["gain", "both"]
    problem = build(part, [Goal("hand", tuple(TIP), orientation=1.0)])
    q = poses(part, 4)
    twist = 2 * np.arctan2(q[:, -4], q[:, -1])
    assert q[:, 5] == pytest.approx(0.25 * twist + 0.25)
    residuals, _ = linearized(problem, q, Targets(*tips(part, q)))
    assert np.abs(residuals).max() < 1e-13


@pytest.mark.parametrize(
    "rows",
    [
        [[3, 0, 6, 1]],
        [[3, 0, 1, 99]],
        [[3, 0, 2, 6]],
        [[3, 0, 99, 1]],
        [[3, 1, 0, 1]],
        [[3, 0, 3, 2]],
        [[3, 0, 5, 3]],
        [[3, 0, 0, 1], [3, 0, 0, 1]],
        [],
    ],
)
def test_programs_that_make_no_sense_are_refused(rows: list[list[int]]) -> None:
    problem = build(limb(expr("elbow.angle")), [Goal("hand", tuple(TIP))])
    chain = problem.chain
    own = chain.nodes[:, 0] < 3
    nodes = np.concatenate([chain.nodes[own], np.array(rows, np.int64).reshape(-1, 4)])
    numbers = np.concatenate([chain.node_numbers[own], np.zeros((len(rows), 18))])
    q = poses(problem.rig, 1)
    packed = pack_for_chain(problem, Targets(tips(problem.rig, q)[0]))
    with pytest.raises(ValueError, match="nodes"):
        _kernels.linearize_ik(
            nodes,
            numbers,
            chain.goal_nodes,
            chain.goal_numbers,
            chain.from_rig(q),
            packed,
            np.zeros((1, problem.degrees)),
        )


def test_a_rig_without_drivers_has_no_programs() -> None:
    chain = build(limb(None), [Goal("hand", tuple(TIP))]).chain
    assert (chain.nodes[:, 0] < 3).all()


def test_unknown_names_are_refused() -> None:
    with pytest.raises(OptionError) as caught:
        build(limb(expr("wrist.twist")), [Goal("hand", tuple(TIP))])
    assert [fault.code for fault in caught.value.faults] == ["RIG008"]
