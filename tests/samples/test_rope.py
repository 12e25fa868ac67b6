"""The rope of the trolley: baked, valid, hung from the prop, stopped by the rail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed
from support.props import prop_matrices

from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/rope"
FRAMES = range(1, 98)
LENGTH, RAIL = 2.2, np.array([0.4, 2.0])


@pytest.fixture(scope="module")
def baked(printed: Printed) -> Path:
    command = "animtool bake samples/rope/rope.scene.yaml -o rope.usdc"
    return printed(command) / "rope.usdc"


@pytest.fixture(scope="module")
def points(baked: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(baked))
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath("/rope/rope"))
    rows = [curves.GetPointsAttr().Get(frame) for frame in FRAMES]
    return np.array(rows, np.float64)


def test_it_is_valid(baked: Path) -> None:
    assert list(validate([baked, FOLDER / "rope.scene.yaml"])) == []


def test_it_hangs_from_the_trolley(points: np.ndarray) -> None:
    stage = Usd.Stage.Open(str(FOLDER / "crane.usda"))
    trolley = prop_matrices(stage, "/World/trolley", list(FRAMES))[:, 3, :3]
    assert np.ptp(trolley[:, 0]) > 1.5
    np.testing.assert_allclose(points[:, 0], trolley, atol=1e-6)


def test_it_is_not_drawn_out_by_the_lantern(points: np.ndarray) -> None:
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert lengths.max() < 1.01 * LENGTH / 60


def test_it_swings_about_the_rail(points: np.ndarray) -> None:
    away = np.linalg.norm(points[..., :2] - RAIL, axis=-1)
    assert 0.062 - 1e-5 < away.min() < 0.064
    assert np.abs(points[..., 2]).max() < 1e-9
    farthest = points[points[:, -1, 0].argmax()]
    upper, lower = farthest[10] - farthest[0], farthest[-1] - farthest[-11]
    cosine = upper @ lower / np.linalg.norm(upper) / np.linalg.norm(lower)
    assert np.degrees(np.arccos(cosine)) > 25
