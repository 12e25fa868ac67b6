"""Point caches of the rigs of the data folder, against UsdSkel's own deforming."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from support.cli import animtool
from support.data import data_files
from support.point_caches import bindings, layered, skinned_points, world_points
from support.usd import validation_errors

# What float32 joints, weights and points leave, as a share of the size.
TOLERANCE = 3e-6

every_rig = pytest.mark.parametrize("path", data_files("rigs", "*.usda"))


def codes_of(stage: Usd.Stage) -> list[float]:
    return np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1).tolist()


def near(points: np.ndarray, truth: np.ndarray) -> bool:
    return bool(np.abs(points - truth).max() <= TOLERANCE * np.abs(truth).max())


@every_rig
def test_a_stage_has_the_points_that_usdskel_makes(path: Path, tmp_path: Path) -> None:
    done = animtool("bake", path, "-o", tmp_path / "cache.usdc", "--deform")
    assert done.code == 0, done.stderr
    stage = Usd.Stage.Open(str(tmp_path / "cache.usdc"))
    truth = skinned_points(path, codes_of(Usd.Stage.Open(str(path))))
    assert codes_of(stage) == codes_of(Usd.Stage.Open(str(path)))
    made = {p.GetName(): p for p in stage.Traverse() if p.GetTypeName() == "Mesh"}
    assert set(made) == {name.rpartition("/")[2] for name in truth}
    for name, points in truth.items():
        prim = made[name.rpartition("/")[2]]
        found = world_points(stage, str(prim.GetPath()), codes_of(stage))
        assert near(found, points)
    assert not bindings(stage)
    assert not validation_errors(stage)


@every_rig
def test_a_layer_over_the_rig_shows_the_same(path: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache.usdc"
    done = animtool("bake", path, "-o", cache, "--rig-layer", path, "--deform")
    assert done.code == 0, done.stderr
    stage = Usd.Stage.Open(str(layered(tmp_path, cache, path)))
    truth = skinned_points(path, codes_of(stage))
    for name, points in truth.items():
        assert near(world_points(stage, name, codes_of(stage)), points)
    assert not bindings(stage)
    # UsdSkel.BakeSkinning leaves the same: bindings that no SkelRoot is above.
    left = "usdSkelValidators:SkelBindingApiValidator.InvalidSkelBindingAPIApply"
    assert all(error.startswith(left) for error in validation_errors(stage))
    assert not validation_errors(Usd.Stage.Open(str(cache)))
