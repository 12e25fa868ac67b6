"""Left and right joints, paired by their names."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.rig.sides import find_likely_pairs, pair_sides

PAIRS = [
    ("L_arm", "R_arm"),
    ("l_arm", "r_arm"),
    ("L-arm", "R-arm"),
    ("Left", "Right"),
    ("left_leg_2", "right_leg_2"),
    ("LEFT_ARM", "RIGHT_ARM"),
    ("LeftArm", "RightArm"),
    ("LeftArm", "rightArm"),
    ("leftUpLeg1", "rightUpLeg1"),
    ("armleft", "armright"),
    ("mCollarLeft", "mCollarRight"),
    ("Arm_Left_jnt", "Arm_Right_jnt"),
    ("mixamorig:LeftArm", "mixamorig:RightArm"),
    ("mixamorigLeftArm", "mixamorigRightArm"),
    ("ns:sub:l_arm", "ns:sub:r_arm"),
    ("arm_L", "arm_R"),
    ("arm.l", "arm.r"),
    ("arm.L.001", "arm.R.001"),
    ("shldr.L", "shldr.R"),
    ("armL", "armR"),
    ("arm_lf", "arm_rt"),
    ("LfArm", "RtArm"),
    ("arm_lt", "arm_rt"),
    ("lft_arm", "rgt_arm"),
    ("thumb_01_l", "thumb_01_r"),
    ("hand_l_01", "hand_r_01"),
    ("arm_l1", "arm_r1"),
    ("Bip01 L Thigh", "Bip01 R Thigh"),
    ("J_Bip_L_Hand", "J_Bip_R_Hand"),
    ("LArm", "RArm"),
    ("LHipJoint", "RHipJoint"),
    ("lShldr", "rShldr"),
    ("lhumerus", "rhumerus"),
    ("footl", "footr"),
    ("左腕", "右腕"),
]


@pytest.mark.parametrize(("left", "right"), PAIRS)
def test_a_pair(left: str, right: str) -> None:
    for names in ([left, "hips", right], [right, "hips", left]):
        pairs = pair_sides(names)
        assert pairs.partners.tolist() == [2, 1, 0]
        assert names[pairs.left[0]] == left
        assert not pairs.unpaired_indices


@pytest.mark.parametrize(
    "name",
    [
        "clavicle",
        "lower_leg",
        "rib_3",
        "bright",
        "Lr",
        "L5",
        "LOD0",
        "root",
        "rear",
        "Lower",
        "upright",
    ],
)
def test_names_without_a_side(name: str) -> None:
    pairs = pair_sides([name, "hips"])
    assert pairs.partners.tolist() == [0, 1]
    assert not pairs.unpaired_indices


def test_a_bare_letter_pairs_only_under_partners() -> None:
    # A rib is no partner of a lib elsewhere.
    names = ["root", "lib", "chest", "rib"]
    assert pair_sides(names, [-1, 0, 0, 2]).partners.tolist() == [0, 1, 2, 3]
    assert pair_sides(names, [-1, 0, 0, 0]).partners.tolist() == [0, 3, 2, 1]


def test_names_of_other_hierarchies_are_strays() -> None:
    names = ["hips", "arm_l", "spine", "arm_r", "hand_l", "hand_r"]
    pairs = pair_sides(names, [-1, 0, 0, 2, 1, 3])
    assert pairs.partners.tolist() == list(range(6))
    assert [names[i] for i in pairs.unpaired_indices] == [
        "arm_l",
        "arm_r",
        "hand_l",
        "hand_r",
    ]
    assert find_likely_pairs(names, pairs) == [("arm_l", "arm_r"), ("hand_l", "hand_r")]
    stated = pair_sides(["a", "hand_r", "hand_l"], None, [("a", "hand_r")])
    assert stated.partners.tolist() == [1, 0, 2]
    assert stated.unpaired_indices == (2,)


@given(st.lists(st.text("lrLR_.:ab1", max_size=6), unique=True, max_size=12))
def test_pairs_are_one_to_one(names: list[str]) -> None:
    pairs = pair_sides(names)
    partners = pairs.partners.tolist()
    assert [partners[p] for p in partners] == list(range(len(names)))
    assert all(partners[i] != i for i in pairs.left)
