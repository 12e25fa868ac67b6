"""The figure in FBX: the walk of the samples by other names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.rig.kinematics import forward_kinematics
from animtool.scene.sources.open import open_source


def test_the_figure_walks_as_the_walk_does(root: Path) -> None:
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    figure = open_source(root / "samples/figure/figure.fbx").collect()
    assert len(figure.rig.names) == len(walk.rig.names) == 21
    places = forward_kinematics(walk.rig, *walk.motion.dense()).positions
    theirs = forward_kinematics(figure.rig, *figure.motion.dense()).positions
    # Turns are written in six digits, and curves hold float32.
    assert np.abs(places - theirs).max() <= 1e-5 * np.ptp(places)
