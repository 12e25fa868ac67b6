from __future__ import annotations

import pytest
from support.faults import raises

from animtool.core.errors import FormatError, OptionError
from animtool.rig import skeleton
from animtool.rig.controls import Control
from animtool.rig.skeleton import Joint, Rig


def test_paths_and_roots() -> None:
    rig = Rig("two", (Joint("a", -1), Joint("b", 0), Joint("c", 1), Joint("prop", -1)))
    assert rig.paths() == ["a", "a/b", "a/b/c", "prop"]
    assert rig.paths(["w", "x", "y", "z"])[2] == "w/x/y"
    assert rig.roots == [0, 3]
    assert rig.parents.tolist() == [-1, 0, 1, -1]
    assert rig.index("c") == 2


def test_paths_of_a_very_long_chain_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(skeleton, "MAX_PATH_CHARACTERS", 9)
    joints = (Joint("a", -1), Joint("b", 0), Joint("c", 1))
    assert Rig("three", joints).paths() == ["a", "a/b", "a/b/c"]
    with pytest.raises(FormatError) as caught:
        Rig("four", (*joints, Joint("d", -1))).paths()
    assert caught.value.code == "USD020"


def test_a_name_stands_once() -> None:
    with pytest.raises(OptionError) as caught:
        Rig("twice", (Joint("a", -1), Joint("a", 0), Joint("b", 5)))
    assert [fault.code for fault in caught.value.faults] == ["RIG001", "RIG003"]


@pytest.mark.parametrize("parent", [1, 2, -2])
def test_parents_come_first(parent: int) -> None:
    with raises(OptionError, "RIG003"):
        Rig("late", (Joint("a", -1), Joint("b", parent)))


def test_a_name_that_is_none_finds_the_nearest() -> None:
    with pytest.raises(OptionError) as caught:
        Rig("hero", (Joint("hand_l", -1),)).index("hnad_l")
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("RIG008", "did you mean 'hand_l'?")


def test_a_short_repr() -> None:
    joints = tuple(Joint(f"j{i}", i - 1) for i in range(1000))
    rig = Rig("rope", joints, 0.01, controls=(Control("bend"), Control("sway")))
    assert repr(rig) == "<Rig 'rope': 1000 joints, 2 controls, in cm, Y up>"
    one = Rig("rope", joints[:1], controls=(Control("bend"),))
    assert repr(one) == "<Rig 'rope': 1 joint, 1 control, in m, Y up>"


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("hand_l", "'wrist_l'"),
        ("hand", "'wrist_l', 'wrist_r'"),
        ("pelvis", "'hips'"),
        ("elbw_l", "did you mean 'elbow_l'"),
        ("LeftUpLeg", "'hip_l'"),
        ("tail", "hips, spine_1"),
    ],
)
def test_a_name_of_a_part_of_the_body_finds_its_joint(name: str, joint: str) -> None:
    rig = Rig.load("rigs/biped/biped.rig.yaml")
    with pytest.raises(OptionError) as caught:
        rig.index(name)
    (fault,) = caught.value.faults
    assert fault.code == "RIG008"
    assert joint in (fault.hint or "")
