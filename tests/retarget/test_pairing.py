"""Joints of one skeleton onto those of another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.people import named, person

from animtool.core.errors import Fault, FormatError, OptionError
from animtool.retarget import JointMap, map_joints, map_text
from animtool.retarget.file import load_map, resolve_map
from animtool.retarget.map_order import map_order_warnings
from animtool.retarget.pairing import (
    _bone_length,
    _chain_fractions,
    _nearest_index,
    _path_length,
)
from animtool.retarget.roles import Anatomy, RoleSource
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Joint, Rig


def pairs(found: JointMap, source: Rig, target: Rig) -> dict[str, str]:
    """Return the names of source joints by those of the target."""
    return {target.names[p.target]: source.names[p.source] for p in found.pairs}


def names_of(rig: Rig, joints: tuple[int, ...]) -> list[str]:
    return [rig.names[j] for j in joints]


def spined(count: int, prefix: str) -> Rig:
    """Return a person with a spine of some joints of equal length."""
    rig, _ = person(lambda role: role if "spine_" not in role else "", fingers=False)
    at = rig.index("spine")
    step = tuple(0.35 * x for x in (0.0, 1.0 / count, 0.0))
    spine = [
        Joint(f"{prefix}{i}", at + i - 1 if i else 0, translation=step)
        for i in range(count)
    ]
    rest = [
        replace(
            j,
            parent=j.parent + (count - 1) * (j.parent >= at),
            translation=step if j.name == "neck" else j.translation,
        )
        for j in rig.joints[at + 1 :]
    ]
    return replace(rig, joints=(*rig.joints[:at], *spine, *rest))


def test_mixamo_goes_onto_an_unreal_rig() -> None:
    source, ours = person(named("mixamo"))
    target, theirs = person(named("ue5_manny"), metacarpals=True)
    found = map_joints(source, target)
    assert (found.source.preset, found.target.preset) == ("mixamo", "ue5_manny")
    by_target = pairs(found, source, target)
    assert by_target["clavicle_l"] == "mixamorig:LeftShoulder"
    assert by_target["index_01_r"] == "mixamorig:RightHandIndex1"
    for name, role in theirs.items():
        if "_0_" in role:
            assert name in names_of(target, found.unmapped_target)
        else:
            assert ours[by_target[name]] == role
    assert found.unmapped_source == ()
    assert "hand_l" in {pair.role for pair in found.pairs}
    assert "index_0_l" not in {pair.role for pair in found.pairs}


def test_fingers_are_not_shifted_by_one() -> None:
    source, _ = person(named("perception_neuron"), metacarpals=True)
    target, _ = person(named("mixamo"))
    by_target = pairs(map_joints(source, target), source, target)
    for digit in ("Index", "Middle", "Ring", "Pinky"):
        for i in (1, 2, 3):
            name = f"LeftHand{digit}{i}"
            assert by_target[f"mixamorig:{name}"] == name


@pytest.mark.parametrize(("ours", "theirs"), [(1, 4), (2, 5), (3, 3), (5, 2), (7, 3)])
def test_chains_of_unequal_length_share_by_length(ours: int, theirs: int) -> None:
    source, target = spined(ours, "spine_a"), spined(theirs, "spine_b")
    found = map_joints(source, target)
    by_target = pairs(found, source, target)
    followed = [by_target[f"spine_b{i}"] for i in range(theirs)]
    assert followed[0] == "spine_a0"
    assert followed == sorted(followed)
    chain = next((c for c in found.chains if c.role == "spine"), None)
    assert (chain is None) == (ours == theirs == 1)
    if chain:
        assert chain.source_fractions == pytest.approx(np.arange(ours) / ours)
        for i, at in enumerate(chain.target_fractions):
            k = chain.source.index(source.index(followed[i]))
            if ours != theirs:
                gaps = np.abs(np.array(chain.source_fractions) - at)
                assert gaps[k] == pytest.approx(gaps.min())


def test_twist_joints_take_their_share() -> None:
    target, _ = person(named("ue5_manny"))
    arm = target.index("upperarm_l")
    extra = [
        Joint(f"upperarm_twist_0{i}_l", arm, translation=(0.28 * share, 0.0, 0.0))
        for i, share in ((1, 0.25), (2, 0.75))
    ]
    target = replace(target, joints=(*target.joints, *extra))
    source, _ = person()
    found = map_joints(source, target)
    shares = [(target.names[t.target], t.bone, t.fraction) for t in found.twists]
    assert shares == [
        ("upperarm_twist_01_l", arm, pytest.approx(0.25)),
        ("upperarm_twist_02_l", arm, pytest.approx(0.75)),
    ]
    assert found.unmapped_target == ()


def test_twist_joints_of_other_bones_have_no_share() -> None:
    """One on the spine, before those of arms; one that lies beyond the bone has all."""
    target, _ = person(named("ue5_manny"))
    spine, arm = target.index("spine_01"), target.index("lowerarm_r")
    length = float(np.linalg.norm(target.joints[target.index("hand_r")].translation))
    extra = [
        Joint("spine_twist_01", spine, translation=(0.0, 0.05, 0.0)),
        Joint("lowerarm_twist_01_r", arm, translation=(0.0, length / 5, 0.0)),
        Joint("lowerarm_twist_02_r", arm, translation=(1.5 * length, 0.0, 0.0)),
    ]
    target = replace(target, joints=(*target.joints, *extra))
    source, _ = person()
    found = map_joints(source, target)
    shares = [(target.names[t.target], t.bone, t.fraction) for t in found.twists]
    assert shares == [
        ("lowerarm_twist_01_r", arm, pytest.approx(0.2)),
        ("lowerarm_twist_02_r", arm, 1.0),
    ]


def test_a_written_map_says_roles_where_there_are_any() -> None:
    source, _ = person(named("mixamo"))
    target, _ = person()
    found = map_joints(source, target)
    pairs_of = tuple(
        replace(pair, role="") if i % 2 else pair for i, pair in enumerate(found.pairs)
    )
    text = map_text(replace(found, pairs=pairs_of), source, target)
    rows = [row for row in text.split("\n") if row.startswith("- {source: ")]
    with_roles = [row for row in rows if "role:" in row]
    chained = {j for chain in found.chains for j in chain.target[1:]}
    expected = [p for p in pairs_of if p.role and p.target not in chained]
    assert len(with_roles) == len(expected)
    assert all(f", role: {p.role}}}" in text for p in expected)


def test_renaming_pairs_one_to_one() -> None:
    source, target = spined(3, "spine_a"), spined(5, "spine_b")
    found = map_joints(source, target, mode="rename")
    assert not found.chains
    assert len({pair.source for pair in found.pairs}) == len(found.pairs)
    assert names_of(target, found.unmapped_target) == ["spine_b3", "spine_b4"]
    same = map_joints(target, target, mode="rename")
    assert all(pair.source == pair.target for pair in same.pairs)
    assert len(same.pairs) == len(target.joints)


def test_renaming_pairs_joints_without_a_role_by_their_names() -> None:
    rigs = []
    for name in ("prop_q", "prop_q", "prop_w"):
        rig, _ = person()
        tail = Joint(name, rig.index("hand_l"), translation=(0.0, 0.0, 0.7))
        rigs.append(replace(rig, joints=(*rig.joints, tail)))
    last = len(rigs[0].joints) - 1
    found = {pair.target: pair for pair in map_joints(*rigs[:2], mode="rename").pairs}
    pair = found[last]
    assert (pair.source, pair.role, pair.evidence) == (last, "", RoleSource.NAME)
    assert pair.confidence == 1.0
    other = map_joints(rigs[0], rigs[2], mode="rename")
    assert last in other.unmapped_target
    assert last in map_joints(*rigs[:2]).unmapped_target


def test_names_alone_leave_out_what_structure_knows() -> None:
    source, _ = person()
    target, _ = person(lambda role: "odd" if role == "shin_l" else role)
    by_name = map_joints(source, target, mode="names")
    assert names_of(target, by_name.unmapped_target) == ["odd"]
    whole = map_joints(source, target)
    pair = next(pair for pair in whole.pairs if pair.role == "shin_l")
    assert (pair.evidence, pair.confidence) == (RoleSource.STRUCTURE, 0.7)


def test_a_hand_in_a_mitten_moves_all_fingers() -> None:
    keep = {"index_1", "index_2", "thumb_1"}
    digits = ("index", "middle", "ring", "pinky", "thumb")
    mitten, _ = person(
        lambda role: (
            ""
            if role.startswith(digits) and role[:-2] not in keep
            else role.replace("index_1", "fingers").replace("index_2", "fingers2")
        )
    )
    target, _ = person()
    found = pairs(map_joints(mitten, target), mitten, target)
    assert {found[f"{digit}_1_l"] for digit in digits[:4]} == {"fingers_l"}
    assert "middle_2_l" not in found
    back = pairs(map_joints(target, mitten), target, mitten)
    assert back["fingers_r"] == "middle_1_r"


def named_chain(name: str, count: int, length: float, parents: int = 1) -> Rig:
    """Return a chain of joints, or all below the first, that is no body."""
    step = (0.0, 0.0, length)
    joints = [Joint("part_0", -1)]
    for i in range(1, count):
        parent = i - 1 if parents else 0
        joints.append(Joint(f"part_{i}", parent, translation=step))
    return Rig(name, tuple(joints))


@pytest.mark.parametrize("parents", [0, 1])
def test_equal_names_pair_where_no_body_is_known(parents: int) -> None:
    source = named_chain("snake", 6, 0.1, parents)
    target = named_chain("worm", 4, 0.13, parents)
    for mode in ("auto", "names"):
        found = map_joints(source, target, mode=mode)  # type: ignore[arg-type]
        assert [(p.source, p.target) for p in found.pairs] == [(i, i) for i in range(4)]
        assert found.unmapped_source == (4, 5)
        assert found.notices == ()
    with pytest.raises(OptionError):
        map_joints(source, target, mode="structure")


def test_a_joint_of_a_known_name_does_not_hide_the_others() -> None:
    lamps = [
        Rig(
            "lamp",
            tuple(
                Joint(name, i - 1, translation=(0.0, size, 0.0))
                for i, name in enumerate(("base", "lower", "upper", "head"))
            ),
        )
        for size in (0.2, 0.3)
    ]
    found = map_joints(*lamps)
    assert {(p.source, p.target) for p in found.pairs} == {(i, i) for i in range(4)}
    assert found.notices == ()


def test_nothing_in_common_is_refused() -> None:
    source, _ = person()
    crane = Rig("crane", (Joint("base", -1), Joint("jib", 0, translation=(1, 0, 0))))
    with pytest.raises(OptionError) as caught:
        map_joints(source, crane)
    assert caught.value.code == "MAP004"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "one.map.yaml"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("preset", ["mixamo", "ue5_manny", "max_biped", "mmd"])
def test_a_written_map_reads_back(tmp_path: Path, preset: str) -> None:
    source, _ = person(named(preset))
    source = replace(source, name="a take\nb: 1")
    target, _ = person(metacarpals=True)
    found = map_joints(source, target)
    path = written(tmp_path, map_text(found, source, target))
    again = map_joints(source, target, map_file=path)
    bare = [(pair.source, pair.target, pair.role) for pair in found.pairs]
    assert [(pair.source, pair.target, pair.role) for pair in again.pairs] == bare
    assert sorted(again.chains, key=str) == sorted(found.chains, key=str)
    assert again.unmapped_target == found.unmapped_target
    assert {pair.evidence for pair in again.pairs} == {RoleSource.FILE}


def test_a_map_goes_before_names(tmp_path: Path) -> None:
    source, _ = person(named("mixamo"))
    target, _ = person()
    text = (
        "map: animtool/1\njoints:\n- {source: RightHand, target: hand_l}\n"
        "others: auto\nignored: {source: [Head], target: [neck]}\n"
    )
    found = map_joints(source, target, map_file=written(tmp_path, text))
    by_target = pairs(found, source, target)
    assert by_target["hand_l"] == by_target["hand_r"] == "mixamorig:RightHand"
    assert {"head", "neck"}.isdisjoint(by_target)
    assert by_target["foot_l"] == "mixamorig:LeftFoot"
    only = text.replace("others: auto\n", "")
    found = map_joints(source, target, map_file=written(tmp_path, only))
    assert list(pairs(found, source, target)) == ["hand_l"]


def test_a_map_does_for_other_prefixes(tmp_path: Path) -> None:
    source, _ = person(lambda role: named("mixamo")(role).replace("rig:", "rig7:"))
    target, _ = person()
    text = "map: animtool/1\njoints: [{source: 'mixamorig7:Hips', target: hips}]\n"
    for one in (text, text.replace("mixamorig7:", "")):
        found = map_joints(source, target, map_file=written(tmp_path, one))
        assert pairs(found, source, target) == {"hips": "mixamorig7:Hips"}


@pytest.mark.parametrize(
    ("line", "code", "place", "hint"),
    [
        ("{source: Hipps, target: hips}", "MAP001", (3, 12), "'Hips'"),
        (
            "{source: Hips, target: [hips, chin]}",
            "MAP001",
            (3, 33),
            "allowed: shin_l,",
        ),
        (
            "{source: Hips, target: 'other:hips'}",
            "MAP001",
            (3, 26),
            "leave out the namespace 'other:': write 'hips'",
        ),
        ("{source: Hips, target: [hips, hips]}", "MAP002", (3, 33), "remove one"),
        ("{source: Hips, target: hips, role: hip}", "MAP005", (3, 38), "'hips'"),
        ("{source: Hips, target: []}", "DOC022", (3, 26), ""),
        ("{sauce: Hips, target: hips}", "DOC020", (3, 4), "'source'"),
        ("", "DOC022", (2, 9), "write joints: [{source: Hips, target: hips}]"),
        ("{Hips: hips}", "DOC020", (3, 4), "write {source: Hips, target: hips}"),
    ],
)
def test_a_wrong_map_is_refused_with_its_place(
    tmp_path: Path, line: str, code: str, place: tuple[int, int], hint: str
) -> None:
    source, _ = person(named("mixamo"))
    target, _ = person()
    joints = f"\n- {line}" if line else " {Hips: hips}"
    path = written(tmp_path, f"map: animtool/1\njoints:{joints}\n")
    with pytest.raises(FormatError) as caught:
        map_joints(source, target, map_file=path)
    fault = caught.value.faults[0]
    assert (fault.code, (fault.lines[0], fault.column)) == (code, place)
    assert hint in (fault.hint or "")


def test_places_along_a_chain_are_shares_of_its_length() -> None:
    """Bones of 5, 2 and 3 m; one between of 1 m is on the way."""
    joints = (
        Joint("a", -1),
        Joint("b", 0, translation=(3.0, 4.0, 0.0)),
        Joint("between", 1, translation=(0.0, 0.0, 1.0)),
        Joint("c", 2, translation=(1.0, 0.0, 0.0)),
        Joint("end", 3, translation=(0.0, 3.0, 0.0)),
    )
    rig = Rig("chain", joints)
    assert _path_length(rig, 0, 3) == pytest.approx(7)
    assert _path_length(rig, 1, 3) == pytest.approx(2)
    assert _path_length(rig, 3, 1) == pytest.approx(5)
    none = (RoleSource.NONE,) * 5
    known = Anatomy(("spine", "spine", "", "spine", ""), none, (1.0,) * 5)
    assert _bone_length(rig, known, 3) == pytest.approx(3)
    assert _bone_length(rig, known, 4) == 0
    assert _chain_fractions(rig, known, [0, 1, 3]) == pytest.approx([0, 0.5, 0.7])
    headed = Anatomy(("spine", "spine", "", "neck", "head"), none, (1.0,) * 5)
    assert _bone_length(rig, headed, 1) == pytest.approx(2)
    assert _chain_fractions(rig, known, [4]) == [0]
    assert _nearest_index([0.0, 0.5, 0.7], 0.59) == 1
    assert _nearest_index([0.0, 0.5, 0.7], 0.61) == 2


@pytest.mark.parametrize(("height", "codes"), [(0.0, ["MAP109"]), (0.7, [])])
def test_a_biped_onto_four_legs(height: float, codes: list[str]) -> None:
    source, _ = person(named("mixamo"), fingers=False)
    rig, _ = person(lambda role: role, fingers=False)
    positions = rest_world(rig).positions[0]
    joints = list(rig.joints)
    for side in "lr":
        hand = rig.index(f"hand_{side}")
        drop = (height - positions[hand][1]) / 2
        for name in (f"forearm_{side}", f"hand_{side}"):
            j = rig.index(name)
            x, y, z = joints[j].translation
            joints[j] = replace(joints[j], translation=(x, y + drop, z))
    joint_map = map_joints(source, replace(rig, joints=tuple(joints)))
    found = [n.code for n in joint_map.notices if n.code == "MAP109"]
    assert found == codes


@pytest.mark.parametrize(
    ("lines", "place", "hint"),
    [
        # Copied from the left, with the target or with the whole entry but its role.
        (("LeftArm, upper_arm_l", "RightArm, upper_arm_l"), (4, 30), "upper_arm_r"),
        (("RightArm, upper_arm_r", "LeftArm, upper_arm_r"), (4, 29), "upper_arm_l"),
        (("LeftArm, upper_arm_r", "RightArm, upper_arm_r"), (3, 29), "upper_arm_l"),
        # The joint of the other side is in use, or no side tells which is wrong.
        (
            ("LeftArm, upper_arm_l", "Head, upper_arm_r", "RightArm, upper_arm_l"),
            (5, 30),
            "follows 'RightArm'",
        ),
        (("Spine, spine", "Spine1, spine"), (4, 28), "follows 'Spine1'"),
        (("Spine, spine", "Spine, spine"), (4, 27), "remove one of the two entries"),
    ],
)
def test_a_copied_target_names_the_likely_joint(
    tmp_path: Path, lines: tuple[str, ...], place: tuple[int, int], hint: str
) -> None:
    rows = [line.split(", ") for line in lines]
    entries = "".join(f"- {{source: {s}, target: {t}}}\n" for s, t in rows)
    path = written(tmp_path, f"map: animtool/1\njoints:\n{entries}")
    with pytest.raises(FormatError) as caught:
        load_map(path)
    (fault,) = caught.value.faults
    assert (fault.code, (fault.lines[0], fault.column)) == ("MAP002", place)
    assert hint in (fault.hint or "")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        (
            "twists: [{joint: a, bone: b, share: 1}, {joint: a, bone: c, share: 1}]",
            "twists[1].joint",
        ),
        ("ignored: {target: [head, hips]}", "ignored.target[1]"),
        ("ignored: {source: [Hips]}", "ignored.source[0]"),
    ],
)
def test_a_joint_in_two_parts_of_a_map_is_refused(
    tmp_path: Path, text: str, where: str
) -> None:
    joints = "joints: [{source: Hips, target: hips}]"
    path = written(tmp_path, f"map: animtool/1\n{joints}\n{text}\n")
    with pytest.raises(FormatError) as caught:
        load_map(path)
    assert [(f.code, f.where) for f in caught.value.faults] == [("MAP002", where)]


def test_a_joint_by_two_names_is_refused(tmp_path: Path) -> None:
    source, _ = person(named("mixamo"))
    target, _ = person(lambda role: f"hero:{role}")
    joints = "- {source: Hips, target: 'hero:hips'}\n- {source: Spine, target: hips}\n"
    path = written(tmp_path, f"map: animtool/1\njoints:\n{joints}")
    with pytest.raises(FormatError) as caught:
        map_joints(source, target, map_file=path)
    where = [(f.code, f.where) for f in caught.value.faults]
    assert where == [("MAP002", "joints[1].target")]


def test_a_copied_source_names_the_joint_that_is_left_out(tmp_path: Path) -> None:
    source, _ = person(named("mixamo"))
    target, _ = person()
    joints = "- {source: LeftArm, target: upper_arm_l}\n"
    joints += "- {source: LeftArm, target: upper_arm_r}\n"
    path = written(tmp_path, f"map: animtool/1\njoints:\n{joints}")
    (found,) = (
        fault
        for fault in map_joints(source, target, map_file=path).notices
        if fault.code == "MAP108"
    )
    assert "write mixamorig:RightArm in place of" in (found.hint or "")


@pytest.mark.parametrize(
    ("joints", "found"),
    [({"LeftArm": "thigh_l"}, 1), ({"LeftUpLeg": "hand_r", "Head": "head"}, 1),
     ({"LeftArm": "upper_arm_l", "LeftUpLeg": "thigh_l"}, 0)],
)  # fmt: skip
def test_arms_that_follow_legs_are_named(
    tmp_path: Path, joints: dict[str, str], found: int
) -> None:
    rigs = person(named("mixamo"))[0], person()[0]
    entries = (f"{{source: {one}, target: {two}}}" for one, two in joints.items())
    path = written(tmp_path, f"map: animtool/1\njoints: [{', '.join(entries)}]\n")
    codes = [notice.code for notice in map_joints(*rigs, map_file=path).notices]
    assert codes.count("MAP114") == found


@pytest.mark.parametrize(
    ("preset", "found"), [("mixamo", False), ("smpl", True), ("openpose_body25", True)]
)
def test_presets_of_other_names_are_warned_of(preset: str, found: bool) -> None:
    rigs = person(named("mixamo"))[0], person()[0]
    notices = map_joints(*rigs, preset=preset).notices
    assert ("MAP113" in [notice.code for notice in notices]) == found
    hints = [notice.hint for notice in notices if notice.code == "MAP113"]
    assert (
        hints == [f"write mixamo in place of {preset}, or leave the preset out"] * found
    )


@pytest.mark.parametrize(
    ("entries", "where"),
    [
        ("{source: [B, A], target: [a, b]}", ["joints[0].source"]),
        ("{source: [A, B], target: [c, a]}", ["joints[0].target"]),
        ("{source: A, target: b}, {source: B, target: a}", ["joints[1].source"]),
        ("{source: [A, B], target: [a, b]}, {source: C, target: c}", []),
        ("{source: A, target: a}, {source: A, target: b}", []),
        ("{source: [A, B, D], target: [a, d, b]}, {source: C, target: c}", []),
        ("{source: B, target: b}, {source: A, target: a}", []),
    ],
)
def test_joints_of_a_map_against_the_hierarchy_are_named(
    tmp_path: Path, entries: str, where: list[str]
) -> None:
    parents = {"a": -1, "b": 0, "c": 1, "d": 0}
    joints = [
        Joint(name, parent, translation=(0.0, 1.0, 0.0))
        for name, parent in parents.items()
    ]
    others = [replace(joint, name=joint.name.upper()) for joint in joints]
    path = written(tmp_path, f"map: animtool/1\njoints: [{entries}]\n")
    rigs = Rig("take", tuple(others)), Rig("hero", tuple(joints))
    notices = map_joints(*rigs, map_file=path).notices
    found = [notice for notice in notices if notice.code == "MAP112"]
    assert [notice.where for notice in found] == where
    assert all(notice.lines == (2,) for notice in found)


def chain_map(folder: Path, count: int, order: int) -> list[Fault]:
    """Return MAP112 of a map from a chain of joints to another, in order or against."""
    joints = [Joint(f"j{i}", i - 1, translation=(0.0, 1.0, 0.0)) for i in range(count)]
    others = [replace(joint, name=joint.name.upper()) for joint in joints]
    targets = list(range(count))[::order]
    entries = (f"{{source: J{i}, target: j{k}}}" for i, k in enumerate(targets))
    path = written(folder, f"map: animtool/1\njoints: [{', '.join(entries)}]\n")
    rigs = Rig("take", tuple(others)), Rig("hero", tuple(joints))
    notices = map_joints(*rigs, map_file=path).notices
    return [notice for notice in notices if notice.code == "MAP112"]


def test_entries_against_a_chain_are_paired_once(tmp_path: Path) -> None:
    found = chain_map(tmp_path, 9, -1)
    hints = [
        f"exchange the sources of joints[{i}] and joints[{8 - i}]" for i in range(4)
    ]
    assert [notice.hint for notice in found] == hints
    assert chain_map(tmp_path, 9, 1) == []


def test_the_order_of_a_map_is_checked_in_time_that_grows_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0
    upwards = Rig.upwards

    def counted(rig: Rig, joint: int) -> list[int]:
        nonlocal calls
        calls += 1
        return upwards(rig, joint)

    counts = []
    for count in (20, 40, 80):
        joints = [Joint("a", -1), *(Joint(f"b{i}", 0) for i in range(count))]
        rig = Rig("hero", tuple(joints))
        entries = (f"{{source: b{i}, target: b{i}}}" for i in range(count))
        path = written(tmp_path, f"map: animtool/1\njoints: [{', '.join(entries)}]\n")
        file = load_map(path)
        file_map = resolve_map(file, rig, rig)
        calls = 0
        with monkeypatch.context() as patch:
            patch.setattr(Rig, "upwards", counted)
            assert list(map_order_warnings(file, file_map, rig, rig)) == []
        counts.append(calls)
    assert counts[0] > 0
    assert counts[1] <= 2.1 * counts[0]
    assert counts[2] <= 2.1 * counts[1]


SHIFTED = {"LeftUpLeg": "shin_l", "LeftLeg": "foot_l", "LeftFoot": "toe_l"}


@pytest.mark.parametrize(
    ("joints", "others", "found"),
    [
        (SHIFTED, "auto", 1),
        (SHIFTED, "none", 1),
        ({"LeftArm": "forearm_l", "LeftForeArm": "hand_l"}, "none", 1),
        ({"LeftUpLeg": "thigh_l", "LeftLeg": "shin_l"}, "auto", 0),
        ({"LeftUpLeg": "thigh_l"}, "none", 0),
    ],
)
def test_limbs_that_are_shifted_by_a_joint_are_named(
    tmp_path: Path, joints: dict[str, str], others: str, found: int
) -> None:
    rigs = person(named("mixamo"))[0], person()[0]
    entries = "".join(
        f"- {{source: {one}, target: {two}}}\n" for one, two in joints.items()
    )
    text = f"map: animtool/1\njoints:\n{entries}others: {others}\n"
    notices = map_joints(*rigs, map_file=written(tmp_path, text)).notices
    shifts = [notice for notice in notices if notice.code == "MAP115"]
    assert [(one.lines, one.where) for one in shifts] == [((3,), "joints[0]")] * found
    upper = "thigh_l" if "LeftUpLeg" in joints else "upper_arm_l"
    assert all(f"to {upper}," in str(one.hint) for one in shifts)


def test_crossed_sides_have_the_line_of_their_entry(tmp_path: Path) -> None:
    rigs = person(named("mixamo"))[0], person()[0]
    text = "map: animtool/1\njoints:\n- {source: Hips, target: hips}\n"
    text += "- {source: LeftArm, target: upper_arm_r}\n"
    notices = map_joints(*rigs, map_file=written(tmp_path, text)).notices
    (fault,) = (notice for notice in notices if notice.code == "MAP108")
    assert (fault.lines, fault.where) == ((4,), "joints[1]")


def test_unmapped_joints_of_limbs_come_first(tmp_path: Path) -> None:
    rigs = person(named("mixamo"))[0], person()[0]
    text = "map: animtool/1\njoints:\n- {source: Hips, target: hips}\n"
    unmapped = map_joints(*rigs, map_file=written(tmp_path, text)).unmapped_target
    names = names_of(rigs[1], unmapped)
    assert max(names.index(name) for name in ("thigh_l", "hand_r")) < min(
        i for i, name in enumerate(names) if name.startswith(("index", "spine", "head"))
    )
