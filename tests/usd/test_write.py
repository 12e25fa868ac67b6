"""`animtool.usd.write`: a take to USD in one call."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from support.bvh import random_rows, small_bvh
from support.usd import joint_positions, open_stage, validation_errors

import animtool
from animtool.core.errors import AnimtoolError
from animtool.core.units import UpAxis
from animtool.edit.resample import resampled
from animtool.formats.bvh.read import read_bvh
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.report.compare import compare_takes
from animtool.scene.bake.bake import bake
from animtool.usd.takes.read import read_usd


@pytest.fixture
def take(tmp_path: Path) -> Take:
    path = tmp_path / "hero.bvh"
    path.write_text(small_bvh(random_rows(600), frame_time="0.0083333"))
    return read_bvh(path).collect()


def test_a_stage_is_what_a_bake_writes(take: Take, tmp_path: Path) -> None:
    result = animtool.usd.write(take, tmp_path / "a.usda")
    report = bake(tmp_path / "hero.bvh", tmp_path / "b.usda")
    assert (tmp_path / "a.usda").read_bytes() == (tmp_path / "b.usda").read_bytes()
    assert result.rounding == report.result.rounding
    assert (result.samples, result.notices) == (600, [])


def test_a_stage_in_layers_and_a_layer_over_it(take: Take, tmp_path: Path) -> None:
    first = animtool.usd.write(take, tmp_path / "a.usda", split=True)
    assert [path.name for path in first.outputs] == [
        "a.rig.usda",
        "a.anim.usdc",
        "a.usda",
    ]
    late = replace(take, clock=replace(take.clock, start=Fraction(1001)))
    layer = tmp_path / "late.usdc"
    second = animtool.usd.write(late, str(layer), rig_layer=first.outputs[0])
    assert (second.first, second.last) == (1001, 1600)
    assert not validation_errors(open_stage(tmp_path / "a.usda"))
    alone = read_usd(layer).collect()
    assert alone.clock == late.clock


def test_a_layer_over_a_rig_of_another_rate_and_up_axis(
    take: Take, tmp_path: Path
) -> None:
    turned = reorient(TakeStream.of(take), UpAxis.Z).collect()
    slow = resampled(turned, Fraction(24))
    rig = animtool.usd.write(slow, tmp_path / "z.usda", split=True).outputs[0]
    animtool.usd.write(take, tmp_path / "layer.usda", rig_layer=rig)
    shot = tmp_path / "shot.usda"
    shot.write_text(
        "#usda 1.0\n(\n    subLayers = [@./layer.usda@, @./z.rig.usda@]\n"
        '    timeCodesPerSecond = 24\n    upAxis = "Z"\n    metersPerUnit = 0.01\n)\n'
    )
    back = read_usd(shot).collect()
    assert (back.clock.fps, back.clock.rate) == (24, take.clock.rate)
    assert compare_takes(turned, back).within(meters=1e-5, degrees=1e-3)


def test_units_and_places(take: Take, tmp_path: Path) -> None:
    animtool.usd.write(
        take, tmp_path / "a.usda", unit="m", prim_path="/World/hero", bones=True
    )
    stage = open_stage(tmp_path / "a.usda")
    assert stage.GetRootLayer().pseudoRoot.GetInfo("metersPerUnit") == 1.0
    assert stage.GetPrimAtPath("/World/hero/Rig/Anim")
    positions = joint_positions(stage, [1.0])
    assert abs(positions - take.world().positions[:1]).max() < 1e-4


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [
        ("a.txt", {}, "OUT004"),
        ("hero.usda", {}, "OUT001"),
        ("a.usda", {"unit": "yard"}, "CLI003"),
        ("a.usda", {"prim_path": "hero"}, "CLI003"),
        ("a.usda", {"rig_layer": "r.usda", "split": True}, "CLI002"),
        ("a.usda", {"rig_layer": "none.usda"}, "IO001"),
        ("none/a.usda", {}, "OUT002"),
    ],
)
def test_what_cannot_be_written(
    take: Take, tmp_path: Path, name: str, options: dict[str, Any], code: str
) -> None:
    (tmp_path / "hero.usda").write_text("kept")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(AnimtoolError) as caught:
        animtool.usd.write(take, tmp_path / name, **options)
    assert caught.value.code == code
    assert sorted(tmp_path.iterdir()) == before
    animtool.usd.write(take, tmp_path / "hero.usda", overwrite=True)


def test_only_write_is_public() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        _ = animtool.usd.nothing
