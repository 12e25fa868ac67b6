"""The sheets of four sets of springs: baked, valid, different as the README says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.validation.run import validate

pytestmark = pytest.mark.slow(seconds=2)

FOLDER = Path(__file__).parents[2] / "samples/sheets"
KINDS = ("hung", "draped")
SIDE = 1 / 24


@pytest.fixture(scope="module")
def baked(printed: Printed) -> Path:
    command = "animtool bake samples/sheets/sheets.scene.yaml -o sheets.usdc"
    return printed(command) / "sheets.usdc"


def last(baked: Path, name: str) -> np.ndarray:
    """Return a sheet at its last frame ``(rows, columns, 3)``."""
    stage = Usd.Stage.Open(str(baked))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/sheets/{name}"))
    return np.array(mesh.GetPointsAttr().Get(96), np.float64).reshape(25, 25, 3)


def askew(points: np.ndarray) -> float:
    """Return the mean cosine between the sides of cells."""
    rows, columns = np.diff(points, axis=1)[:-1], np.diff(points, axis=0)[:, :-1]
    lengths = np.linalg.norm(rows, axis=-1) * np.linalg.norm(columns, axis=-1)
    return float((np.abs((rows * columns).sum(-1)) / lengths).mean())


def diagonals(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths of both over those at rest."""
    rising = points[1:, 1:] - points[:-1, :-1]
    falling = points[1:, :-1] - points[:-1, 1:]
    rest = SIDE * np.sqrt(2)
    return tuple(np.linalg.norm(each, axis=-1) / rest for each in (rising, falling))


def sharpest(points: np.ndarray) -> float:
    """Return how sharply the sheet is folded across, from 0 to 2."""
    turns = points[:, 2:] - 2 * points[:, 1:-1] + points[:, :-2]
    return float(np.linalg.norm(turns, axis=-1).max() / SIDE)


def test_they_are_valid(baked: Path) -> None:
    assert list(validate([baked, FOLDER / "sheets.scene.yaml"])) == []


@pytest.mark.parametrize("kind", KINDS)
def test_structural_springs_alone_are_a_net(baked: Path, kind: str) -> None:
    net = last(baked, f"{kind}_structural")
    assert askew(net) > 4 * askew(last(baked, f"{kind}_one_diagonal"))
    for lengths in diagonals(net):
        assert lengths.min() < 0.3
        assert lengths.max() > 1.35


@pytest.mark.parametrize("kind", KINDS)
def test_one_diagonal_holds_one_way(baked: Path, kind: str) -> None:
    held, free = diagonals(last(baked, f"{kind}_one_diagonal"))
    assert held.min() > 0.9
    assert free.min() < 0.4
    assert free.std() > 5 * held.std()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("springs", ["both_diagonals", "bend"])
def test_both_diagonals_hold_both_ways(baked: Path, kind: str, springs: str) -> None:
    points = last(baked, f"{kind}_{springs}")
    assert askew(points) < 0.02
    for lengths in diagonals(points):
        assert lengths.min() > 0.9
        assert lengths.max() < 1.1


@pytest.mark.parametrize("kind", KINDS)
def test_bend_springs_make_folds_round(baked: Path, kind: str) -> None:
    assert sharpest(last(baked, f"{kind}_both_diagonals")) > 1.4
    assert sharpest(last(baked, f"{kind}_bend")) < 1.2


def test_none_is_in_its_table(baked: Path) -> None:
    for k, springs in enumerate(
        ("structural", "one_diagonal", "both_diagonals", "bend")
    ):
        points = last(baked, f"draped_{springs}") - [1.6 * k, 0, 2]
        inside = (np.abs(points[..., [0, 2]]) < 0.249).all(-1) & (points[..., 1] < 0.6)
        assert not inside.any()
