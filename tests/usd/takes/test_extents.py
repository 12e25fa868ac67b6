"""Extents as USD computes them, and caches that readers find without a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.cli import animtool

ROOT = Path(__file__).parents[3]
WALK = ROOT / "samples/walk/walk.bvh"
STRIDE = ROOT / "samples/stride/stride.clip.yaml"
SHEET = """\
scene: animtool/1
fps: 24
range: [1, 6]
systems:
- cloth:
    name: flag
    mass: 0.2
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 0, 1]
    resolution: [4, 4]
    springs:
      structural: {stiffness: 80, ratio: 0.1}
output: {file: flag.usdc}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file a form, each small."""
    folder = tmp_path_factory.mktemp("forms")
    few = ("--range", "1-8")

    def bake(*arguments: object) -> None:
        done = animtool("bake", *arguments, cwd=folder)
        assert done.code == 0, done.stderr

    bake(WALK, "-o", "stage.usdc", *few)
    bake(WALK, "-o", "bones.usdc", "--bones", *few)
    bake(WALK, "-o", "split.usdc", "--split", *few)
    bake(WALK, "stage.usdc", "-o", "library.usdc")
    bake(STRIDE, "-o", "skinned.usdc", *few)
    bake(STRIDE, "-o", "inches.usdc", "--to-units", "in", "--to-up", "Z", *few)
    bake(STRIDE, "-o", "points.usdc", "--deform", *few)
    bake(STRIDE, "-o", "chunks.usdc", "--deform", "--chunk", "3", *few)
    return folder


FORMS = ["stage", "bones", "split", "library", "skinned", "inches", "points", "chunks"]


def boundables(stage: Any) -> Iterator[Any]:
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Boundable) and prim.GetAttribute("extent").HasValue():
            yield UsdGeom.Boundable(prim)


@pytest.mark.parametrize("form", FORMS)
def test_extents_are_those_of_the_plugin_to_the_last_bit(made: Path, form: str) -> None:
    stage = Usd.Stage.Open(str(made / f"{form}.usdc"))
    count = 0
    for bounded in boundables(stage):
        attr = bounded.GetExtentAttr()
        times = [Usd.TimeCode(time) for time in attr.GetTimeSamples()]
        for time in times or [Usd.TimeCode.EarliestTime()]:
            computed = UsdGeom.Boundable.ComputeExtentFromPlugins(bounded, time)
            assert attr.Get(time) == computed, (bounded.GetPath(), time)
            count += 1
    assert count


def test_bones_share_no_point_and_have_unit_normals(made: Path) -> None:
    stage = Usd.Stage.Open(str(made / "bones.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/walk/Rig/Bones"))
    points = np.array(mesh.GetPointsAttr().Get())
    assert len(np.unique(points, axis=0)) == len(points)
    normals = np.array(mesh.GetNormalsAttr().Get(), float)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert mesh.GetNormalsInterpolation() == "vertex"


@pytest.mark.parametrize("form", ["points", "chunks"])
def test_a_cache_has_a_default_mesh_and_its_own_samples(made: Path, form: str) -> None:
    stage = Usd.Stage.Open(str(made / f"{form}.usdc"))
    meshes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    moving = [mesh for mesh in meshes if mesh.GetPointsAttr().GetTimeSamples()]
    assert moving
    for mesh in moving:
        for attr in (mesh.GetPointsAttr(), mesh.GetNormalsAttr()):
            times = attr.GetTimeSamples()
            assert len(times) == 8
            assert attr.Get() == attr.Get(times[0])
            assert attr.Get(times[-1]) != attr.Get(times[0])
        assert not mesh.GetVelocitiesAttr().HasAuthoredValue()


def test_clips_win_over_the_defaults_of_their_first_chunk(made: Path) -> None:
    one = Usd.Stage.Open(str(made / "points.usdc"))
    other = Usd.Stage.Open(str(made / "chunks.usdc"))
    for prim in one.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        attr, chunked = (
            UsdGeom.Mesh(stage.GetPrimAtPath(prim.GetPath())).GetPointsAttr()
            for stage in (one, other)
        )
        for time in attr.GetTimeSamples():
            assert attr.Get(time) == chunked.Get(time)


def test_cloth_has_normals_and_a_default(tmp_path: Path) -> None:
    (tmp_path / "flag.scene.yaml").write_text(SHEET, "utf-8")
    for output, more in (("flag.usdc", ()), ("chunks.usdc", ("--chunk", "2"))):
        done = animtool("bake", "flag.scene.yaml", "-o", output, *more, cwd=tmp_path)
        assert done.code == 0, done.stderr
        stage = Usd.Stage.Open(str(tmp_path / output))
        [mesh] = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
        assert mesh.GetNormalsInterpolation() == "vertex"
        points, normals = mesh.GetPointsAttr(), mesh.GetNormalsAttr()
        assert len(points.GetTimeSamples()) == 6
        assert points.Get() == points.Get(1)
        assert points.Get(6) != points.Get(1)
        for time in normals.GetTimeSamples():
            values = np.array(normals.Get(time), float)
            assert np.allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
        assert np.allclose(np.abs(np.array(normals.Get())), [0, 1, 0], atol=1e-3)
