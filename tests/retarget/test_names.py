"""Names of joints taken apart, however they are spelled."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.people import named, person

from animtool.core.errors import OptionError
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.names import (
    best_preset,
    check_presets,
    find_preset,
    parse_names,
    presets,
)
from animtool.retarget.roles import ROLES, base_role

PREFIXES = ["", "mixamorig1:", "mixamorig9:", "a:b:", "|root|x:", "Bip001 ", "hero_"]
# How a side is written, and how both go into a name.
SIDES = [
    ("Left", "Right", "{side}{name}"),
    ("left", "right", "{side}_{name}"),
    ("L", "R", "{side}_{name}"),
    ("l", "r", "{name}_{side}"),
    ("L", "R", "{name}.{side}"),
    ("l", "r", "{side}{name}"),
    ("Left", "Right", "{name}{side}"),
    ("LEFT", "RIGHT", "{name}-{side}"),
    ("Lf", "Rt", "{side}_{name}"),
    ("lft", "rgt", "{name}_{side}"),
    ("左", "右", "{side}{name}"),
]
SUFFIXES = ["", "_jnt", "_joint", "_bone"]
# Conventions whose names are words that a prefix or another spelling leaves whole.
SPELLED = ["mixamo", "hik", "biovision", "smpl", "unity_humanoid", "daz_genesis_9"]


@given(
    st.sampled_from(SPELLED),
    st.sampled_from(PREFIXES),
    st.sampled_from(SIDES),
    st.sampled_from(SUFFIXES),
)
def test_spellings_of_a_convention_are_known(
    preset: str, prefix: str, sides: tuple[str, str, str], suffix: str
) -> None:
    names = named(preset)

    def rename(role: str) -> str:
        name = re.sub(r"^.*:", "", names(role))
        if not name:
            return ""
        if role[-2:] in {"_l", "_r"}:
            word = sides[role[-1] == "r"]
            bare = re.sub("(?i)^(left|right|l|r)_?(?=[A-Za-z])", "", name)
            name = sides[2].format(side=word, name=bare)
        return f"{prefix}{name}{suffix}"

    rig, roles = person(rename)
    found = dict(zip(rig.names, find_anatomy(rig).roles, strict=True))
    assert found == roles


@pytest.mark.parametrize(
    ("name", "other", "side", "key"),
    [
        ("LeftUpLeg", "RightUpLeg", "l", "upleg"),
        ("lfemur", "rfemur", "l", "femur"),
        ("upperarm01.R", "upperarm01.L", "r", "upperarm01"),
        ("mCollarLeft", "mCollarRight", "l", "mcollar"),
        ("LFArm", "RFArm", "l", "farm"),
        ("CC_Base_L_Thigh", "CC_Base_R_Thigh", "l", "thigh"),
        ("右つま先", "左つま先", "r", "つま先"),
        ("left_hip_joint", "right_hip_joint", "l", "hip"),
        # No sides: a vertebra, and words that begin with their letters.
        ("J_L5", "J_L4", "", "l5"),
        ("lowerback", "upperback", "", "lowerback"),
        # A joint between hips and thigh is none of them.
        ("LHipJoint", "RHipJoint", "l", "hipjoint"),
    ],
)
def test_a_name_is_taken_apart(name: str, other: str, side: str, key: str) -> None:
    read = parse_names([name, other], np.array([-1, -1]))
    assert (read[0].side, read[0].name_key) == (side, key)


def test_a_start_that_all_share_is_no_prefix_where_it_says_the_side() -> None:
    names = ["puppet_L_shoulder", "puppet_L_elbow", "puppet_L_wrist"]
    read = parse_names(names, np.array([-1, 0, 1]))
    assert [(one.side, one.name_key) for one in read] == [
        ("l", "shoulder"), ("l", "elbow"), ("l", "wrist")
    ]  # fmt: skip


def test_every_preset_has_roles_that_there_are() -> None:
    assert len(presets()) == 46
    for preset in presets().values():
        assert {role for role in preset.names_by_role if role != "twist"} <= {
            *ROLES,
            *map(base_role, ROLES),
            *(f"twist_{side}" for side in "lr"),
        }


def test_sides_of_presets_have_the_same_joints() -> None:
    for preset in presets().values():
        left = {role[:-2] for role in preset.names_by_role if role.endswith("_l")}
        assert left == {
            role[:-2] for role in preset.names_by_role if role.endswith("_r")
        }


def test_an_unknown_preset_is_refused_with_the_nearest() -> None:
    with pytest.raises(OptionError) as caught:
        find_preset("miximo")
    assert caught.value.code == "MAP003"
    assert caught.value.faults[0].hint == "did you mean 'mixamo'?"


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("rigify", "did you mean 'rigify_metarig'?"),
        ("cmu", "did you mean 'cmu_bvh' or 'cmu_daz_bvh'?"),
        ("foo", f"animtool explain MAP003 lists all {len(presets())}"),
    ],
)
def test_an_unknown_preset_is_named_by_its_option(name: str, hint: str) -> None:
    with pytest.raises(OptionError) as caught:
        check_presets(preset="mixamo", target_preset=name)
    (fault,) = caught.value.faults
    assert (fault.code, fault.where, fault.hint) == ("MAP003", "target_preset", hint)
    with pytest.raises(OptionError) as both:
        check_presets(preset=name, target_preset=name)
    assert [fault.where for fault in both.value.faults] == ["preset", "target_preset"]


@pytest.mark.parametrize("thumbs", ["vrm0", "vrm1", "unity_humanoid", "godot_humanoid"])
def test_thumbs_are_not_shifted(thumbs: str) -> None:
    rig, roles = person(named(thumbs))
    found = find_anatomy(rig)
    assert dict(zip(rig.names, found.roles, strict=True)) == roles
    middle = {"vrm0": "leftThumbIntermediate", "vrm1": "leftThumbProximal"}
    if thumbs in middle:
        assert roles[middle[thumbs]] == "thumb_2_l"


@pytest.mark.parametrize("preset", ["mixamo", "smpl", "biovision", "advanced_skeleton"])
def test_a_left_shoulder_is_what_its_convention_says(preset: str) -> None:
    rig, roles = person(named(preset), fingers=preset != "biovision")
    found = dict(zip(rig.names, find_anatomy(rig).roles, strict=True))
    assert found == roles


@pytest.mark.parametrize(
    ("names", "role"),
    [
        (("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"), "clavicle_l"),
        (("LeftCollar", "LeftShoulder", "LeftElbow", "LeftWrist"), "upper_arm_l"),
        (("", "LeftShoulder", "LeftElbow", "LeftWrist"), "upper_arm_l"),
    ],
)
def test_a_left_shoulder_is_what_is_around_it(
    names: tuple[str, ...], role: str
) -> None:
    arm = dict(zip(("clavicle", "upper_arm", "forearm", "hand"), names, strict=True))

    def rename(each: str) -> str:
        name = arm.get(base_role(each), each)
        return name.replace("Left", "Right") if each.endswith("_r") else name

    rig, _ = person(rename, fingers=False)
    found = dict(zip(rig.names, find_anatomy(rig).roles, strict=True))
    assert found["LeftShoulder"] == role
    assert found["RightShoulder"] == f"{base_role(role)}_r"


def test_the_page_of_unknown_presets_lists_all(root: Path) -> None:
    page = (root / "animtool/docs/rules/MAP003.md").read_text("utf-8")
    listed = page.partition("The presets are ")[2]
    assert re.findall(r"`(\w+)`", listed) == sorted(presets())


@pytest.mark.parametrize(("count", "known"), [(5, False), (6, True)])
def test_a_convention_is_known_by_six_of_its_names(count: int, known: bool) -> None:
    preset = presets()["mixamo"]
    texts: dict[str, str] = {}
    for text in sorted(preset.full_names):
        (name,) = parse_names([text], np.array([-1]))
        if name.name_key in preset.roles_by_key:
            texts.setdefault(name.name_key, text)
    chosen = list(texts.values())[:count]
    found = best_preset(chosen, parse_names(chosen, np.arange(count) - 1))
    assert (found is not None) == known
