"""Every sample whose rig has meshes, deformed: as UsdSkel bakes the skinned stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.point_caches import skinned_points, world_points
from support.usd import open_stage, validation_errors

from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import strands_of, surfaces_of

ROOT = Path(__file__).parents[2]
SAMPLES = {
    "stride": "rigs/biped/biped.rig.yaml",
    "speech": "rigs/head/head.rig.yaml",
}
# Of the rig's size: float32 quaternions, halves and matrices down a chain.
TOLERANCE = 3e-6
FRAMES = 5


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_points_are_those_of_usdskel(name: str, tmp_path: Path) -> None:
    clip = ROOT / f"samples/{name}/{name}.clip.yaml"
    skinned, cache = tmp_path / "skinned.usdc", tmp_path / "cache.usdc"
    frames = ["--range", "1-24x5"]
    assert animtool("bake", clip, "-o", skinned, *frames).code == 0
    done = animtool("bake", clip, "-o", cache, "--deform", *frames)
    assert done.code == 0, done.stderr
    stage = open_stage(cache)
    assert validation_errors(stage) == []
    codes = [1.0 + 5 * i for i in range(FRAMES)]
    expected = skinned_points(skinned, codes)
    rig = Rig.load(ROOT / SAMPLES[name])
    meshes = surfaces_of(rig)
    assert len(expected) == len(meshes) + len(strands_of(rig))
    size = max(float(np.ptp(mesh.points, axis=0).max()) for mesh in meshes)
    for path, points in expected.items():
        found = world_points(stage, path, codes)
        assert np.abs(found - points).max() <= TOLERANCE * size
        assert np.ptp(points, axis=0).max() > 1e-3, "it moves"
