"""The anatomy of skeletons whose names say little, nothing, or not enough."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.full_rigs import FULL_RIGS, full_rig
from support.people import named, person
from support.suite import some_quick

from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.retarget import map_joints
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.roles import (
    CONTROL,
    END,
    FINGER_ROLES,
    ROLES,
    TWIST,
    RoleSource,
)
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig


def nameless(rig: Rig, seed: int = 3) -> Rig:
    """Return a rig with other names."""
    order = np.random.default_rng(seed).permutation(len(rig.joints))
    joints = [
        replace(joint, name=f"x{i}") for i, joint in zip(order, rig.joints, strict=True)
    ]
    return replace(rig, joints=tuple(joints))


def known(rig: Rig, true: Rig, roles: dict[str, str]) -> float:
    """Return the share of joints whose role is right."""
    found = find_anatomy(rig).roles
    right = [roles[name] for name in true.names]
    return float(np.mean([a == b for a, b in zip(found, right, strict=True)]))


def turned(rig: Rig) -> Rig:
    """Return a rig with Z up."""
    joints = [
        replace(
            joint,
            translation=(
                joint.translation[0],
                -joint.translation[2],
                joint.translation[1],
            ),
        )
        for joint in rig.joints
    ]
    return replace(rig, joints=tuple(joints), up=UpAxis.Z)


@pytest.mark.parametrize("fingers", [False, True])
@pytest.mark.parametrize("metacarpals", [False, True])
@pytest.mark.parametrize("change", [replace, turned], ids=["Y up", "Z up"])
def test_a_person_is_known_without_names(
    fingers: bool, metacarpals: bool, change: Callable[[Rig], Rig]
) -> None:
    rig, roles = person(fingers=fingers, metacarpals=metacarpals)
    assert known(nameless(change(rig)), rig, roles) == 1.0


def test_a_role_is_as_sure_as_what_it_was_found_by() -> None:
    """Names of a convention, other names, where a joint is, and no role at all."""
    names = named("mixamo")
    odd = {"shin_l": "odd"}
    rig, _ = person(lambda role: odd.get(role, names(role)))
    found = find_anatomy(rig)
    pairs = zip(found.evidence, found.confidence, strict=True)
    sure = dict(zip(rig.names, pairs, strict=True))
    assert sure["mixamorig:LeftArm"] == (RoleSource.PRESET, 1.0)
    assert sure["odd"] == (RoleSource.STRUCTURE, 0.7)
    plain, _ = person()
    found = find_anatomy(plain)
    by_name = set(zip(found.evidence, found.confidence, strict=True))
    assert by_name == {(RoleSource.PRESET, 1.0), (RoleSource.NAME, 0.9)}
    tail = replace(rig.joints[0], name="prop", parent=0, translation=(0.0, 0.0, -0.3))
    tailed = find_anatomy(replace(rig, joints=(*rig.joints, tail)))
    assert (tailed.evidence[-1], tailed.confidence[-1]) == (RoleSource.NONE, 0.0)


@pytest.mark.parametrize("left_out", ["clavicle", "toe", "neck", "spine_2", "thumb_3"])
def test_a_person_without_some_joints_is_known(left_out: str) -> None:
    rig, roles = person(lambda role: "" if role.startswith(left_out) else role)
    assert known(nameless(rig), rig, roles) >= 0.95


def with_bones(rig: Rig, below: str, count: int, kind: str) -> tuple[Rig, list[str]]:
    """Return a rig with more joints within a bone, in its chain or beside it."""
    index = rig.index(below)
    above = rig.joints[index].parent
    step = tuple(x / (count + 1) for x in rig.joints[index].translation)
    joints = list(rig.joints)
    names = [f"{kind}_{i}_{below}" for i in range(count)]
    extra = []
    for i, name in enumerate(names):
        if kind == "bone":
            extra.append(Joint(name, index + i - 1 if i else above, translation=step))
        else:
            moved = tuple((i + 1) * x for x in step)
            extra.append(Joint(name, above, translation=moved))
    last = joints[index]
    if kind == "bone":
        last = replace(last, parent=index + count - 1, translation=step)
    tail = [
        replace(joint, parent=joint.parent + count * (joint.parent >= index))
        for joint in joints[index + 1 :]
    ]
    return replace(rig, joints=(*joints[:index], *extra, last, *tail)), names


@pytest.mark.parametrize("by_names", [True, False])
@pytest.mark.parametrize("below", ["forearm", "hand", "shin", "foot"])
def test_extra_bones_are_of_the_bone_they_are_in(below: str, by_names: bool) -> None:
    rig, roles = person()
    before = {
        "forearm": "upper_arm",
        "hand": "forearm",
        "shin": "thigh",
        "foot": "shin",
    }
    for side in "lr":
        rig, names = with_bones(rig, f"{below}_{side}", 2, "bone")
        roles |= dict.fromkeys(names, f"{before[below]}_{side}")
    changed = rig if by_names else nameless(rig)
    assert known(changed, rig, roles) == 1.0


def test_twist_joints_are_no_fingers_and_no_bones() -> None:
    rig, roles = person()
    for side in "lr":
        for below in ("forearm", "hand"):
            rig, names = with_bones(rig, f"{below}_{side}", 2, "twist")
            roles |= dict.fromkeys(names, TWIST)
    assert known(rig, rig, roles) == 1.0
    found = find_anatomy(nameless(rig)).roles
    wrong = [
        (name, role)
        for name, role in zip(rig.names, found, strict=True)
        if roles[name] != TWIST and role != roles[name]
    ]
    assert wrong == []


@pytest.mark.parametrize("preset", FULL_RIGS)
def test_whole_rigs_are_known_with_what_is_none_of_a_body(preset: str) -> None:
    rig, roles = full_rig(*FULL_RIGS[preset])
    found = find_anatomy(rig)
    wrong = [
        (name, role, right)
        for name, role, right in zip(rig.names, found.roles, roles, strict=True)
        if role != right
    ]
    assert wrong == []
    assert found.preset == preset


@pytest.mark.parametrize("source", some_quick(FULL_RIGS, 4))
def test_any_convention_goes_onto_any_other(source: str) -> None:
    rig, ours = full_rig(*FULL_RIGS[source])
    for target in FULL_RIGS:
        other, theirs = full_rig(*FULL_RIGS[target])
        found = map_joints(rig, other)
        pairs = {(ours[pair.source], theirs[pair.target]) for pair in found.pairs}
        mitten = {pair for pair in pairs if "fingers" in pair[0] + pair[1]}
        assert all(a == b for a, b in pairs - mitten)
        shared = set(ours) & set(theirs) & set(ROLES)
        assert {role for role, _ in pairs - mitten} >= {
            role for role in shared if not role.startswith("fingers")
        }


def test_a_rest_pose_that_is_none_needs_a_pose() -> None:
    rig, roles = person()
    rest = forward_kinematics(
        rig, rig.rest_translations[None], rig.rest_rotations[None]
    )
    lengths = np.linalg.norm(rig.rest_translations, axis=1)
    joints = [
        replace(joint, translation=(float(length), 0.0, 0.0))
        for joint, length in zip(rig.joints, lengths, strict=True)
    ]
    along_x = nameless(replace(rig, joints=tuple(joints)))
    blind = find_anatomy(along_x)
    assert [fault.code for fault in blind.notices] == ["MAP105"]
    seen = find_anatomy(along_x, positions=rest.positions[0])
    assert list(seen.roles) == [roles[name] for name in rig.names]
    assert seen.notices == ()
    assert set(seen.evidence) == {RoleSource.STRUCTURE}


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ({"thigh", "shin", "foot", "toe"}, "no legs"),
        ({"foot", "toe"}, "no whole legs"),
        ({"thigh_l", "shin_l", "foot_l", "toe_l"}, "no whole left leg"),
    ],
)
def test_legs_that_are_missing_are_said(missing: set[str], said: str) -> None:
    rig, roles = person(lambda role: "" if {role, role[:-2]} & missing else role)
    found = find_anatomy(rig)
    assert [fault.code for fault in found.notices] == ["MAP101"]
    assert said in found.notices[0].message
    assert list(found.roles) == [roles[name] for name in rig.names]


def test_a_skeleton_without_offsets_is_known_by_its_names() -> None:
    rig, roles = person(named("mixamo"))
    joints = [replace(joint, translation=(0.0, 0.0, 0.0)) for joint in rig.joints]
    flat = replace(rig, joints=tuple(joints))
    found = find_anatomy(flat)
    assert [fault.code for fault in found.notices] == ["MAP102"]
    assert list(found.roles) == [roles[name] for name in rig.names]


@pytest.mark.parametrize("rooted", [False, True])
def test_the_larger_of_two_skeletons_is_taken(rooted: bool) -> None:
    rig, roles = person(lambda role: f"a:{role}")
    small, _ = person(lambda role: f"b:{role}", fingers=False)
    joints = [Joint("world", -1)] if rooted else []
    for one in (rig, small):
        begin = len(joints)
        joints += [
            replace(j, parent=j.parent + begin if j.parent >= 0 else rooted - 1)
            for j in one.joints
        ]
    both = replace(rig, joints=tuple(joints))
    found = find_anatomy(both)
    assert [fault.code for fault in found.notices] == ["MAP103"]
    assert "'b:hips'" in found.notices[0].message
    begin, end = int(rooted), len(rig.joints) + rooted
    assert list(found.roles[begin:end]) == [roles[name] for name in rig.names]
    assert set(found.roles[end:]) == {CONTROL}


def test_a_hand_without_an_end_is_said() -> None:
    rig, _ = person(fingers=False)
    found = find_anatomy(rig)
    assert [fault.code for fault in found.notices] == ["MAP104"]
    assert "hand_l" in found.notices[0].message


def test_ends_and_controls_have_no_role() -> None:
    rig, roles = person()
    extra = [
        Joint("head_end", rig.index("head"), translation=(0.0, 0.2, 0.0)),
        Joint("index_4_l", rig.index("index_3_l"), translation=(0.02, 0.0, 0.0)),
        Joint("ik_hand_l", 0, translation=(0.7, 0.4, 0.0)),
        Joint("tail", 0, translation=(0.0, 0.0, -0.2)),
    ]
    rig = replace(rig, joints=(*rig.joints, *extra))
    roles |= {"head_end": END, "index_4_l": END, "ik_hand_l": CONTROL, "tail": ""}
    assert known(rig, rig, roles) == 1.0


WORDS = [
    *("Hips", "Spine", "Neck", "Head", "LeftArm", "RightArm", "LeftUpLeg", "RightLeg"),
    *("LeftHand", "RightHandIndex1", "LeftFoot", "thumb_l", "root", "x", "__a", "end"),
    *("ik_hand", "LeftToe", "RightShoulder", "twist_l"),
]
PERSON, _ = person(fingers=False)
LENGTHS = st.sampled_from([0.0, 0.01, 0.1, 0.1, 0.4, -0.4])


@given(
    st.lists(
        st.tuples(
            st.integers(0, 40), st.sampled_from(WORDS), LENGTHS, LENGTHS, st.booleans()
        ),
        max_size=24,
    ),
    st.booleans(),
)
def test_any_tree_has_roles_and_any_two_map_or_are_refused(
    tree: list[tuple[int, str, float, float, bool]], by_names: bool
) -> None:
    joints = []
    for i, (parent, word, x, y, tip) in enumerate(tree):
        tips = ((0.0, y, 0.0),) if tip else ()
        name, above = f"{word}.{i:03}", parent % (i + 1) - 1
        joints.append(Joint(name, above, translation=(x, y, 0.0), tips=tips))
    rig = Rig("any", tuple(joints))
    found = find_anatomy(rig, uses_names=by_names)
    assert set(found.roles) <= {*ROLES, TWIST, END, CONTROL, ""}
    singles = ["hips", "head", *(f"{role}_{s}" for role in FINGER_ROLES for s in "lr")]
    assert all(found.roles.count(role) <= 1 for role in singles)
    with suppress(OptionError):
        map_joints(rig, PERSON)
        map_joints(PERSON, rig)


def test_nobody_is_no_error() -> None:
    assert find_anatomy(Rig("empty", ())).roles == ()
    found = find_anatomy(Rig("one", (Joint("a", -1),)))
    assert found.roles == ("",)
