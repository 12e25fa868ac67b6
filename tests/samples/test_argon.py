"""The crystal of argon: baked, valid, in rows at first, molten at last."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from scipy.spatial import cKDTree
from support.printed import Printed

from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/argon"


@pytest.mark.slow(1)
def test_argon_melts(printed: Printed) -> None:
    command = "animtool bake samples/argon/argon.scene.yaml -o argon.usdc"
    output = printed(command) / "argon.usdc"
    stage = Usd.Stage.Open(str(output))
    atoms = UsdGeom.Points(stage.GetPrimAtPath("/argon/atoms"))
    frames = {
        k: np.array(atoms.GetPointsAttr().Get(k), np.float64) for k in (1, 40, 120)
    }
    for points in frames.values():
        assert points.shape == (500, 3)
        assert (np.abs(points) <= 2.2 + 1e-6).all()
    # Who is among the twelve nearest of each stays in a crystal, and changes in a melt.
    near = {k: cKDTree(points).query(points, 13)[1] for k, points in frames.items()}

    def kept(frame: int) -> float:
        both = zip(near[1], near[frame], strict=True)
        return float(np.mean([len({*a} & {*b}) for a, b in both])) / 13

    assert kept(40) > 0.8
    assert kept(120) < 0.6
    assert list(validate([output, FOLDER / "argon.scene.yaml"])) == []
