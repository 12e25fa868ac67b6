"""Takes as they arrive: what is said about them, and what is done instead."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises
from support.people import person

from animtool import Channel, Motion, Rig, Take, open_source
from animtool.core.clock import Clock
from animtool.core.errors import OptionError, Severity
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import TakeStream
from animtool.retarget import map_joints, retarget_take
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.options import RetargetOptions
from animtool.retarget.take_pass import (
    RetargetPassOptions,
    _body_joints,
    _complete_limbs,
    _size_warnings,
    checked_blocks,
    insufficient_pairs_fault,
    retarget_stream,
)
from animtool.retarget.verdict import TakeStatus
from animtool.rig.kinematics import forward_kinematics


def turned(take: Take, turn: np.ndarray) -> Take:
    """Return a take whose motion is turned, and its rest pose is not."""
    places, turns = take.motion.translations.dense(), take.motion.rotations.dense()
    places[:, 0] = so3.rotate(turn, places[:, 0])
    turns[:, 0] = so3.multiply(turn, turns[:, 0])
    channels = Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    return replace(take, motion=Motion(*channels))


def test_a_take_that_stands_along_z_in_a_file_that_does_not_say_so(root: Path) -> None:
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    biped = Rig.load(root / "rigs/biped/biped.rig.yaml")
    tall = turned(walk, np.array(up_from_up(UpAxis.Z, UpAxis.Y)))
    places = []
    for take, codes in ((walk, []), (tall, ["MAP009"])):
        made, _, notices = retarget_stream(
            TakeStream.of(take), biped, RetargetOptions()
        )
        assert [n.code for n in notices if n.code == "MAP009"] == codes
        stream = TakeStream.of(take)
        stream.details["format"] = "USD"
        notices = retarget_stream(stream, biped, RetargetOptions())[2]
        hints = [str(n.hint) for n in notices if n.code == "MAP009"]
        assert ["upAxis" in hint for hint in hints] == [True] * len(codes)
        motion = Motion.concatenate(list(made.blocks()))
        places.append(forward_kinematics(biped, *motion.dense()).positions)
        assert made.report().sole_error < 1e-6
    # Its rest pose lies then, and faces the target as a whole, with how it leans.
    assert_allclose(places[1], places[0], atol=0.02)


def test_offsets_that_are_not_the_rest_pose(root: Path) -> None:
    """Arms that hang in the offsets, of a take whose zero pose is that of the rig."""
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    down = {"LeftForeArm": (0.0, -0.3, 0.0), "RightForeArm": (0.0, -0.3, 0.0)}
    joints = tuple(
        replace(joint, translation=down.get(joint.name, joint.translation))
        for joint in walk.rig.joints
    )
    take = replace(walk, rig=replace(walk.rig, joints=joints))
    turns = {}
    for rest in (None, "rig"):
        options = RetargetOptions(rest=rest)  # type: ignore[arg-type]
        made, _, _ = retarget_stream(TakeStream.of(take), walk.rig, options)
        turns[rest] = Motion.concatenate(list(made.blocks())).rotations.dense()
    arm = walk.rig.index("LeftArm")
    source = walk.motion.rotations.dense()
    off = so3.angle_between(turns["rig"], source)
    assert off.max() < 1e-7
    assert so3.angle_between(turns[None], source)[:, arm].min() > 1


@pytest.mark.parametrize("key", ["preset", "target_preset"])
def test_a_convention_of_either_skeleton_can_be_said(root: Path, key: str) -> None:
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    with raises(OptionError, "MAP003"):
        retarget_stream(
            TakeStream.of(walk), walk.rig, RetargetOptions(**{key: "mixamoo"})
        )


@pytest.mark.parametrize(("frames", "codes"), [(2, ["MAP007"]), (40, [])])
def test_a_take_in_which_no_foot_stands_says_so(
    root: Path, frames: int, codes: list[str]
) -> None:
    """As of two frames, whose speeds nobody knows; by the pass, too."""
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    clock = replace(walk.clock, count=frames)
    short = replace(walk, clock=clock, motion=walk.motion.select(slice(frames)))
    biped = Rig.load(root / "rigs/biped/biped.rig.yaml")
    _, _, notices = retarget_stream(TakeStream.of(short), biped, RetargetOptions())
    assert [n.code for n in notices if n.code == "MAP007"] == codes
    context = PassContext(open_source, root)
    options = RetargetPassOptions(rig=str(root / "rigs/biped/biped.rig.yaml"))
    apply_pass(TakeStream.of(short), find_pass("retarget"), options, context).collect()
    assert [n.code for n in context.notices if n.code == "MAP007"] == codes


def test_frames_a_second_are_those_that_the_take_has(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every other frame of 30 a second are 15."""

    class Stop(Exception):  # noqa: N818
        pass

    def stop(*given: Any, **_: Any) -> None:
        raise Stop(*given[3:])

    monkeypatch.setattr("animtool.retarget.take_pass.Retargeting", stop)
    take = open_source(root / "samples/walk/walk.bvh").collect()
    slow = replace(take, clock=replace(take.clock, step=Fraction(2)))
    with pytest.raises(Stop) as caught:
        retarget_stream(TakeStream.of(slow), take.rig, RetargetOptions())
    assert caught.value.args == (float(take.clock.fps) / 2,)


