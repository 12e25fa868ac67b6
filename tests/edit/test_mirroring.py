from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError
from animtool.edit.mirroring import PASS, MirrorOptions, mirror
from animtool.formats.bvh.read import read_bvh
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward
from animtool.rig.parts import Shape
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Joint, Rig


def positions(take: Take) -> np.ndarray:
    return forward(take.rig, *take.motion.dense()).positions


def test_the_world_is_mirrored(walk: Path) -> None:
    take = read_bvh(walk).collect()
    partners = pair_sides(take.rig.names, take.rig.parents).partners
    assert (partners != np.arange(len(partners))).any()
    expected = positions(take)[:, partners] * [-1.0, 1.0, 1.0]
    assert_allclose(positions(mirror(take)), expected, atol=1e-12)


def test_twice_is_the_source(walk: Path) -> None:
    take = read_bvh(walk).collect()
    again = mirror(mirror(take))
    for one, two in zip(again.motion.dense()[:2], take.motion.dense()[:2], strict=True):
        assert_allclose(one, two, atol=1e-14)


def test_partners_that_hang_elsewhere(walk: Path) -> None:
    take = read_bvh(walk).collect()
    with pytest.raises(OptionError) as error:
        mirror(take, pairs=[("Spine", "LeftHand")])
    assert error.value.code == "SCN019"


@pytest.mark.parametrize("pair", [("Spine", "LeftHnad"), ("LeftHnad", "Spine")])
def test_a_joint_of_a_pair_that_there_is_none_of_is_named(
    walk: Path, pair: tuple[str, str]
) -> None:
    take = read_bvh(walk).collect()
    with pytest.raises(OptionError, match="'LeftHnad'") as error:
        mirror(take, pairs=[pair])
    assert error.value.code == "SCN012"
    assert "LeftHand" in (error.value.faults[0].hint or "")


def test_a_stated_pair_whose_parents_are_no_partners_is_named() -> None:
    names = ["hips", "leg_l", "leg_r", "foot_l", "foot_r", "arm_l", "arm_r"]
    joints = [
        Joint(name, parent)
        for name, parent in zip(names, (-1, 0, 0, 1, 2, 0, 0), strict=True)
    ]
    rig = Rig("two", tuple(joints))
    still = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
    )
    take = Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), 1), still)
    with pytest.raises(OptionError) as caught:
        mirror(take, pairs=[("foot_l", "arm_r"), ("hips", "arm_l")])
    first, second = (fault.message for fault in caught.value.faults)
    assert "'foot_l' and 'arm_r' cannot be swapped" in first
    assert "'leg_l' and 'hips'" in first
    assert "'hips' has no parent" in second


# Names of the Acclaim skeletons of CMU: letters in front of words.
CMU = ["root", "lfemur", "rfemur", "thorax", "lhumerus", "rhumerus", "lhand", "rhand"]


def arms(names: list[str], foot: float = -0.1) -> Take:
    """Return a take of two frames in which the left arm is raised."""
    offsets = [(0, 1, 0), (0.1, -0.5, 0), (foot, -0.5, 0), (0, 0.5, 0)]
    offsets += [(0.2, 0, 0), (-0.2, 0, 0), (0.5, 0, 0), (-0.5, 0, 0)]
    rig = Rig(
        "person",
        tuple(
            Joint(name, parent, translation=tuple(map(float, offset)))
            for name, parent, offset in zip(
                names, (-1, 0, 0, 0, 3, 3, 4, 5), offsets, strict=True
            )
        ),
    )
    turned = np.stack([rig.rest_rotations, rig.rest_rotations])
    turned[1, 4] = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    motion = Motion(
        Channel.from_dense(np.stack([rig.rest_translations] * 2)),
        Channel.from_dense(turned),
    )
    return Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), 2), motion)


def mirrored(take: Take, **options: object) -> tuple[Take, list[Fault]]:
    context = PassContext(lambda _: take, Path())
    chosen = MirrorOptions(**options)  # type: ignore[arg-type]
    stream = apply_pass(TakeStream.of(take), PASS, chosen, context)
    return stream.collect(), context.notices


def test_names_of_cmu_change_sides() -> None:
    take = arms(CMU)
    seen, notices = mirrored(take)
    assert not notices
    hand = positions(seen)[1, CMU.index("rhand")]
    assert_allclose(hand, [-0.2, 2.0, 0.0], atol=1e-12)
    assert_allclose(positions(seen)[1, CMU.index("lhand")], [0.7, 1.5, 0], atol=1e-12)


def test_names_that_look_left_and_have_no_partner_are_a_warning() -> None:
    names = [*CMU[:4], "armLeft", "arm_right", "handLeft", "hand_right"]
    _, (notice,) = mirrored(arms(names))
    assert (notice.code, notice.severity) == ("SCN082", "warning")
    assert "'armLeft', 'arm_right', 'handLeft', 'hand_right'" in notice.message
    pairs = (("armLeft", "arm_right"), ("handLeft", "hand_right"))
    assert "pairs: [[armLeft, arm_right], [handLeft, hand_right]]" in str(notice.hint)
    seen, notices = mirrored(arms(names), pairs=pairs)
    assert not notices
    assert_allclose(positions(seen)[1, 7], [-0.2, 2.0, 0.0], atol=1e-12)


def test_a_rest_pose_that_is_not_symmetric_is_a_warning() -> None:
    _, (notice,) = mirrored(arms(CMU, foot=-0.36))
    assert (notice.code, notice.severity) == ("SCN083", "warning")
    assert "'lfemur' is 0.26 m from the mirror image of 'rfemur'" in notice.message
    tall = arms(CMU, foot=-0.11)
    assert not mirrored(tall)[1]


def test_a_joint_of_one_side_alone_keeps_its_motion() -> None:
    # A sword in the left hand, and none in the right one.
    take = arms([*CMU[:6], "sword", "rhand"])
    seen, (notice,) = mirrored(take)
    assert notice.code == "SCN082"
    assert "'sword'" in notice.message
    assert_allclose(
        seen.motion.rotations.dense()[:, 6], take.motion.rotations.dense()[:, 6]
    )


def test_a_take_without_joints_is_mirrored() -> None:
    shapes = tuple(Shape(name) for name in ("smile_l", "smile_r"))
    weights = np.array([[[0.0], [1.0]], [[0.25], [0.5]]])
    motion = Motion(
        Channel.from_dense(np.zeros((2, 0, 3))),
        Channel.from_dense(np.zeros((2, 0, 4))),
        weights=Channel.from_dense(weights),
    )
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 2)
    take = Take(Rig("face", (), shapes=shapes), clock, motion)
    seen, notices = mirrored(take)
    assert seen.motion.weights is not None
    assert_allclose(seen.motion.weights.dense(), weights[:, ::-1])
    assert not notices
