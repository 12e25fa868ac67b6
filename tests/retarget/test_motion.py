"""Takes on other rigs: what must stay the same, and what must fit."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import Channel, Rig, Take, open_source
from animtool.core.files.spool import Spool
from animtool.core.units import UpAxis, up_from_up
from animtool.edit import mirror
from animtool.maths import so3
from animtool.retarget import map_joints, motion
from animtool.retarget.motion import Retargeted, limb_joints, retarget_take
from animtool.rig.limits import BallLimit, RangeLimit, swing_twist
from animtool.rig.skeleton import JointType


@pytest.fixture(scope="module")
def walk(root: Path) -> Take:
    return open_source(root / "samples/walk/walk.bvh").collect()


@pytest.fixture(scope="module")
def biped(root: Path) -> Rig:
    return Rig.load(root / "rigs/biped/biped.rig.yaml")


@pytest.fixture(scope="module")
def onto(walk: Take, biped: Rig) -> Retargeted:
    return retarget_take(walk, biped, map_joints(walk.rig, biped))


def scaled(rig: Rig, size: float, shin: float = 1.0) -> Rig:
    """Return a rig of another size, its shins longer by a share."""
    longer = [shin if "Foot" in name else 1.0 for name in rig.names]
    joints = tuple(
        replace(
            joint,
            translation=tuple((size * share * np.array(joint.translation)).tolist()),
        )
        for joint, share in zip(rig.joints, longer, strict=True)
    )
    return replace(rig, joints=joints)


def onto_rig(take: Take, rig: Rig) -> Retargeted:
    return retarget_take(take, rig, map_joints(take.rig, rig))


def test_limbs_are_of_the_hips_on_whichever_joint_these_are(walk: Take) -> None:
    """The first joint counts, too; spine, neck and head do not."""
    made = onto_rig(walk, walk.rig)
    person = made.transfer.target
    limbs = limb_joints(person)
    hips = person.first_joint("hips")
    assert hips == 0
    assert hips in limbs
    names = {walk.rig.names[j] for j in limbs}
    assert not {name for name in names if "Spine" in name or "Head" in name}
    assert {"LeftUpLeg", "RightLeg", "LeftFoot", "RightForeArm"} <= names


def test_a_copy_of_the_skeleton_moves_as_the_source(walk: Take) -> None:
    made = onto_rig(walk, walk.rig)
    source = walk.world()
    assert_allclose(made.world.positions, source.positions, atol=1e-12)
    assert so3.angle_between(made.world.rotations, source.rotations).max() < 1e-7


@pytest.mark.parametrize("size", [0.3, 2.5])
def test_a_scaled_copy_has_the_scaled_motion(walk: Take, size: float) -> None:
    made = onto_rig(walk, scaled(walk.rig, size))
    assert made.transfer.scale == pytest.approx(size)
    assert_allclose(made.world.positions, size * walk.world().positions, atol=1e-11)


def test_a_turned_rest_pose_changes_nothing(walk: Take) -> None:
    """Of the same skeleton in a pose with its arms down."""
    rig = walk.rig
    turns = {"LeftArm": [0, 0, -0.9], "RightArm": [0, 0, 0.9]}
    joints = tuple(
        replace(joint, rotation=tuple(so3.exp(np.array(turns[joint.name])).tolist()))
        if joint.name in turns
        else joint
        for joint in rig.joints
    )
    assert {joint.name for joint in rig.joints} >= {*turns}
    made = onto_rig(walk, replace(rig, joints=joints))
    assert_allclose(made.world.positions, walk.world().positions, atol=1e-9)


def test_feet_stay_where_they_stand(walk: Take) -> None:
    rig = scaled(walk.rig, 1.0, shin=1.3)
    found = map_joints(walk.rig, rig)
    held = retarget_take(walk, rig, found).report
    free = retarget_take(walk, rig, found, lock=False).report
    assert 0.4 < held.contacts < 1
    assert held.drift_max < 1e-6
    assert held.sole_error < 1e-6
    assert free.drift_max > 0.005
    assert held.acceleration < 1.2
    assert held.bone_angle_mean < np.radians(0.7)


def test_frames_whose_goals_stay_are_not_solved_again(
    walk: Take, biped: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An ankle gives way for its toe only where a limit stops the foot."""
    rows: list[int] = []
    solved = motion.Retargeting._solve_ankles

    def counted(self: motion.Retargeting, *given: Any) -> Any:
        rows.append(len(given[-1]))
        return solved(self, *given)

    monkeypatch.setattr(motion.Retargeting, "_solve_ankles", counted)
    made = onto_rig(walk, scaled(walk.rig, 1.0, shin=0.9))
    assert made.standing.placed_feet is not None
    assert sum(rows) == walk.clock.count
    # Ankles that bend by 15 degrees alone stop feet in some frames.
    stiff = [
        replace(joint, limits=replace(joint.limits, swing=(np.pi / 12, np.pi / 12)))
        if joint.name.startswith("ankle_")
        else joint
        for joint in biped.joints
    ]
    rows.clear()
    onto_rig(walk, replace(biped, joints=tuple(stiff)))
    first, *others = rows
    assert first == walk.clock.count
    assert 0 < others[0] < first / 2
    assert sorted(others, reverse=True) == others


