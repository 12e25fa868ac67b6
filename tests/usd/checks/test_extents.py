"""Extents of long takes: all samples are compared, and USD is asked about few."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from support.cli import animtool

from animtool.usd.checks import check_layer, extents
from animtool.usd.checks.checked_stage import CheckedStage

FRAMES = 120
RIG = "/walk/Rig"


def baked(walk: Path, folder: Path, *options: str) -> Path:
    path = folder / "long.usda"
    frames = ("--range", f"1-{FRAMES}", "--fps", "120")
    done = animtool("bake", walk, "-o", path, "--bones", *frames, *options)
    assert done.code == 0, done.stderr
    return path


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list of the times that USD is asked about."""
    times: list[Any] = []
    computed = extents.computed_extent

    def count(bounded: Any, code: Any) -> Any:
        times.append(code)
        return computed(bounded, code)

    monkeypatch.setattr(extents, "computed_extent", count)
    return times


def sampled(path: Path) -> list[float]:
    return sorted(
        Sdf.Layer.FindOrOpen(str(path)).ListTimeSamplesForPath(f"{RIG}.extent")
    )


@pytest.mark.parametrize("options", [(), ("--sparse",)], ids=str)
def test_one_wrong_sample_of_many_is_found(
    options: tuple[str, ...], walk: Path, tmp_path: Path, asked: list[Any]
) -> None:
    path = baked(walk, tmp_path, *options)
    codes = sampled(path)
    assert len(codes) > extents.MAX_COMPUTED_SAMPLES
    assert check_layer(path) == []
    assert len(asked) < 20
    code = codes[len(codes) * 2 // 3]
    layer = Sdf.Layer.FindOrOpen(str(path))
    old = np.array(layer.QueryTimeSample(f"{RIG}.extent", code))
    old[1, 0] += 5
    moved = Vt.Vec3fArray.FromNumpy(old)
    layer.SetTimeSample(f"{RIG}.extent", code, moved)
    layer.Save()
    found = check_layer(path)
    assert [fault.code for fault in found] == ["USD251"]
    assert f"at time code {code:g}" in found[0].message
    assert found[0].where == f"{RIG}.extent"


def test_a_skeleton_that_is_placed_is_left_to_usd(
    walk: Path, tmp_path: Path, asked: list[Any]
) -> None:
    path = baked(walk, tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    stage = Usd.Stage.Open(layer)
    UsdGeom.Xformable(stage.GetPrimAtPath(f"{RIG}/Skel")).AddTranslateOp().Set(
        (9, 0, 0)
    )
    found = list(extents.check_extents(CheckedStage(stage)))
    assert [fault.code for fault in found] == ["USD251"]
    assert len(asked) >= extents.MAX_COMPUTED_SAMPLES
    assert "or more" in found[0].message


def test_the_largest_difference_is_named(walk: Path, tmp_path: Path) -> None:
    path = baked(walk, tmp_path)
    codes = sampled(path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    # More samples than USD is asked about, and the farthest off after these.
    for i, code in enumerate(codes[: extents.MAX_COMPUTED_SAMPLES + 20]):
        old = np.array(layer.QueryTimeSample(f"{RIG}.extent", code))
        old[1, 0] += 2.0 if i < extents.MAX_COMPUTED_SAMPLES + 10 else 7.0
        layer.SetTimeSample(f"{RIG}.extent", code, Vt.Vec3fArray.FromNumpy(old))
    layer.Save()
    (found,) = check_layer(path)
    assert found.code == "USD251"
    assert "off by 7 " in found.message
    assert (
        f"in {extents.MAX_COMPUTED_SAMPLES + 20} of {len(codes)} samples"
        in found.message
    )
    assert f"most at {codes[extents.MAX_COMPUTED_SAMPLES + 10]:g}" in found.message
