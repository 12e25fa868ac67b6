from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.edit.mirror import mirror, mirror_pairs
from animtool.errors import OptionError
from animtool.formats.bvh import read_bvh
from animtool.rig.kinematics import forward
from animtool.take import Take


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
