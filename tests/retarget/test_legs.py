"""Legs of a target: how high its ankles stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from animtool import Rig, open_source
from animtool.retarget import map_joints
from animtool.retarget.legs import _planted_ankle_height
from animtool.retarget.motion import retarget_take
from animtool.rig.kinematics import rest_world


@pytest.mark.parametrize("lifted", [0.0, 0.05, -0.05])
def test_ankles_of_a_rig_that_stands_on_the_ground_are_as_high_as_at_rest(
    root: Path, lifted: float
) -> None:
    """Whatever the source stands on, and where its ground is a little off zero."""
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    rig = Rig.load(root / "rigs/biped/biped.rig.yaml")
    first = rig.joints[0]
    place = np.add(first.translation, [0.0, lifted, 0.0])
    joints = (replace(first, translation=tuple(place.tolist())), *rig.joints[1:])
    target = replace(rig, joints=joints, meshes=())
    transfer = retarget_take(walk, target, map_joints(walk.rig, target)).transfer
    rest = rest_world(target).positions[0]
    for side in "lr":
        ankle = float(rest[target.index(f"ankle_{side}"), 1])
        assert 0 < ankle < 0.2
        assert _planted_ankle_height(transfer, side, 0.3, 1) == pytest.approx(ankle)
