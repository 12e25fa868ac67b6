"""The fountain of embers: baked, valid, down the stairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/embers"


@pytest.mark.slow(1)
def test_embers_bounce_down_the_stairs(printed: Printed) -> None:
    command = "animtool bake samples/embers/embers.scene.yaml -o embers.usdc"
    output = printed(command) / "embers.usdc"
    stage = Usd.Stage.Open(str(output))
    points = UsdGeom.Points(stage.GetPrimAtPath("/embers/embers"))
    last = np.array(points.GetPointsAttr().Get(96))
    assert 300 < len(last) < 1500
    # Nobody is in a step, and some are on each.
    for i, middle in enumerate((0.575, 0.925, 1.275, 1.625)):
        top = 1.28 - 0.32 * i
        over = (np.abs(last[:, 0] - middle) < 0.17) & (np.abs(last[:, 2]) < 0.99)
        assert over.any()
        assert last[over, 1].min() >= top - 1e-5
    assert list(validate([output, FOLDER / "embers.scene.yaml"])) == []