def test_no_limit_is_broken(onto: Retargeted, biped: Rig) -> None:
    turns = onto.take.motion.rotations.dense()
    for j, joint in enumerate(biped.joints):
        own = so3.multiply(so3.conjugate(biped.rest_rotations[j]), turns[:, j])
        if joint.type is JointType.PIN:
            off, angle = swing_twist(own, joint.axis)
            assert so3.angle_between(off, so3.IDENTITY).max() < 1e-6, joint.name
            if isinstance(joint.limits, RangeLimit):
                assert np.abs(joint.limits.excess(angle)).max() < 1e-6, joint.name
        elif isinstance(joint.limits, BallLimit):
            assert joint.limits.excess(own).max() < 1e-6, joint.name


def test_knees_without_limits_reach_as_far_as_legs_do(walk: Take, biped: Rig) -> None:
    free = tuple(
        replace(joint, limits=None) if joint.name.startswith("knee") else joint
        for joint in biped.joints
    )
    report = onto_rig(walk, replace(biped, joints=free)).report
    assert report.drift_max < 1e-6
    assert report.sole_error < 1e-6


def test_the_walk_fits_the_biped(onto: Retargeted, walk: Take) -> None:
    score = onto.report
    assert onto.take.clock == walk.clock
    assert score.drift_max < 0.001
    assert score.sole_error < 0.001
    assert score.reach_error < 0.005
    assert score.bone_angle_mean < np.radians(1.0)
    assert score.unmapped_source == ()


def test_twist_joints_share_the_turn_of_the_hand(walk: Take) -> None:
    """A forearm that turns all the way round gives no jump of half a turn."""
    rig, frames = walk.rig, 60
    hand = rig.index("LeftHand")
    below = rig.index("LeftForeArm")
    axis = np.array(rig.joints[hand].translation)
    axis /= np.linalg.norm(axis)
    rotations = np.repeat(rig.rest_rotations[None], frames, axis=0)
    angles = np.linspace(0, 1.9 * np.pi, frames)
    rotations[:, hand] = so3.from_axis_angle(axis, angles)
    twist = replace(
        rig.joints[hand],
        name="LeftForeArmTwist",
        parent=below,
        translation=tuple((np.array(rig.joints[hand].translation) / 2).tolist()),
    )
    target = replace(rig, joints=(*rig.joints, twist))
    turned_motion = replace(
        walk.motion,
        rotations=Channel.from_dense(rotations),
        translations=walk.motion.translations.select(slice(0, frames)),
    )
    clock = replace(walk.clock, count=frames)
    take = replace(walk, clock=clock, motion=turned_motion)
    found = map_joints(rig, target)
    assert [share.target for share in found.twists] == [len(rig.joints)]
    made = retarget_take(take, target, found)
    own = made.take.motion.rotations.dense()[:, -1]
    steps = so3.angle_between(own[1:], own[:-1])
    assert steps.max() < 1.5 * steps.mean()
    turned = np.unwrap(swing_twist(own, tuple(axis.tolist()))[1])
    assert turned[-1] - turned[0] == pytest.approx(
        found.twists[0].fraction * (angles[-1] - angles[0]), rel=1e-6
    )


@pytest.mark.parametrize("kept", [0, 100_000])
def test_a_long_take_goes_in_blocks(
    walk: Take, biped: Rig, onto: Retargeted, monkeypatch: pytest.MonkeyPatch, kept: int
) -> None:
    """What is not kept in memory comes back from a file, with no seam."""
    monkeypatch.setattr(motion, "BLOCK_FRAMES", 7)
    monkeypatch.setattr(motion, "Spool", partial(Spool, kept))
    found = retarget_take(walk, biped, map_joints(walk.rig, biped))
    for own, whole in zip(
        found.take.motion.dense(), onto.take.motion.dense(), strict=True
    ):
        if own is not None and whole is not None:
            assert_allclose(own, whole, rtol=0, atol=1e-15)
    assert found.report.frames == walk.clock.count
    assert found.report.acceleration == pytest.approx(onto.report.acceleration)


def test_a_rig_that_stands_along_z_is_held_as_well(walk: Take) -> None:
    rig = scaled(walk.rig, 1.0, shin=1.3)
    turn = np.array(up_from_up(UpAxis.Z, UpAxis.Y))
    root = replace(
        rig.joints[0],
        translation=tuple(
            so3.rotate(turn, np.array(rig.joints[0].translation)).tolist()
        ),
        rotation=tuple(so3.multiply(turn, np.array(rig.joints[0].rotation)).tolist()),
    )
    tall = replace(rig, up=UpAxis.Z, joints=(root, *rig.joints[1:]))
    one, other = onto_rig(walk, rig), onto_rig(walk, tall)
    assert_allclose(
        other.world.positions, so3.rotate(turn, one.world.positions), atol=1e-9
    )


@pytest.mark.parametrize("take", ["walk", "carry", "march"])
def test_soles_are_on_the_ground_from_the_first_frame(root: Path, take: str) -> None:
    """Some begin on the toes of a foot."""
    folder = root / "samples/retarget"
    rig = Rig.load(folder / "rigs/giant.rig.yaml")
    made = onto_rig(open_source(folder / f"takes/{take}.bvh").collect(), rig)
    score = made.report
    assert score.sole_error < 1e-3
    assert score.drift_max < 1e-3


def test_the_mirror_of_a_take_gives_the_mirror(root: Path) -> None:
    folder = root / "samples/retarget"
    rig = Rig.load(folder / "rigs/giant.rig.yaml")
    take = open_source(folder / "takes/turn.bvh").collect()
    plain, other = onto_rig(take, rig).take, onto_rig(mirror(take), rig).take
    expected = mirror(plain).world().positions
    assert_allclose(other.world().positions, expected, atol=1e-9)
    assert np.abs(expected - plain.world().positions).max() > 0.1
