"""Colliders and emitters that turn, go with prims of USD files, and change shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, Vt
from support.faults import raises

from animtool import bake
from animtool.core.errors import AnimtoolError, FormatError
from animtool.maths import so3
from animtool.scene.file.read import load_scene
from animtool.scene.systems.surroundings import animated_surface
from animtool.sim.colliders import Poses
from animtool.systems.framework.fields import MovingMeshModel

HEAD = "scene: animtool/1\nfps: 24\nrange: [1, 25]\noutput: {file: o.usdc}\nsystems:\n"
PARTICLES = "- particles:\n    step: 0.005\n    emitters: [%s]\n"
STILL = "{bursts: [[0, 1]], at: [0.5, 0, 0], radius: 0.01}"
BAT = (
    "    colliders:\n    - {shape: {box: {size: [2, 0.1, 0.4]}}, restitution: 1, %s}\n"
)
HALF = np.sqrt(0.5)


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    """Return a stage in cm at 48 fps: a mill that turns, a sheet that rises."""
    made = Usd.Stage.CreateNew(str(tmp_path / "set.usda"))
    UsdGeom.SetStageMetersPerUnit(made, 0.01)
    UsdGeom.SetStageUpAxis(made, UsdGeom.Tokens.y)
    made.SetTimeCodesPerSecond(48)
    mill = UsdGeom.Xform.Define(made, "/mill")
    way, turn = mill.AddTranslateOp(), mill.AddRotateYOp()
    for code, x, angle in ((10, 0, 0), (58, 100, 90)):
        way.Set(Gf.Vec3d(x, 20, 0), code)
        turn.Set(angle, code)
    sheet = UsdGeom.Mesh.Define(made, "/sheet")
    flat = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]], float)
    sheet.CreateFaceVertexCountsAttr([4])
    sheet.CreateFaceVertexIndicesAttr([0, 3, 2, 1])
    for code, lift in ((0, [0, 0, 0, 0]), (48, [0, 40, 80, 40])):
        points = flat + np.outer(lift, [0, 1, 0])
        sheet.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points.astype("f")), code)
    made.Save()
    return made


def scene(folder: Path, text: str) -> Path:
    path = folder / "shot.scene.yaml"
    path.write_text(HEAD + text, "utf-8")
    return path


def poses(folder: Path, keys: str) -> Poses:
    setup = load_scene(scene(folder, PARTICLES % STILL + BAT % keys)).systems[0].setup
    return setup.surroundings.colliders[0].poses


def points(folder: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(folder / "o.usdc"))
    (prim,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Points)]
    attr = UsdGeom.Points(prim).GetPointsAttr()
    return np.array([np.array(attr.Get(t)) for t in attr.GetTimeSamples()])


def test_turns_come_after_rotate_and_props_moves(tmp_path: Path) -> None:
    keys = (
        f"at: [1, 2, 3], rotate: [{HALF}, {HALF}, 0, 0], "
        "moves: [[0, 0, 0, 0], [2, 4, 0, 0]], "
        f"turns: [[0.5, 1, 0, 0, 0], [1.5, {HALF}, 0, 0, {HALF}]]"
    )
    found = poses(tmp_path, keys)
    first = so3.exp(np.array([np.pi / 2, 0, 0]))
    for t, x, angle in ((0, 1, 0), (0.5, 2, 0), (1, 3, 45), (1.5, 4, 90), (2, 5, 90)):
        pose = found.at(t)
        turn = so3.multiply(so3.exp(np.array([0, 0, np.radians(angle)])), first)
        np.testing.assert_allclose(pose[:3], [x, 2, 3], atol=1e-12)
        assert so3.angle_between(pose[3:], turn) < 1e-7


def test_a_bat_that_turns_hits(tmp_path: Path) -> None:
    turns = f"turns: [[0, 1, 0, 0, 0], [0.25, {HALF}, 0, 0, {HALF}]], at: [0, -0.3, 0]"
    bake(scene(tmp_path, PARTICLES % STILL + BAT % turns), tmp_path / "o.usdc")
    # Hit at a distance from the axis, it leaves at twice the speed of the bat there.
    speed = np.linalg.norm(np.diff(points(tmp_path)[-3:, 0], axis=0), axis=1) * 24
    assert speed.min() > np.pi / 0.5 * 0.5


def test_what_goes_with_a_prim(tmp_path: Path, stage: Usd.Stage) -> None:
    mill = stage.GetPrimAtPath("/mill")
    for frame, start in (("", 10), (", frame: 34", 34)):
        keys = f"at: [0.5, 0, 0], prim: {{file: set.usda, prim: /mill{frame}}}"
        found = poses(tmp_path, keys)
        for t in (-2.0, 0.0, 0.3, 0.5, 3.0):
            code = min(max(start + 48 * t, 10), 58)
            world = UsdGeom.Xformable(mill).ComputeLocalToWorldTransform(code)
            place = np.array(world.Transform(Gf.Vec3d(50, 0, 0))) / 100
            np.testing.assert_allclose(found.at(t)[:3], place, atol=1e-3)
            turn = so3.exp(np.array([0, np.radians((code - 10) / 48 * 90), 0]))
            assert so3.angle_between(found.at(t)[3:], turn) < 1e-3


@pytest.mark.usefixtures("stage")
def test_an_emitter_goes_with_a_prim(tmp_path: Path) -> None:
    jet = "{bursts: [[0, 1], [1, 1]], inherit: 0, prim: {file: set.usda, prim: /mill}}"
    path = scene(tmp_path, PARTICLES % jet)
    bake(path, tmp_path / "o.usdc")
    made = Usd.Stage.Open(str(tmp_path / "o.usdc"))
    found = UsdGeom.Points.Get(made, "/shot/particles").GetPointsAttr().Get(25)
    np.testing.assert_allclose(found, [[0, 0.2, 0], [1, 0.2, 0]], atol=1e-6)
    assert tmp_path / "set.usda" in load_scene(path).systems[0].setup.files


@pytest.mark.slow
@pytest.mark.usefixtures("stage")
@pytest.mark.parametrize("closed", ["false", "true"])
def test_a_mesh_that_changes_shape_lifts_what_lies_on_it(
    tmp_path: Path,
    closed: str,
) -> None:
    pea = "{bursts: [[0, 1]], at: [0, 0.021, 0], radius: 0.01}"
    text = "    forces: [{gravity: }]\n    meshes: [{file: set.usda, prim: /sheet, "
    text += f"radius: 0.01, closed: {closed}, friction: 5}}]\n"
    bake(scene(tmp_path, PARTICLES % pea + text), tmp_path / "o.usdc")
    heights = points(tmp_path)[:, 0, 1]
    assert heights[12] == pytest.approx(0.2 + 0.02, abs=0.02)
    assert heights[-1] == pytest.approx(0.4 + 0.02, abs=0.03)


def test_a_mesh_is_somewhere(tmp_path: Path, stage: Usd.Stage) -> None:
    sheet = UsdGeom.Xformable(stage.GetPrimAtPath("/sheet"))
    sheet.AddScaleOp(opSuffix="none").Set((float("nan"), 1, 1))
    stage.Save()
    mesh = MovingMeshModel(file=str(tmp_path / "set.usda"), prim="/sheet")
    with raises(AnimtoolError, "SIM051"):
        animated_surface(mesh)


def test_a_mesh_keeps_its_points(tmp_path: Path, stage: Usd.Stage) -> None:
    points = stage.GetPrimAtPath("/sheet").GetAttribute("points")
    points.Set(Vt.Vec3fArray(5), 48)
    stage.Save()
    mesh = MovingMeshModel(file=str(tmp_path / "set.usda"), prim="/sheet")
    motion = animated_surface(mesh).motion
    assert len(motion.points(-1.0)) == 4
    with pytest.raises(AnimtoolError) as error:
        motion.points(1.0)
    assert error.value.code == "SIM051"


@pytest.mark.usefixtures("stage")
@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("turns: [[1, 1, 0, 0, 0], [0, 1, 0, 0, 0]]", ["SIM020"]),
        ("turns: [[0, 0, 0, 0, 0]]", ["SIM020"]),
        ("turns: [[0, 1, 0, 0]]", ["DOC022"]),
        ("moves: [[1, 1, 0, 0], [0, 1, 0, 0]]", ["SIM020"]),
        ("prim: {file: set.usda, prim: /mil}", ["SIM053"]),
        ("prim: {file: no.usda, prim: /mill}", ["DOC015"]),
        ("prim: {file: set.usda, prim: /mill}, moves: [[0, 0, 0, 0]]", ["SIM020"]),
    ],
)
def test_what_cannot_be_gone_with(
    tmp_path: Path,
    keys: str,
    expected: list[str],
) -> None:
    with pytest.raises(FormatError) as error:
        load_scene(scene(tmp_path, PARTICLES % STILL + BAT % keys))
    assert [fault.code for fault in error.value.faults] == expected
    assert all(fault.lines for fault in error.value.faults)


@pytest.mark.usefixtures("stage")
@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("{file: set.usda, prim: /mill}", "SIM051"),
        ("{file: set.usda, prim: /shet}", "SIM051"),
        ("{file: set.usda, prim: /sheet, radius: 0}", "SIM020"),
        ("{file: no.usda, prim: /sheet}", "DOC015"),
    ],
)
def test_meshes_that_are_none(
    tmp_path: Path,
    entry: str,
    expected: str,
) -> None:
    with pytest.raises(FormatError) as error:
        load_scene(scene(tmp_path, PARTICLES % STILL + f"    meshes: [{entry}]\n"))
    assert [fault.code for fault in error.value.faults] == [expected]
