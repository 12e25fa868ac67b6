"""A long animation whose samples drift, repaired by the command and compared."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from support.clean_layer import ANIMATION, ROOT, make_layer
from support.cli import animtool

FRAMES = 3000
DRIFT = 5.21e-8


def drifting(path: Path) -> Path:
    """Write the animation with sample times that an exporter added up."""
    make_layer(path, FRAMES, mesh=False)
    layer = Sdf.Layer.FindOrOpen(str(path))
    for attribute in (f"{ANIMATION}.rotations", f"{ROOT}.extent"):
        codes = layer.ListTimeSamplesForPath(attribute)
        values = [layer.QueryTimeSample(attribute, code) for code in codes]
        with Sdf.ChangeBlock():
            for code in codes:
                layer.EraseTimeSample(attribute, code)
            for i, value in enumerate(values, 1):
                layer.SetTimeSample(attribute, codes[0] * DRIFT * i + i, value)
    layer.Save()
    return path


@pytest.mark.slow
def test_drifting_samples_are_on_their_frames_again(tmp_path: Path) -> None:
    clean = make_layer(tmp_path / "clean.usdc", FRAMES, mesh=False)
    path, new = drifting(tmp_path / "drifting.usdc"), tmp_path / "new.usdc"
    before = path.read_bytes()
    assert "MOT216" in animtool("validate", path).stdout
    done = animtool("validate", path, "--fix", "-o", new, "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert [entry["code"] for entry in report["mended"]] == ["MOT216"]
    assert f"{2 * FRAMES} samples" in report["mended"][0]["done"]
    assert report["findings"] == []
    assert path.read_bytes() == before
    stages = [Usd.Stage.Open(str(file)) for file in (clean, new)]
    for attribute in (f"{ANIMATION}.rotations", f"{ROOT}.extent"):
        expected, found = (stage.GetAttributeAtPath(attribute) for stage in stages)
        codes = expected.GetTimeSamples()
        assert found.GetTimeSamples() == codes
        apart = [
            np.abs(np.array(expected.Get(code)) - np.array(found.Get(code))).max()
            for code in codes
        ]
        assert max(apart) <= 1e-6
    root = UsdGeom.Boundable(stages[1].GetPrimAtPath(ROOT))
    for code in (1, FRAMES // 2, FRAMES):
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(root, code)
        assert root.GetExtentAttr().Get(code) == computed
    same = animtool("diff", clean, new)
    assert same.code == 0, same.stdout
