"""The flag: baked, valid, held by its pole, flying and fluttering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.validation.run import validate

pytestmark = pytest.mark.slow(seconds=4)

FOLDER = Path(__file__).parents[2] / "samples/flag"
COLUMNS, ROWS, FRAMES = 34, 23, 48


@pytest.fixture(scope="module")
def baked(printed: Printed) -> Path:
    command = "animtool bake samples/flag/flag.scene.yaml -o flag.usdc"
    return printed(command) / "flag.usdc"


@pytest.fixture(scope="module")
def points(baked: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(baked))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/flag/flag"))
    rows = [mesh.GetPointsAttr().Get(frame) for frame in range(1, FRAMES + 1)]
    return np.array(rows, np.float64).reshape(FRAMES, ROWS, COLUMNS, 3)


def test_it_is_valid(baked: Path) -> None:
    assert list(validate([baked, FOLDER / "flag.scene.yaml"])) == []


def test_the_pole_holds_it(points: np.ndarray) -> None:
    assert np.ptp(points[:, :, 0], axis=0).max() == 0
    np.testing.assert_allclose(points[0, :, 0, 0], 0.02, atol=1e-7)


def test_it_flies_and_flutters(points: np.ndarray) -> None:
    free = points[:, :, -1]
    assert free[..., 0].min() > 1.2
    # To and fro, and not all of the free side at once.
    assert free[..., 2].std(axis=0).min() > 0.1
    assert np.abs(np.diff(free[..., 2], axis=0)).max() > 0.02
    assert np.ptp(free[..., 2], axis=1).max() > 0.05


def test_it_keeps_its_size(points: np.ndarray) -> None:
    side = np.hypot(1.42, 0.45) / (COLUMNS - 1)
    across = np.linalg.norm(np.diff(points, axis=2), axis=-1)
    assert across.max() < 1.15 * side
