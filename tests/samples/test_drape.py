"""The cloth over a vase: baked, valid, outside the mesh that it fell on."""

from __future__ import annotations

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.printed import Printed

from animtool.maths.faces import triangulate
from animtool.sim.colliders import Collider, Colliders, Mesh
from animtool.validation.run import validate

FOLDER = Path(__file__).parents[2] / "samples/drape"
FRAMES = 48


@pytest.fixture(scope="module")
def baked(printed: Printed) -> Path:
    command = "animtool bake samples/drape/drape.scene.yaml -o drape.usdc"
    return printed(command) / "drape.usdc"


@pytest.fixture(scope="module")
def points(baked: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(baked))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/drape/cloth"))
    rows = [mesh.GetPointsAttr().Get(frame) for frame in range(1, FRAMES + 1)]
    return np.array(rows, np.float64)


@pytest.mark.slow(seconds=6)
def test_it_is_valid(baked: Path) -> None:
    files = [baked, FOLDER / "drape.scene.yaml", FOLDER / "vase.usda"]
    assert list(validate(files)) == []


@pytest.mark.slow(seconds=6)
def test_it_stays_outside_the_vase(points: np.ndarray) -> None:
    stage = Usd.Stage.Open(str(FOLDER / "vase.usda"))
    vase = UsdGeom.Mesh(stage.GetPrimAtPath("/vase/body"))
    places = np.array(vase.GetPointsAttr().Get(), np.float64)
    counts = np.array(vase.GetFaceVertexCountsAttr().Get())
    faces = triangulate(counts, np.array(vase.GetFaceVertexIndicesAttr().Get()))
    seen = Colliders([Collider(Mesh(places, faces, closed=True))])
    for frame in range(FRAMES):
        assert seen.sample(points[frame], 0.0).distances.min() > 0.006 - 1e-5
    assert (seen.sample(points[-1], 0.0).distances < 0.007).sum() > 50


@pytest.mark.slow(seconds=6)
def test_it_comes_to_rest_on_it(points: np.ndarray) -> None:
    assert points[-1, :, 1].max() == pytest.approx(0.635 + 0.006, abs=1e-3)
    top = points[-1, :, 1] > 0.6
    assert np.abs(points[-1] - points[-13])[top].max() < 0.02
    # It hangs down on all sides.
    below = points[-1][points[-1, :, 1] < 0.35]
    angles = np.arctan2(below[:, 2], below[:, 0])
    assert np.diff(np.sort(angles)).max() < np.pi / 3


def test_the_vase_is_as_its_script_makes_it(tmp_path: Path) -> None:
    run_path(str(FOLDER / "make_vase.py"))["main"](tmp_path / "vase.usda")
    one, other = (path / "vase.usda" for path in (tmp_path, FOLDER))
    assert one.read_text("utf-8") == other.read_text("utf-8")
