"""The two galaxies: baked, valid, drawn into tails, what stays kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/galaxies"


@pytest.mark.slow(seconds=5)
def test_two_galaxies_meet_and_draw_out_tails(printed: Printed) -> None:
    command = "animtool bake samples/galaxies/galaxies.scene.yaml -o galaxies.usdc"
    output = printed(command) / "galaxies.usdc"
    stage = Usd.Stage.Open(str(output))
    stars = UsdGeom.Points(stage.GetPrimAtPath("/galaxies/stars"))
    species = UsdGeom.PrimvarsAPI(stars).GetPrimvar("species")
    whose = np.array(species.Get(1))
    assert (whose == 0).sum() == 1600
    assert (whose == 1).sum() == 1100

    def apart_and_wide(frame: int) -> tuple[float, np.ndarray]:
        points = np.array(stars.GetPointsAttr().Get(frame), np.float64)
        middles = [np.median(points[whose == k], axis=0) for k in (0, 1)]
        around = np.linalg.norm(points - np.take(middles, whose, axis=0), axis=1)
        # Those are in tails that are farther out than discs reach.
        wide = np.array([(around[whose == k] > 4).mean() for k in (0, 1)])
        return float(np.linalg.norm(middles[0] - middles[1])), wide

    apart, wide = apart_and_wide(1)
    assert 6.9 < apart < 7.1
    assert (wide < 0.02).all()
    nearest = min(apart_and_wide(frame)[0] for frame in range(20, 40, 2))
    assert 0.5 < nearest < 2.0
    assert (apart_and_wide(120)[1] > 0.05).all()
    assert list(validate([output, FOLDER / "galaxies.scene.yaml"])) == []
