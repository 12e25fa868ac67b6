"""Prims as targets: units, up axes, rates, the space that the rig stands in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Gf, Usd, UsdGeom

from animtool.core.errors import FormatError
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.skeleton import Joint, Rig
from animtool.usd.props.prim_transforms import prim_transform_reader

RIG = Rig("hero", (Joint("hips", -1),))


def stage_at(path: Path, up: str = "Y", unit: float = 1.0, rate: float = 24.0) -> Path:
    """Write a stage with a prop that travels, below a group that stands aside."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    stage.SetTimeCodesPerSecond(rate)
    world = UsdGeom.Xform.Define(stage, "/World")
    world.AddTranslateOp().Set(Gf.Vec3d(0, 10, 0))
    prop = UsdGeom.Xform.Define(stage, "/World/prop")
    move, turn = prop.AddTranslateOp(), prop.AddRotateXYZOp()
    prop.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    for code, x in ((0, 0), (24, 5)):
        move.Set(Gf.Vec3d(x, 0, 3), code)
        turn.Set(Gf.Vec3f(90 if x else 0, 0, 0), code)
    hero = UsdGeom.Xform.Define(stage, "/World/hero")
    hero.AddTranslateOp().Set(Gf.Vec3d(0, 0, 3))
    hero.AddScaleOp().Set(Gf.Vec3f(0.01, 0.01, 0.01))
    stage.GetRootLayer().Save()
    return path


def test_a_prim_is_followed(tmp_path: Path) -> None:
    motion = prim_transform_reader(stage_at(tmp_path / "s.usda"), "/World/prop", RIG)
    positions, rotations = motion(np.array([0.0, 0.5, 1.0]))
    assert_allclose(positions, [[0, 10, 3], [2.5, 10, 3], [5, 10, 3]])
    turns = so3.log(rotations)
    quarter = np.pi / 2
    expected = [[0, 0, 0], [quarter / 2, 0, 0], [quarter, 0, 0]]
    assert_allclose(turns, expected, atol=1e-9)


def test_seconds_are_those_of_the_stage(tmp_path: Path) -> None:
    path = stage_at(tmp_path / "s.usda", rate=48)
    positions, _ = prim_transform_reader(path, "/World/prop", RIG)(np.array([0.25]))
    assert_allclose(positions, [[2.5, 10, 3]])


def test_units_and_up_axis_become_the_rigs(tmp_path: Path) -> None:
    path = stage_at(tmp_path / "s.usda", up="Z", unit=0.01)
    positions, rotations = prim_transform_reader(path, "/World/prop", RIG)(
        np.array([1.0])
    )
    assert_allclose(positions, [[0.05, 0.03, -0.1]], atol=1e-12)
    # What was up in the stage is up in the rig's world.
    assert_allclose(so3.rotate(rotations, [0, 0, 1])[0], [0, 0, 1], atol=1e-7)
    upright = replace(RIG, up=UpAxis.Z)
    positions, _ = prim_transform_reader(path, "/World/prop", upright)(np.array([1.0]))
    assert_allclose(positions, [[0.05, 0.1, 0.03]])


def test_the_rig_may_stand_in_another_prims_frame(tmp_path: Path) -> None:
    path = stage_at(tmp_path / "s.usda")
    rig = replace(RIG, meters_per_unit=0.01)
    motion = prim_transform_reader(path, "/World/prop", rig, "/World/hero")
    positions, _ = motion(np.array([0.0, 1.0]))
    # 5 units of the shot are 500 of the rig, which counts centimetres.
    assert_allclose(positions, [[0, 0, 0], [5, 0, 0]], atol=1e-6)


@pytest.mark.parametrize("name", ["/World/prob", "World/prop", "no path"])
def test_a_prim_that_is_not_there(tmp_path: Path, name: str) -> None:
    path = stage_at(tmp_path / "s.usda")
    with pytest.raises(FormatError) as caught:
        prim_transform_reader(path, name, RIG)
    assert caught.value.code == "USD034"
    if name == "/World/prob":
        assert caught.value.faults[0].hint == "did you mean /World/prop?"
    with pytest.raises(FormatError) as caught:
        prim_transform_reader(path, "/World/prop", RIG, name)
    assert caught.value.code == "USD034"


def test_a_transform_that_is_not_finite(tmp_path: Path) -> None:
    path = stage_at(tmp_path / "s.usda")
    text = path.read_text().replace("24: (5, 0, 3)", "24: (inf, 0, 3)")
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        prim_transform_reader(path, "/World/prop", RIG)(np.array([1.0]))
    assert caught.value.code == "USD171"
