"""What a SkelRoot skins, against UsdSkel's own baked points."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.cli import animtool
from support.skinned_rig import write_pair

from animtool.usd.checks import check_layer
from animtool.usd.checks import skinned_bounds as module
from animtool.usd.checks.skinned_bounds import SkinnedBounds, find_overhang
from animtool.validation.fixes.run import fix_copy

ROOT = "/pair/Rig"
TIMES = [float(t) for t in range(1, 10)]


def posed(path: Path, time: float) -> np.ndarray:
    """Return the bounds of the points that UsdSkel bakes, in the SkelRoot's space."""
    stage = Usd.Stage.Open(Usd.Stage.Open(str(path)).Flatten())
    root = stage.GetPrimAtPath(ROOT)
    queries = skinned_prims(stage)
    assert UsdSkel.BakeSkinning(UsdSkel.Root(root), Gf.Interval(time, time))
    cache = UsdGeom.XformCache(time)
    points = []
    for name in queries:
        prim = stage.GetPrimAtPath(name)
        matrix = np.array(cache.ComputeRelativeTransform(prim, root)[0])
        local = np.array(UsdGeom.PointBased(prim).GetPointsAttr().Get(time), float)
        points.append(local @ matrix[:3, :3] + matrix[3, :3])
    every = np.concatenate(points)
    return np.stack([every.min(axis=0), every.max(axis=0)])


def skinned_prims(stage: Usd.Stage) -> list[Sdf.Path]:
    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetPrimAtPath(ROOT))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    bindings = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    return [
        query.GetPrim().GetPath()
        for binding in bindings
        for query in binding.GetSkinningTargets()
    ]


@pytest.fixture(params=["linear", "dual_quaternion"])
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    clip = write_pair(tmp_path, request.param)
    done = animtool("bake", clip, "-o", tmp_path / "pair.usda")
    assert done.code == 0, done.stderr
    return tmp_path / "pair.usda"


def test_bounds_are_those_of_baked_points(pair: Path) -> None:
    stage = Usd.Stage.Open(str(pair))
    bounds = SkinnedBounds(stage.GetPrimAtPath(ROOT))
    for time in (1.0, 4.0, 7.0, 9.0):
        found = bounds.at_time(Usd.TimeCode(time))
        assert_allclose(found, posed(pair, time), atol=1e-4)


def test_the_largest_overhang_is_reported_and_mended(
    pair: Path, tmp_path: Path
) -> None:
    layer = Sdf.Layer.FindOrOpen(str(pair))
    # A little in one frame, and most in a later one.
    inset = {3.0: 0.5, 7.0: 4.0, 8.0: 1.0}
    for time in TIMES:
        low, high = posed(pair, time)
        high[1] -= inset.get(time, 0.0)
        value = Vt.Vec3fArray.FromNumpy(np.float32([low, high]))
        layer.SetTimeSample(f"{ROOT}.extent", time, value)
    layer.Save()
    (found,) = [fault for fault in check_layer(pair) if fault.where == f"{ROOT}.extent"]
    assert found.code == "USD251"
    number, when = re.findall(r"exceed it by (\S+) at time code (\d+)", found.message)[
        0
    ]
    assert float(number) == pytest.approx(4.0, rel=1e-3)
    assert when == "7"
    fixed = tmp_path / "fixed.usda"
    report = fix_copy(pair, fixed).report
    assert [str(fault) for fault in report.findings if fault.code == "USD251"] == []
    stage = Usd.Stage.Open(str(fixed))
    extent = stage.GetAttributeAtPath(f"{ROOT}.extent")
    for time in TIMES:
        low, high = np.array(extent.Get(time), float)
        points = posed(fixed, time)
        assert (points[0] >= low - 1e-5).all()
        assert (points[1] <= high + 1e-5).all()


def test_of_more_points_than_fit_some_samples_are_looked_at(
    pair: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Usd.Stage.Open(str(pair))
    root = stage.GetPrimAtPath(ROOT)
    nothing = np.zeros((1, 2, 3))
    worst, when, of_all = find_overhang(root, nothing, TIMES) or (0.0, 0.0, False)
    assert of_all
    assert worst == pytest.approx(np.abs(posed(pair, when)).max(), rel=1e-6)
    count = SkinnedBounds(root).point_count
    monkeypatch.setattr(module, "MAX_SKINNED_POINTS", 3 * count)
    some = find_overhang(root, nothing, TIMES)
    assert some is not None
    assert not some[2]
    assert some[0] <= worst
