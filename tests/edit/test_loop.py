from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.edit.loop import loop
from animtool.formats.bvh import read_bvh
from animtool.rig.kinematics import forward


def test_the_seam_is_no_step(walk: Path) -> None:
    take = read_bvh(walk).collect()
    found = loop(take, repeats=3)
    count = take.clock.count - 1
    assert found.clock.count == 3 * count
    world = forward(found.rig, *found.motion.dense()).positions
    steps = np.linalg.norm(np.diff(world, axis=0), axis=-1).max(axis=1)
    seams = steps[[count - 1, 2 * count - 1]]
    assert seams.max() <= 1.1 * np.delete(steps, [count - 1, 2 * count - 1]).max()
