"""Ropes, cloth and volumes of scenes among meshes of USD files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Usd, UsdGeom, Vt

from animtool import bake
from animtool.core.array_types import FloatArray
from animtool.core.errors import FormatError
from animtool.scene.file.read import load_scene
from tests.support.balls import box_mesh

SCENE = "scene: animtool/1\nfps: 24\nrange: [1, %d]\nsystems:\n%s"
OUTPUT = "output: {file: out.usdc}\n"
CLOTH = """\
- cloth:
    corner: [-0.2, %s, 0.2]
    across: [0.4, 0, 0]
    up: [0, 0, -0.4]
    resolution: [9, 9]
    mass: 0.05
    drag: 2
    radius: 0.01
    springs: {structural: {stiffness: 200, ratio: 0.3}, bend: {stiffness: 1}}
    meshes: [{file: props.usda, prim: %s, friction: 0.8%s}]
"""


def draw(
    stage: Usd.Stage, prim: str, points: FloatArray, faces: object
) -> UsdGeom.Mesh:
    corners = np.array(faces)
    mesh = UsdGeom.Mesh.Define(stage, prim)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    counts = np.full(len(corners), corners.shape[1], np.int32)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
    indices = corners.ravel().astype(np.int32)
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    return mesh


@pytest.fixture
def props(tmp_path: Path) -> Usd.Stage:
    """A crate, a tray that is lifted, and stairs."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "props.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(24)
    draw(stage, "/crate", *box_mesh(0.6))
    flat = np.array([[-1.0, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]])
    tray = draw(stage, "/tray", flat, [[0, 1, 2, 3]])
    for code in (1, 25):
        lifted = np.add(flat, [0, code / 24 - 1 / 24, 0]).astype(np.float32)
        tray.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(lifted), code)
    steps = [[x, y, z] for z in (1, -1) for x, y in STEPS]
    count = len(STEPS)
    treads = [[k, k + 1, count + k + 1, count + k] for k in range(count - 1)]
    draw(stage, "/stairs", np.array(steps, float), treads)
    stage.Save()
    return stage


STEPS = [(0.0, 0.6), (0.3, 0.6), (0.3, 0.3), (0.6, 0.3), (0.6, 0.0), (2.0, 0.0)]


def scene(folder: Path, frames: int, systems: str) -> Path:
    path = folder / "shot.scene.yaml"
    path.write_text(SCENE % (frames, systems) + OUTPUT, "utf-8")
    return path


def points(folder: Path, prim: str, frame: int) -> FloatArray:
    made = Usd.Stage.Open(str(folder / "out.usdc"))
    found = UsdGeom.PointBased.Get(made, prim).GetPointsAttr().Get(frame)
    return np.array(found, np.float64)


@pytest.mark.usefixtures("props")
@pytest.mark.parametrize("closed", ["", ", closed: true"])
def test_cloth_comes_to_rest_on_a_prop(tmp_path: Path, closed: str) -> None:
    path = scene(tmp_path, 36, CLOTH % (0.4, "/crate", closed))
    bake(path, tmp_path / "out.usdc")
    # The corners of an open one are round.
    assert_allclose(points(tmp_path, "/shot/cloth", 36)[:, 1], 0.315, atol=2.5e-3)
    setup = load_scene(path).systems[0].setup
    assert tmp_path / "props.usda" in setup.files
    assert "/crate" in setup.reads


@pytest.mark.usefixtures("props")
def test_cloth_is_lifted_by_a_mesh_whose_points_move(tmp_path: Path) -> None:
    path = scene(tmp_path, 25, CLOTH % (0.015, "/tray", ""))
    bake(path, tmp_path / "out.usdc")
    for frame in (1, 13, 25):
        heights = points(tmp_path, "/shot/cloth", frame)[:, 1]
        assert_allclose(heights, (frame - 1) / 24 + 0.015, atol=1e-4)


@pytest.mark.usefixtures("props")
def test_a_rope_lies_on_stairs(tmp_path: Path) -> None:
    rope = """\
- rope:
    from: [0.05, 0.65, 0]
    to: [0.9, 0.65, 0.02]
    count: 60
    mass: 0.1
    drag: 1
    radius: 0.01
    springs: {structural: {stiffness: 2000, ratio: 0.3}}
    meshes: [{file: props.usda, prim: /stairs, friction: 0.5, radius: 0.002}]
"""
    path = scene(tmp_path, 36, rope)
    report = bake(path, tmp_path / "out.usdc")
    line = points(tmp_path, "/shot/rope", 36)
    heights = np.select([line[:, 0] < 0.3, line[:, 0] < 0.6], [0.6, 0.3], 0.0)
    assert (line[:, 1] - heights).min() > 0.01
    assert (line[:, 1] < 0.1).any()
    assert not [fault for fault in report.notices if fault.code == "SIM123"]


@pytest.mark.usefixtures("props")
@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("{file: props.usda, prim: /crat}", "SIM051"),
        ("{file: props.usda, prim: /crate, radius: 0}", "SIM020"),
        ("{file: props.usda, prim: /crate, friction: -1}", "SIM020"),
        ("{file: no.usda, prim: /crate}", "DOC015"),
    ],
)
def test_meshes_that_are_none(tmp_path: Path, entry: str, expected: str) -> None:
    text = CLOTH % (0.4, "/crate", "")
    text = text[: text.index("    meshes")] + f"    meshes: [{entry}]\n"
    with pytest.raises(FormatError) as error:
        load_scene(scene(tmp_path, 2, text))
    assert [fault.code for fault in error.value.faults] == [expected]


def test_a_mesh_keeps_its_points(tmp_path: Path, props: Usd.Stage) -> None:
    tray = props.GetPrimAtPath("/tray").GetAttribute("points")
    tray.Set(Vt.Vec3fArray(5), 13)
    props.Save()
    path = scene(tmp_path, 25, CLOTH % (0.1, "/tray", ""))
    with pytest.raises(FormatError) as error:
        bake(path, tmp_path / "out.usdc")
    assert error.value.code == "SIM051"
    assert not (tmp_path / "out.usdc").exists()
