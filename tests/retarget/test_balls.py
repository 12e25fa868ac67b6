"""Feet with any number of toes: where they roll, and how they stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import Channel, Rig, Take, open_source
from animtool.core.array_types import FloatArray
from animtool.motion.motion import Motion
from animtool.retarget import map_joints
from animtool.retarget.balls import _ankle_to_ball, _FootShape, _toeless_ball
from animtool.retarget.motion import Retargeted, retarget_take
from animtool.retarget.transfer import middle_of_hips
from animtool.rig.skeleton import Joint

TOES = {"LeftToe", "RightToe"}


@pytest.fixture(scope="module")
def walk(root: Path) -> Take:
    return open_source(root / "samples/walk/walk.bvh").collect()


def with_toes(
    rig: Rig, toes: int, bones: int = 1, *, shin: float = 1.0, tip: float = 0.0
) -> Rig:
    """Return a rig whose feet have other toes than one each.

    Args:
        rig: Of the walk.
        toes: In each foot, side by side.
        bones: Of each toe.
        shin: How much longer shins are.
        tip: Where a foot without toes ends: 0 is the ball, 1 the tip of its toes.
    """
    names, made = {joint.name: joint for joint in rig.joints}, []
    index: dict[str, int] = {}

    def put(name: str, parent: str, joint: Joint, **changes: object) -> None:
        index[name] = len(made)
        above = index[parent] if parent else -1
        made.append(replace(joint, name=name, parent=above, source_name="", **changes))

    for joint in rig.joints:
        parent = rig.joints[joint.parent].name if joint.parent >= 0 else ""
        if joint.name not in TOES:
            longer = shin if "Foot" in joint.name else 1.0
            way = tuple((longer * np.array(joint.translation)).tolist())
            tips = joint.tips
            if "Foot" in joint.name and not toes:
                toe = names[joint.name.replace("Foot", "Toe")]
                end = np.array(toe.translation) + tip * np.array(toe.tips[0])
                tips = (tuple(end.tolist()),)
            put(joint.name, parent, joint, translation=way, tips=tips)
            continue
        spread = 0.02 * (np.arange(toes) - (toes - 1) / 2)
        for k, across in enumerate(spread.tolist()):
            bone = tuple((np.array(joint.tips[0]) / bones).tolist())
            ways = [
                tuple((np.array(joint.translation) + np.array([across, 0, 0])).tolist())
            ]
            ways += [bone] * (bones - 1)
            links = [f"{joint.name}{k}_{i}" for i in range(bones)]
            for i, (link, way) in enumerate(zip(links, ways, strict=True)):
                ends = (bone,) if i == bones - 1 else ()
                above = links[i - 1] if i else parent
                put(link, above, joint, translation=way, tips=ends)
    return Rig("toes", tuple(made), rig.meters_per_unit, rig.up)


def onto(take: Take, rig: Rig) -> Retargeted:
    return retarget_take(take, rig, map_joints(take.rig, rig))


def hips(made: Retargeted) -> FloatArray:
    return middle_of_hips(made.transfer.target, made.world.positions)


def shaken(take: Take, rig: Rig) -> Take:
    """Return a take on a skeleton whose toes are others; these rest."""
    names = {joint.name: j for j, joint in enumerate(take.rig.joints)}
    places = np.repeat(rig.rest_translations[None], take.motion.frames, axis=0)
    turns = np.repeat(rig.rest_rotations[None], take.motion.frames, axis=0)
    for j, name in enumerate(rig.names):
        if name in names:
            turns[:, j] = take.motion.rotations.dense()[:, names[name]]
    places[:, 0] = take.motion.translations.dense()[:, 0]
    channels = Channel.from_dense(places), Channel.from_dense(turns)
    return replace(take, rig=rig, motion=Motion(*channels))


@pytest.mark.parametrize("shin", [1.0, 1.12])
@pytest.mark.parametrize(
    ("toes", "bones"), [(0, 1), (2, 1), (3, 2), (5, 1), (5, 3)], ids=str
)
def test_any_number_of_toes_is_as_good_as_one(
    walk: Take, toes: int, bones: int, shin: float
) -> None:
    one = onto(walk, with_toes(walk.rig, 1, shin=shin))
    made = onto(walk, with_toes(walk.rig, toes, bones, shin=shin))
    dips = [float(np.ptp(hips(each)[:, 1])) for each in (made, one)]
    assert dips[0] == pytest.approx(dips[1], rel=0.1)
    for size in (np.max, lambda each: np.sqrt((each**2).mean())):
        fast = [
            size(np.linalg.norm(np.diff(hips(each), 2, axis=0), axis=1))
            for each in (made, one)
        ]
        assert fast[0] == pytest.approx(fast[1], rel=0.1)
    assert made.report.sole_error < 1e-3
    assert made.report.drift_max < 1e-3


def test_all_toes_bend_as_one_does(walk: Take) -> None:
    rig = with_toes(walk.rig, 5)
    found = map_joints(walk.rig, rig)
    toe = walk.rig.index("LeftToe")
    pairs = {rig.names[p.target]: p.source for p in found.pairs}
    assert {pairs[f"LeftToe{k}_0"] for k in range(5)} == {toe}
    assert found.unmapped_target == ()


def test_toes_pair_in_their_order_from_the_inner_side(walk: Take) -> None:
    five, two = with_toes(walk.rig, 5), with_toes(walk.rig, 2)
    found = map_joints(five, two)
    pairs = {two.names[p.target]: five.names[p.source] for p in found.pairs}
    # The walk's left is at +x, and so the inner toe of that foot is the first one.
    assert (pairs["LeftToe0_0"], pairs["LeftToe1_0"]) == ("LeftToe0_0", "LeftToe4_0")
    assert (pairs["RightToe1_0"], pairs["RightToe0_0"]) == (
        "RightToe4_0",
        "RightToe0_0",
    )


@pytest.mark.parametrize("toes", [0, 2, 5])
def test_sources_may_have_other_toes_than_one(walk: Take, toes: int) -> None:
    source = shaken(walk, with_toes(walk.rig, toes))
    target = with_toes(walk.rig, 1, shin=1.12)
    one, made = onto(walk, target), onto(source, target)
    own, other = hips(made), hips(one)
    assert np.abs(own - other).max() < 2e-3
    assert made.report.sole_error < 1e-3
    assert made.report.contacts == pytest.approx(one.report.contacts, abs=0.02)


def test_a_foot_that_ends_at_its_toes_rolls_over_its_ball(walk: Take) -> None:
    short = onto(walk, with_toes(walk.rig, 0, shin=1.12))
    long = onto(walk, with_toes(walk.rig, 0, shin=1.12, tip=1.0))
    assert_allclose(hips(long), hips(short), atol=2e-3)
    assert long.report.sole_error < 1e-3


def test_a_foot_that_shows_no_end_has_the_proportions_of_the_source(walk: Take) -> None:
    rig = with_toes(walk.rig, 0, shin=1.12)
    joints = tuple(
        replace(joint, tips=()) if "Foot" in joint.name else joint
        for joint in rig.joints
    )
    made = onto(walk, replace(rig, joints=joints))
    assert np.abs(hips(made) - hips(onto(walk, rig))).max() < 1e-2
    assert made.report.sole_error < 1e-3


def test_a_heel_is_no_toe(walk: Take) -> None:
    rig = walk.rig
    foot = rig.index("LeftFoot")
    heel = Joint("LeftHeel", foot, translation=(0.0, -0.06, -0.05))
    found = map_joints(walk.rig, replace(rig, joints=(*rig.joints, heel)))
    names = [found.target.roles[j] for j in range(len(rig.joints) + 1)]
    assert names[-1] == ""
    assert names[rig.index("LeftToe")] == "toe_l"


def test_a_foot_rolls_over_the_foremost_of_its_toes_in_their_middle() -> None:
    """The second is 14 cm ahead; in the mean they are 2 cm to the left."""
    toes = [[0.02, -0.05, 0.10], [-0.02, -0.06, 0.14], [0.06, -0.05, 0.12]]
    person: Any = SimpleNamespace(
        positions=np.array([[0.0, 0, 0], *toes]) + np.array([1.0, 0.1, 2.0]),
        facing_axes=np.eye(3),
    )
    assert_allclose(
        _ankle_to_ball(person, 0, [1, 2, 3]), [0.02, -0.06, 0.14], atol=1e-12
    )
    assert_allclose(_ankle_to_ball(person, 0, [3]), toes[2], atol=1e-12)
    person.facing_axes = None
    assert_allclose(_ankle_to_ball(person, 0, [1, 3]), [0.04, -0.05, 0.11], atol=1e-12)


@pytest.mark.parametrize(
    ("length", "ball"), [(0.13, 0.13), (0.141, 0.141), (0.142, 0.071), (0.2, 0.1)]
)
@pytest.mark.parametrize("size", [1.0, 2.0])
def test_a_foot_without_toes_ends_as_what_it_is_nearer_to(
    length: float, ball: float, size: float
) -> None:
    """Of another the ball is 10 cm ahead and the tip 20: 14.14 are as far from both."""
    joints = (
        Joint("thigh", -1),
        Joint("shin", 0, translation=(0.0, -0.4, 0.0)),
        Joint(
            "foot", 1, translation=(0.0, -0.4, 0.0), tips=((0.0, 0.0, size * length),)
        ),
    )
    person: Any = SimpleNamespace(
        rig=Rig("leg", joints),
        positions=np.array([[0.0, 0.8, 0], [0, 0.4, 0], [0, 0, 0]]),
        rotations=np.tile([0.0, 0, 0, 1], (3, 1)),
        roles=["thigh_l", "shin_l", "foot_l"],
        facing_axes=np.eye(3),
        leg=lambda _: (0, 1, 2, -1),
    )
    other = _FootShape(np.array([0.0, 0, 0.1]), np.array([0.0, 0, 0.2]))
    found = _toeless_ball(person, "l", other, size)
    assert_allclose(found, [0, 0, size * ball])
