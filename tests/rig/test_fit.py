"""Does a take fit a rig: each part of the score, and what must not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.fit import along_x, bent, with_rest

from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.fit import MIN_FIT, PERFECT_FIT, RigFit, measure_fit
from animtool.rig.skeleton import Joint, Rig

QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
BODY = Rig(
    "body",
    (
        Joint("hips", -1, translation=(0, 1, 0)),
        Joint("chest", 0, translation=(0, 0.5, 0)),
        Joint("head", 1, translation=(0, 0.3, 0)),
        Joint("arm_l", 1, translation=(0.2, 0, 0)),
        Joint("hand_l", 3, translation=(0.5, 0, 0)),
        Joint("thumb_l", 4, translation=(0.05, 0, 0.05)),
        Joint("arm_r", 1, translation=(-0.2, 0, 0)),
        Joint("hand_r", 6, translation=(-0.5, 0, 0)),
        Joint("leg", 0, translation=(0, -0.8, 0.1)),
    ),
)


def fit(take: Rig, rig: Rig = BODY, *, posed: bool = True) -> RigFit:
    source = [take.names.index(n) if n in take.names else -1 for n in rig.names]
    return measure_fit(take, rig, np.array(source), compares_poses=posed)


def kept(names: set[str]) -> Rig:
    """Return the body with some of its joints, each below the nearest that is left."""
    joints: list[Joint] = []
    places = {-1: -1}
    for i, joint in enumerate(BODY.joints):
        places[i] = places[joint.parent]
        if joint.name in names:
            places[i] = len(joints)
            joints.append(replace(joint, parent=places[joint.parent]))
    return Rig("part", tuple(joints))


def test_a_rig_fits_itself() -> None:
    found = fit(BODY)
    assert found.score == pytest.approx(1.0)
    assert found.differing_joints == []


def test_roots_may_stand_and_turn_anywhere_with_the_pose() -> None:
    moved = replace(BODY.joints[0], translation=(5.0, 0.0, 3.0))
    assert fit(replace(BODY, joints=(moved, *BODY.joints[1:]))).score == pytest.approx(
        1.0
    )


@pytest.mark.parametrize(
    "names",
    [
        {"hips", "chest", "head", "arm_l", "hand_l", "arm_r", "hand_r"},
        {"head"},
        {"arm_l", "hand_l", "thumb_l"},
    ],
)
def test_a_take_of_some_joints_fits(names: set[str]) -> None:
    assert fit(kept(names)).score == pytest.approx(1.0)
    # So does a take with more joints than the rig.
    assert fit(BODY, kept(names)).score == pytest.approx(1.0)


def test_end_joints_that_the_rig_lacks_do_not_count() -> None:
    rig = kept(set(BODY.names) - {"thumb_l"})
    assert fit(BODY, rig).take_fraction == 1.0


def test_few_joints_of_many_do_not_fit() -> None:
    strange = tuple(
        replace(j, name=j.name if i == 0 else f"bone_{i}")
        for i, j in enumerate(BODY.joints)
    )
    found = fit(replace(BODY, joints=strange))
    assert found.components["joints"] < MIN_FIT
    assert found.score == found.components["joints"]


def test_one_limb_at_another_angle_does_not_fit() -> None:
    found = fit(bent(BODY, "arm_l", so3.from_axis_angle([0, 0, 1], np.pi / 4)))
    assert found.score < MIN_FIT
    assert {BODY.names[j] for j in found.differing_joints} == {
        "arm_l",
        "hand_l",
        "thumb_l",
    }


def test_other_poses_of_the_same_frames_fit() -> None:
    rotations = np.tile(so3.IDENTITY, (len(BODY.joints), 1))
    rotations[3] = so3.from_axis_angle([0, 0, 1], np.pi / 4)
    rotations[0] = so3.from_axis_angle([1, 0, 0], 1.0)
    assert fit(with_rest(BODY, rotations)).score == pytest.approx(1.0)


def test_frames_along_their_bones_do_not_fit_plain_ones() -> None:
    assert fit(along_x(BODY)).score < 0.3
    assert fit(BODY, along_x(BODY)).score < 0.3
    assert fit(along_x(BODY), along_x(BODY)).score == pytest.approx(1.0)


def test_a_twist_is_found_where_the_pose_is_the_same() -> None:
    hand = BODY.index("hand_r")
    joints = list(BODY.joints)
    joints[hand] = replace(joints[hand], rotation=(0.5**0.5, 0.0, 0.0, 0.5**0.5))
    found = fit(replace(BODY, joints=tuple(joints)))
    assert found.score < PERFECT_FIT
    assert found.differing_joints == [hand]
    assert fit(replace(BODY, joints=tuple(joints)), posed=False).score == pytest.approx(
        1.0
    )


@pytest.mark.parametrize("factor", [100.0, 0.01, 2.54, 1.6])
def test_another_size_does_not_fit(factor: float) -> None:
    scaled = tuple(
        replace(j, translation=tuple(factor * x for x in j.translation))
        for j in BODY.joints
    )
    found = fit(replace(BODY, joints=scaled))
    assert found.size == pytest.approx(factor)
    assert found.score < MIN_FIT
    assert found.components["lengths"] == pytest.approx(1.0)
    assert found.differing_joints == []


def test_other_proportions_score_by_their_difference() -> None:
    joints = list(BODY.joints)
    joints[8] = replace(joints[8], translation=(0, -0.9, 0.11))
    found = fit(replace(BODY, joints=tuple(joints)))
    assert MIN_FIT < found.score < PERFECT_FIT
    joints[8] = replace(joints[8], translation=(0, 0, 0))
    assert fit(replace(BODY, joints=tuple(joints))).score < MIN_FIT


def test_a_character_on_its_back_does_not_fit() -> None:
    lying = replace(BODY.joints[0], rotation=(-(0.5**0.5), 0.0, 0.0, 0.5**0.5))
    found = fit(replace(BODY, joints=(lying, *BODY.joints[1:])))
    assert found.up_axis_angle == pytest.approx(np.pi / 2)
    assert found.score == pytest.approx(0.0)
    # About the up axis it may be turned.
    z_up = replace(BODY, up=UpAxis.Z)
    turned = replace(BODY.joints[0], rotation=QUARTER)
    assert fit(
        replace(z_up, joints=(turned, *BODY.joints[1:])), z_up
    ).score == pytest.approx(1.0)


def test_nothing_to_compare_fits() -> None:
    one = Rig("one", (Joint("hips", -1),))
    assert fit(one, one).score == pytest.approx(1.0)
    # Nor do bones without length, whose offsets are in the motion.
    flat = replace(
        BODY, joints=tuple(replace(j, translation=(0, 0, 0)) for j in BODY.joints)
    )
    assert fit(flat).score == pytest.approx(1.0)
