"""The flock around a tower: baked, valid, clear of the tower, split by the hawk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/murmuration"


@pytest.mark.slow(seconds=2)
def test_starlings_flee_the_hawk_around_the_tower(printed: Printed) -> None:
    command = "animtool bake samples/murmuration/murmuration.scene.yaml"
    output = printed(f"{command} -o murmuration.usdc") / "murmuration.usdc"
    stage = Usd.Stage.Open(str(output))
    birds = UsdGeom.PointInstancer(stage.GetPrimAtPath("/murmuration/birds"))
    assert len(birds.GetPrototypesRel().GetTargets()) == 8
    shown, gaps = set(), []
    for frame in range(1, 73):
        points = np.array(birds.GetPositionsAttr().Get(frame), np.float64)
        shown |= set(birds.GetProtoIndicesAttr().Get(frame))
        axis = points.copy()
        axis[:, 1] -= np.clip(axis[:, 1], -1, 13)
        assert np.linalg.norm(axis, axis=1).min() > 2.2 - 1e-5
        assert points[:, 1].min() > 0.2 - 1e-5
        gaps.append(np.linalg.norm(points[:-1] - points[-1], axis=1).min())
    assert shown == set(range(8))
    # It comes among them, and nobody is caught.
    assert 0.5 < min(gaps) < 6
    assert (
        list(validate([output, *FOLDER.glob("*.usda"), *FOLDER.glob("*.yaml")])) == []
    )