def test_a_body_is_without_fingers_and_what_hangs_on_hands() -> None:
    """Of a person the trunk and four limbs; what no role is on a hand is no body."""
    rig, _ = person()
    held = replace(
        rig.joints[0], name="sword", parent=rig.index("hand_l"), translation=(0, 0, 1.0)
    )
    rig = replace(rig, joints=(*rig.joints, held))
    found = [rig.names[j] for j in _body_joints(rig, find_anatomy(rig).roles)]
    sides = ("clavicle", "upper_arm", "forearm", "hand", "thigh", "shin", "foot")
    trunk = ("hips", "spine", "spine_2", "spine_3", "neck", "head")
    assert {*found} == {*trunk, *(f"{bone}_{side}" for bone in sides for side in "lr")}
    roles = find_anatomy(rig).roles
    limbs = _complete_limbs(roles)
    assert list(limbs) == ["left arm", "right arm", "left leg", "right leg"]
    names = [[rig.names[j] for j in own] for own in limbs.values()]
    assert names[1] == ["upper_arm_r", "forearm_r", "hand_r"]
    assert names[2] == ["thigh_l", "shin_l", "foot_l"]
    without = tuple("" if role == "foot_l" else role for role in roles)
    assert list(_complete_limbs(without)) == ["left arm", "right arm", "right leg"]


def test_rigs_of_another_order_of_size_are_pointed_out(root: Path) -> None:
    """Below a ninth and above nine times."""
    stream = open_source(root / "samples/walk/walk.bvh")
    for scale, count in ((0.112, 0), (0.111, 1), (1.0, 0), (8.99, 0), (9.01, 1)):
        found = _size_warnings(stream, scale)
        assert [(f.code, f.severity) for f in found] == (
            [("MAP106", Severity.WARNING)] * count
        )
    assert "0.0254 times" in _size_warnings(stream, 0.0254)[0].message


@pytest.mark.parametrize("moving", ["head", "hips"])
def test_a_take_in_which_one_joint_moves_does(moving: str) -> None:
    rig, _ = person()
    places, turns = rig.rest_translations, rig.rest_rotations
    joint = np.array([rig.index(moving)])
    still = np.zeros(0, int)
    way = so3.exp(np.linspace([0.0, 0, 0], [0.0, 0.6, 0], 6))[:, None]
    channels = (
        Channel(places, still, np.zeros((6, 0, 3))),
        Channel(turns, joint, so3.multiply(turns[joint], way)),
    )
    take = Take(
        rig, Clock(Fraction(24), Fraction(1), Fraction(1), 6), Motion(*channels)
    )
    found = retarget_take(take, rig, map_joints(rig, rig)).take
    turned = found.world().rotations[:, joint[0]]
    wanted = take.world().rotations[:, joint[0]]
    assert_allclose(so3.angle_between(turned, wanted), 0, atol=1e-6)
    assert so3.angle_between(turned[0], turned[-1]) == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize(
    ("paired", "refused", "limbs"),
    [
        (
            ("upper_arm_l", "forearm_l", "hand_l", "hips", "spine", "head", "neck"),
            False,
            0,
        ),
        (("upper_arm_l", "forearm_l", "hand_l"), True, 0),
        (("hips", "spine", "spine_2", "spine_3", "neck", "head", "foot_l"), True, 4),
    ],
)
def test_a_take_fits_by_a_third_of_its_joints_and_a_whole_limb(
    paired: tuple[str, ...], refused: bool, limbs: int
) -> None:
    """Of a person's twenty joints without fingers seven are a third."""
    rig, _ = person()
    roles = find_anatomy(rig).roles
    assert len(_body_joints(rig, roles)) == 20
    found: Any = SimpleNamespace(
        source=SimpleNamespace(roles=roles),
        pairs=[SimpleNamespace(source=rig.index(name)) for name in paired],
        chains=[],
    )
    fault = insufficient_pairs_fault(rig, found, np.zeros(0, int), ())
    assert (fault is not None) == refused
    if fault is not None:
        assert fault.code == "MAP010"
        assert f"{len(paired)} of 20 moving joints" in fault.message
        assert ("none of its limbs" in fault.message) == bool(limbs)


