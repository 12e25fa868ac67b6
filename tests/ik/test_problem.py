"""What is in a problem, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.faults import raises
from support.ik import arm, every_goal, limb, mixed_rig

from animtool.core.errors import OptionError
from animtool.ik import Goal, build
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig


def codes(caught: pytest.ExceptionInfo[OptionError]) -> list[str]:
    return [fault.code for fault in caught.value.faults]


def test_joints_that_move_no_goal_are_not_in_the_problem() -> None:
    problem = build(mixed_rig(), [Goal("elbow", (0.1, 0.0, 0.0))])
    assert problem.joints == ("root", "spine", "elbow")
    assert problem.degrees == 6 + 3 + 1
    assert set(problem.limits) == {"spine", "elbow"}


def test_joints_that_turn_about_the_point_are_not_in_the_problem() -> None:
    problem = build(mixed_rig(), [Goal("hand")])
    assert problem.joints == ("root", "spine", "elbow", "piston")
    problem = build(mixed_rig(), [Goal("hand", orientation=1.0)])
    assert problem.joints[-1] == "hand"


def test_rows_are_those_asked_for() -> None:
    assert build(mixed_rig(), every_goal()).rows == 6 + 5 + 1


def test_only_the_joints_named_move() -> None:
    goal = Goal("hand", (0.1, 0.0, 0.0))
    problem = build(mixed_rig(), [goal], joints=["elbow", "hand"])
    assert problem.joints == ("elbow", "hand")
    assert problem.degrees == 4


def test_a_goal_with_a_root_moves_the_joints_from_there() -> None:
    hand = Goal("hand", (0.1, 0.0, 0.0), root="elbow")
    assert build(mixed_rig(), [hand]).joints == ("elbow", "piston", "hand")
    other = Goal("other", (0.0, 0.2, 0.0), root="spine")
    both = build(mixed_rig(), [hand, other])
    assert both.joints == ("spine", "elbow", "piston", "hand", "other")


@pytest.mark.parametrize(
    ("joint", "root", "code", "hint"),
    [
        ("hand", "hnd", "TGT001", "'hand'"),
        ("hand", "other", "TGT012", "'piston', 'plate', 'elbow', 'spine', 'root'"),
        ("elbow", "hand", "TGT012", "write joint='hand', root='elbow'"),
    ],
)
def test_a_root_is_above_its_joint(joint: str, root: str, code: str, hint: str) -> None:
    with pytest.raises(OptionError) as caught:
        build(mixed_rig(), [Goal(joint, (0.1, 0.0, 0.0), root=root)])
    assert codes(caught) == [code]
    assert hint in (caught.value.faults[0].hint or "")


def test_the_length_is_the_longest_way_along_the_bones() -> None:
    assert math.isclose(build(arm(3), [Goal("b2", (0.3, 0, 0))]).length, 1.1)


def test_pins_that_turn_all_the_way_have_no_gap() -> None:
    joint = Joint("a", -1, JointType.PIN, limits=RangeLimit(-math.pi, math.pi))
    problem = build(Rig("wheel", (joint,)), [Goal("a", (1, 0, 0))])
    assert np.isinf(problem.chain.node_numbers[0, 14:16]).all()
    np.testing.assert_allclose(problem.chain.periods, [[-math.pi, math.pi]])


def test_a_joint_that_the_rig_lacks_is_named_with_the_nearest() -> None:
    with raises(OptionError, "TGT001", "TGT001") as caught:
        build(limb(), [Goal("elbo")], joints=["sholder"])
    assert codes(caught) == ["TGT001", "TGT001"]


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        (Goal("elbow", position=0.0), "TGT002"),
        (Goal("elbow", position=-1.0), "TGT007"),
        (Goal("elbow", position=math.nan), "TGT007"),
        (Goal("elbow", (math.inf, 0.0, 0.0)), "IK002"),
        (Goal("elbow", (1.0, 0.0)), "IK002"),  # type: ignore[arg-type]
        (Goal("elbow", aim=1.0, aim_axis=(0.0, 0.0, 2.0)), "TGT008"),
    ],
)
def test_a_goal_that_asks_for_nothing_or_no_number_is_refused(
    goal: Goal, code: str
) -> None:
    with pytest.raises(OptionError) as caught:
        build(limb(), [goal])
    assert codes(caught) == [code]


def test_a_goal_that_nothing_moves_is_refused() -> None:
    post = Rig("post", (Joint("a", -1, JointType.FIXED),))
    pivot = Rig("pivot", (Joint("a", -1, JointType.PIN),))
    for rig in (post, pivot):
        with pytest.raises(OptionError) as caught:
            build(rig, [Goal("a")])
        assert codes(caught) == ["IK003"]


def test_joints_are_no_text() -> None:
    with raises(OptionError, "TGT001", match="'elbow'") as caught:
        build(limb(), [Goal(limb().names[-1])], joints="elbow")
    assert codes(caught) == ["TGT001"]


def test_why_nothing_moves_a_goal_is_said() -> None:
    post = Rig("post", (Joint("a", -1, JointType.FIXED),))
    pivot = Rig("pivot", (Joint("a", -1, JointType.PIN),))
    hand = Goal(limb().names[-1])
    able = build(limb(), [hand]).joints
    for rig, goal, joints, hint in [
        (post, Goal("a"), None, "only fixed joints are above it"),
        (
            pivot,
            Goal("a"),
            None,
            "a joint cannot move a position at its own origin: set an offset",
        ),
        (limb(), hand, [], f"add to joints one that can: {able[-1]}"),
    ]:
        with pytest.raises(OptionError) as caught:
            build(rig, [goal], joints=joints)
        (fault,) = caught.value.faults
        assert fault.code == "IK003"
        assert (fault.hint or "").startswith(hint)


@pytest.mark.filterwarnings("error")
def test_bones_and_offsets_without_squares_are_refused() -> None:
    joints = limb().joints
    long = replace(joints[-1], translation=(1e200, 0.0, 0.0))
    with pytest.raises(OptionError) as caught:
        build(Rig("long", (*joints[:-1], long)), [Goal(long.name)])
    assert codes(caught) == ["IK009"]
    with pytest.raises(OptionError) as caught:
        build(limb(), [Goal(long.name, offset=(0.0, 1e308, 0.0))])
    assert codes(caught) == ["IK002"]


def test_a_pole_needs_two_bones() -> None:
    with pytest.raises(OptionError) as caught:
        build(arm(1), [Goal("b0", (1, 0, 0), pole=1.0)])
    assert codes(caught) == ["IK004"]


@pytest.mark.parametrize(
    "limits",
    [RangeLimit(1.0, -1.0), BallLimit(None, (1.0, -1.0)), RangeLimit(0, math.nan)],
)
def test_reversed_limits_are_refused(limits: RangeLimit | BallLimit) -> None:
    kind = JointType.PIN if isinstance(limits, RangeLimit) else JointType.BALL
    with pytest.raises(OptionError) as caught:
        build(Rig("a", (Joint("a", -1, kind, limits=limits),)), [Goal("a", (1, 0, 0))])
    assert codes(caught) == ["IK005"]


def test_there_must_be_goals() -> None:
    with pytest.raises(OptionError) as caught:
        build(limb(), [], rest_weight=-1.0)
    assert codes(caught) == ["IK006", "IK014"]


def test_its_repr_is_one_short_line() -> None:
    problem = build(mixed_rig(), [Goal("elbow", (0.1, 0.0, 0.0)), Goal("spine")])
    name, degrees = mixed_rig().name, problem.degrees
    expected = f"<Problem of {name!r}: 2 goals, 3 joints, {degrees} degrees of freedom>"
    assert repr(problem) == expected
