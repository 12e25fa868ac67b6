from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.edit.mirror import mirror, mirror_pairs
from animtool.errors import OptionError
from animtool.formats.bvh import read_bvh
from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Joint, Rig
from animtool.take import Channel, Clock, Motion, Take


def positions(take: Take) -> np.ndarray:
    return forward(take.rig, *take.motion.dense()).positions


def test_the_world_is_mirrored(walk: Path) -> None:
    take = read_bvh(walk).collect()
    partners = mirror_pairs(take.rig.names)
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
    assert "'foot_l' and 'arm_r' cannot change places" in first
    assert "'leg_l' and 'hips'" in first
    assert "'hips' hangs from no joint" in second
