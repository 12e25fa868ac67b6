from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.edit.root_motion import extract_root, recompose_root
from animtool.formats.bvh import read_bvh
from animtool.rig.kinematics import forward


def test_the_world_stays_and_it_can_be_undone(walk: Path) -> None:
    take = read_bvh(walk).collect()
    found = extract_root(take)
    before = forward(take.rig, *take.motion.dense())
    after = forward(found.rig, *found.motion.dense())
    assert np.abs(after.positions[:, 1:] - before.positions).max() < 1e-12
    assert np.abs(after.linear[:, 1:] - before.linear).max() < 1e-12
    back = recompose_root(found)
    assert back.rig == take.rig
    again = forward(back.rig, *back.motion.dense())
    assert np.abs(again.positions - before.positions).max() < 1e-12
