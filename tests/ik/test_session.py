"""One pose a call: the same as the batch, to the last bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.ik import arm, every_goal, limb, mixed_rig, random_pose, reached_by

from animtool.core.errors import OptionError
from animtool.ik import Goal, IkOptions, Session, Targets, build, solve
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import JointType, Mimic, Rig

NAN = float("nan")


def assert_same(one: Any, many: Any, row: int) -> None:
    """Compare a result of a session with a row of a batch."""
    np.testing.assert_array_equal(one.coordinates[0], many.coordinates[row])
    np.testing.assert_array_equal(one.misses[0], many.misses[row])
    assert one.statuses == many.statuses[row : row + 1]
    assert one.iterations[0] == many.iterations[row]
    assert one.stretches.tolist() == many.stretches[row : row + 1].tolist()


@pytest.mark.parametrize("options", [IkOptions(), IkOptions(restarts=3, seed=5)])
def test_a_session_has_the_answers_of_the_batch(options: IkOptions) -> None:
    rig, goals = mixed_rig(), every_goal()
    problem = build(rig, goals)
    targets = reached_by(problem, random_pose(problem, 1, frames=6))
    starts = random_pose(problem, 2, frames=6)
    many = solve(problem, starts, targets, options)
    session = Session(rig, *goals, options=options)
    for row, start in enumerate(starts):
        values = {
            goal.joint: tuple(
                np.asarray(getattr(targets, kind.targets_field))[row, e]
                for kind in goal.kinds
            )
            for e, goal in enumerate(goals)
        }
        values["piston"] = values["piston"][0]
        assert_same(session.solve(values, start=start), many, row)


def test_a_joint_is_asked_for_what_a_call_has_of_it() -> None:
    rig = mixed_rig()
    session = rig.ik("hand", "other")
    place, turn = np.array([0.4, 1.3, 0.3]), so3.exp([0.2, 0.1, -0.4])
    wishes: list[tuple[dict[str, Any], list[Goal], Targets]] = [
        (
            {"hand": (place, turn)},
            [Goal("hand", orientation=1.0)],
            Targets([[place]], [[turn]]),
        ),
        ({"hand": place}, [Goal("hand")], Targets([[place]])),
        (
            {"hand": (None, turn)},
            [Goal("hand", position=0.0, orientation=1.0)],
            Targets(rotations=[[turn]]),
        ),
        (
            {"other": [0.0, 1.4, 0.2], "hand": tuple(place)},
            [Goal("other"), Goal("hand")],
            Targets([[[0.0, 1.4, 0.2], place]]),
        ),
    ]
    for _ in range(2):
        for given, goals, targets in wishes:
            many = solve(build(rig, goals), None, targets)
            assert_same(session.solve(given), many, 0)


def test_a_chain_reaches_from_its_root() -> None:
    joints = mixed_rig()
    index = joints.index("hand")
    root = joints.names[joints.upwards(index)[1]]
    rig = replace(joints, chains=(IkChain("reach", root, "hand"),))
    point = np.array([0.4, 1.3, 0.3])
    goal = Goal("hand", root=root)
    many = solve(build(rig, [goal]), None, Targets([[point]]))
    assert_same(rig.ik("reach").solve(reach=point), many, 0)
    with pytest.raises(OptionError) as caught:
        rig.ik("reach", joints=["reach"])
    assert caught.value.faults[0].code == "TGT001"


def test_joints_are_where_forward_kinematics_has_them() -> None:
    rig = mixed_rig()
    session = rig.ik("hand")
    result = session.solve(hand=[0.4, 1.3, 0.3])
    local = local_from_coordinates(rig, result.coordinates)
    world = forward_kinematics(rig, local.translations, local.rotations)
    np.testing.assert_array_equal(result.world().positions, world.positions)
    np.testing.assert_array_equal(result.world().linear, world.linear)
    assert result.world() is result.world()
    moved = replace(result, coordinates=session.solve(hand=[0, 1, 0]).coordinates)
    assert not np.array_equal(moved.world().positions, world.positions)


def test_bones_of_a_session_stretch() -> None:
    rig = limb()
    stretching = Goal("elbow", (0.27, 0.0, 0.0), stretch=0.5)
    found = Session(rig, stretching).solve(elbow=[0.8, 1.2, 0.0])
    assert found.stretches[0, 0] > 1.1
    placed = found.world().positions
    rows = forward_kinematics(
        rig,
        found.local_translations(),
        local_from_coordinates(rig, found.coordinates).rotations,
    )
    np.testing.assert_allclose(placed, rows.positions, atol=1e-15)


def test_joints_that_mimic_others_come_along() -> None:
    joints = list(arm(3).joints)
    joints.append(replace(joints[0], name="far", mimic=Mimic("near", 2.0, 0.1)))
    joints.append(replace(joints[0], name="near", mimic=Mimic("b1", -0.5)))
    rig = Rig("led", tuple(joints))
    q = rig.ik("b2").solve(b2=[0.5, 0.3, 0.1]).coordinates[0]
    assert q[4] == -0.5 * q[1]
    assert q[3] == 2.0 * q[4] + 0.1


def test_joints_that_move_no_goal_are_within_limits() -> None:
    joints = list(arm(3).joints)
    joints.append(replace(joints[0], name="bent", limits=RangeLimit(0.2, 1.0)))
    joints.append(replace(joints[0], name="tail", mimic=Mimic("bent", 2.0, 0.1)))
    joints.append(replace(joints[0], name="free"))
    mimic, limits = Mimic("free", 1.0, 0.0), RangeLimit(0.3, 1.0)
    joints.append(replace(joints[0], name="tied", mimic=mimic, limits=limits))
    rig = Rig("bent", tuple(joints))
    q = rig.ik("b2").solve(b2=[0.5, 0.3, 0.1]).coordinates[0]
    assert q[3:].tolist() == [0.2, 0.5, 0.3, 0.3]


def test_joints_that_do_not_move_have_the_pose_of_the_session() -> None:
    rig, pose = arm(3), [0.4, 0.0, 0.0]
    session = rig.ik("b2", joints=["b1"], pose=pose)
    target = session.solve(b2=[0.0, 0.0, 0.0]).world().positions[0, 2]
    found = session.solve(b2=target)
    assert found.coordinates[0, 0] == 0.4
    np.testing.assert_allclose(found.world().positions[0, 2], target, atol=1e-6)


@pytest.mark.parametrize("moving", [["b2"], ["b0", "b3"], ["b3", "b4"]])
def test_joints_that_follow_others_above_a_goal_move_with_them(
    moving: list[str],
) -> None:
    joints = list(arm(6).joints)
    joints[2] = replace(joints[2], mimic=Mimic("b0", -0.5, 0.1))
    joints[3] = replace(joints[3], mimic=Mimic("b0", 2.0))
    rig = Rig("tied", tuple(joints))
    session = rig.ik(Goal("b5", (0.2, 0.0, 0.0)), joints=moving)
    found = session.solve(b5=[0.4, 0.5, 0.3])
    placed = found.world()
    reached = placed.positions[0, 5] + placed.linear[0, 5] @ [0.2, 0.0, 0.0]
    miss = np.linalg.norm(reached - [0.4, 0.5, 0.3])
    assert found.positions[0, 0] == pytest.approx(miss, abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_revolutions_of_a_leader_move_those_that_follow(seed: int) -> None:
    joints = list(arm(6).joints)
    joints[0] = replace(joints[0], limits=RangeLimit(3.0, 15.0))
    joints[2] = replace(joints[2], mimic=Mimic("b0", 0.3, -1.0))
    rig, goal = Rig("geared", tuple(joints)), Goal("b5", (0.2, 0.0, 0.0))
    target = np.random.default_rng(seed).uniform(-1, 1, 3)
    found = rig.ik(goal).solve(b5=target, start=[0.0] * 6)
    placed = found.world()
    reached = placed.positions[0, 5] + placed.linear[0, 5] @ [0.2, 0.0, 0.0]
    miss = np.linalg.norm(reached - target)
    assert found.positions[0, 0] == pytest.approx(miss, abs=1e-9)


def test_joints_that_do_not_move_are_where_the_start_has_them() -> None:
    rig = arm(6)
    session = rig.ik(Goal("b5", (0.2, 0.0, 0.0), root="b2"))
    rng = np.random.default_rng(8)
    for _ in range(3):
        start, other = rng.uniform(-0.5, 0.5, (2, 6))
        other[:2] = start[:2]
        local = local_from_coordinates(rig, other[None])
        world = forward_kinematics(rig, local.translations, local.rotations)
        target = world.positions[0, 5] + world.linear[0, 5] @ [0.2, 0.0, 0.0]
        found = session.solve(b5=target, start=start)
        assert found.converged.all()
        assert found.coordinates[0, :2].tolist() == start[:2].tolist()
        placed = found.world()
        reached = placed.positions[0, 5] + placed.linear[0, 5] @ [0.2, 0.0, 0.0]
        np.testing.assert_allclose(reached, target, atol=1e-5)
    # Without a start it is the pose of the session again.
    assert session.solve(b5=target).coordinates[0, :2].tolist() == [0.0, 0.0]


def test_the_last_call_leaves_no_traces() -> None:
    session = mixed_rig().ik("hand")
    first = session.solve(hand=[0.4, 1.3, 0.3])
    kept = first.coordinates.copy()
    session.solve(hand=[9.0, 9.0, 9.0])
    np.testing.assert_array_equal(first.coordinates, kept)
    assert_same(session.solve(hand=[0.4, 1.3, 0.3]), first, 0)


def test_a_session_starts_from_a_row_of_a_result() -> None:
    session = mixed_rig().ik("hand")
    row = session.solve(hand=[0.4, 1.3, 0.3]).coordinates
    assert row.shape == (1, session.rig.coordinates)
    by_row = session.solve(hand=[0.4, 1.2, 0.3], start=row, prefer=row)
    by_pose = session.solve(hand=[0.4, 1.2, 0.3], start=row[0], prefer=row[0])
    np.testing.assert_array_equal(by_row.coordinates, by_pose.coordinates)


def test_options_that_take_longer_are_heeded() -> None:
    rig = mixed_rig()
    near = IkOptions(near=True)
    problem = build(rig, [Goal("hand")])
    targets = Targets([[[0.2, 1.2, 0.5]]])
    start = random_pose(problem, 7)[0]
    many = solve(problem, start, targets, near)
    assert_same(
        Session(rig, "hand", options=near).solve(hand=[0.2, 1.2, 0.5], start=start),
        many,
        0,
    )


@pytest.mark.parametrize(
    ("call", "code"),
    [
        ({"hnad": [0, 0, 0]}, "TGT001"),
        ({"hand": [0, 0]}, "IK010"),
        ({"hand": 3.0}, "IK010"),
        ({"hand": np.zeros((3, 3))}, "IK010"),
        ({"hand": "abc"}, "IK010"),
        ({"hand": ([0, 0, 0], [0, 0, 0, 1], [0, 0, 0])}, "IK010"),
        ({"hand": [0, NAN, 0]}, "TGT007"),
        ({"hand": ([0, 0, 0], [0, 0, 0, 0])}, "TGT007"),
        ({"hand": (None, None)}, "TGT002"),
        ({}, "IK006"),
        ({"hand": [0, 0, 0], "start": np.zeros(3)}, "IK012"),
        ({"hand": [0, 0, 0], "start": np.full(15, NAN)}, "IK013"),
    ],
)
def test_what_makes_no_sense_is_refused(call: dict[str, Any], code: str) -> None:
    rig = mixed_rig()
    if "start" in call and len(call["start"]) == 15:
        call = {**call, "start": np.full(rig.coordinates, NAN)}
    session = rig.ik("hand")
    with pytest.raises(OptionError) as caught:
        session.solve(**call)
    assert caught.value.faults[0].code == code


@pytest.mark.parametrize(
    ("goals", "code"), [((), "IK006"), (("a", "a"), "IK006"), (("b",), "TGT001")]
)
def test_sessions_have_goals(goals: tuple[str, ...], code: str) -> None:
    rig = Rig("one", (replace(arm(1).joints[0], name="a", type=JointType.BALL),))
    with pytest.raises(OptionError) as caught:
        rig.ik(*goals)
    assert code in {fault.code for fault in caught.value.faults}


def test_far_directions_count_as_directions() -> None:
    rig = mixed_rig()
    own = Goal("hand", position=0.0, aim=1.0)
    far = Session(rig, own).solve(hand=[0.0, 0.0, 1e150])
    many = solve(build(rig, [own]), None, Targets(aims=[[[0.0, 0.0, 1e150]]]))
    assert_same(far, many, 0)


def test_a_session_is_told_apart() -> None:
    assert "mixed" in repr(mixed_rig().ik("hand"))