@pytest.mark.parametrize(("rest", "found"), [(12, True), (None, False)])
def test_a_rest_pose_in_mid_motion(root: Path, rest: int | None, found: bool) -> None:
    walk = open_source(root / "samples/walk/walk.bvh")
    biped = Rig.load(root / "rigs/biped/biped.rig.yaml")
    options = RetargetOptions(rest=rest)
    retargeting, _, notices = retarget_stream(walk, biped, options)
    list(checked_blocks(retargeting, options, notices))
    assert ("MAP110" in [notice.code for notice in notices]) is found
    expected = TakeStatus.LOOK if found else TakeStatus.GOOD
    assert retargeting.verdict().status is expected


@pytest.mark.parametrize(
    ("others", "options", "count"),
    [
        ("others: none\n", {"by": "structure"}, 1),
        ("", {"by": "rename", "preset": "mixamo"}, 2),
        ("others: none\n", {}, 0),
        ("others: auto\n", {"by": "structure"}, 0),
    ],
)
def test_options_of_pairing_without_effect_beside_a_map_are_named(
    root: Path, tmp_path: Path, others: str, options: dict[str, Any], count: int
) -> None:
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    biped = Rig.load(root / "rigs/biped/biped.rig.yaml")
    lines = others + "joints:\n- {source: Hips, target: hips, role: hips}\n"
    path = tmp_path / "one.map.yaml"
    path.write_text(f"map: animtool/1\n{lines}", "utf-8")
    settings = RetargetOptions(map=path, **options)
    notices = retarget_stream(TakeStream.of(walk), biped, settings)[2]
    found = [notice for notice in notices if notice.code == "MAP111"]
    assert len(found) == (count > 0)
    for notice in found:
        assert notice.lines == ((2,) if others else ())
        assert all(f'{name}="{options[name]}"' in notice.message for name in options)


@pytest.mark.parametrize(("angle", "codes"), [(0.8, ["MAP110"]), (0.2, [])])
def test_a_rest_pose_that_is_not_that_of_the_rig(
    root: Path, angle: float, codes: list[str]
) -> None:
    """Arms that hang in the offsets, as in an A-pose."""
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    joints = []
    for joint in walk.rig.joints:
        translation = np.array(joint.translation)
        if joint.name in {"LeftForeArm", "LeftHand", "RightForeArm", "RightHand"}:
            sign = -1.0 if joint.name.startswith("Left") else 1.0
            translation = so3.rotate(so3.exp([0.0, 0.0, sign * angle]), translation)
        joints.append(replace(joint, translation=tuple(translation.tolist())))
    rig = replace(walk.rig, joints=tuple(joints))
    stream = TakeStream.of(replace(walk, rig=rig))
    for rest, expected in (("rig", codes), (None, [])):
        options = RetargetOptions(rest=rest)  # type: ignore[arg-type]
        notices = retarget_stream(stream, walk.rig, options)[2]
        assert [n.code for n in notices if n.code == "MAP110"] == expected
        stream = TakeStream.of(replace(walk, rig=rig))
