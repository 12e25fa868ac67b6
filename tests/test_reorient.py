from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.bvh import random_rows, small_bvh

from animtool.formats.bvh import read_bvh
from animtool.reorient import reorient
from animtool.rig.kinematics import forward, rest_world
from animtool.take import Take
from animtool.units import UpAxis


def positions(take: Take) -> np.ndarray:
    motion = take.motion
    return forward(
        take.rig, motion.translations.dense(), motion.rotations.dense()
    ).positions


@pytest.mark.parametrize("static", [False, True])
def test_the_world_stands_up(tmp_path: Path, static: bool) -> None:
    path = tmp_path / "a.bvh"
    rows = random_rows(6)
    path.write_text(small_bvh(rows[:1].repeat(6, 0) if static else rows))
    before = read_bvh(path).collect()
    after = reorient(read_bvh(path), UpAxis.Z).collect()
    x, y, z = np.moveaxis(positions(before), -1, 0)
    assert_allclose(positions(after), np.stack([x, -z, y], axis=-1), atol=1e-15)
    assert after.rig.up is UpAxis.Z
    x, y, z = np.moveaxis(rest_world(before.rig).positions, -1, 0)
    assert_allclose(
        rest_world(after.rig).positions, np.stack([x, -z, y], axis=-1), atol=1e-15
    )


def test_nothing_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(small_bvh(random_rows(2)))
    stream = read_bvh(path)
    assert reorient(stream, UpAxis.Y) is stream
