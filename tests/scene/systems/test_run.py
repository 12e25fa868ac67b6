"""Systems under way: what is said of them, and how far they are."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pxr import Usd

from animtool import BakeOptions, bake
from animtool.core.errors import AnimtoolError, ToleranceError
from animtool.core.shot import FrameRange
from animtool.scene.bake.prims import BakeReport
from animtool.usd.checks import check_layer
from animtool.validation.run import validate

HEAD = "scene: animtool/1\nfps: 24\nrange: [1, 6]\nsystems:\n"
ROPE = """\
- rope:
    from: [0, 2, 0]
    to: [0, 1, 0]
    count: 6
    mass: 0.5
    springs: {structural: {stiffness: 2000, ratio: 0.1}}
    pins: [{particles: [start]}]
"""
DUST = """\
- particles:
    name: dust
    emitters: [{rate: 100, speed: 2, lifetime: 1}]
    forces: [{gravity: }]
"""
CHARGES = """\
- particles:
    name: ions
    emitters: [{place: {disc: {radius: 0.2}}, bursts: [[0, 20]], charge: 1.0e-06}]
    forces: [{charges: }, {electromagnetic: {magnetic: [0, 0, 2]}}]
"""


def written(folder: Path, systems: str) -> Path:
    path = folder / "shot.scene.yaml"
    path.write_text(HEAD + systems, "utf-8")
    return path


def baked(folder: Path, systems: str, options: BakeOptions | None = None) -> BakeReport:
    return bake(written(folder, systems), folder / "shot.usdc", options)


def said(report: BakeReport) -> list[str]:
    return [notice.code for notice in report.notices if notice.code != "SIM130"]


@pytest.mark.parametrize(
    ("scaled", "hint"),
    [
        ({}, None),
        ({"from": [0, 0, 0], "to": [0, 1e-12, 0]}, "check the unit of to: 1e-12"),
        ({"mass": 1e-12}, "check the unit of mass: 1e-12"),
        ({"to": "far"}, "check the unit of points: 1e-11"),
    ],
)
def test_what_blows_up_by_its_size_gets_a_hint_at_units(
    tmp_path: Path, scaled: dict[str, Any], hint: str | None
) -> None:
    keys = {
        "mass": 0.1,
        "solver": "symplectic_euler",
        "step": 1 / 64,
        "gravity": [9] * 3,
    }
    keys |= {"springs": {"structural": {"stiffness": 60 if scaled else 1e9}}}
    if scaled.get("to") == "far":
        np.savez(tmp_path / "hair.npz", points=np.eye(3)[None] * 1e-11)
        pins = [{"particles": ["roots"]}]
        strands = {**keys, "points": "hair.npz", "pins": pins}
        systems = [{"strands": strands}]
    else:
        pins = [{"particles": ["start"]}]
        rope = {"from": [0, 0, 0], "to": [0, 1, 0], "count": 4, "pins": pins}
        systems = [{"rope": {**keys, **rope, **scaled}}]
    with pytest.raises(ToleranceError) as error:
        baked(tmp_path, yaml.safe_dump(systems))
    (last,) = (fault for fault in error.value.faults if fault.code == "SIM102")
    assert last.where == (f"systems[0].{next(iter(systems[0]))}")
    assert ("check the unit of" in str(last.hint)) is (hint is not None)
    assert str(last.hint).endswith(hint or "")


def test_a_name_that_another_has_is_said(tmp_path: Path) -> None:
    report = baked(tmp_path, ROPE + ROPE)
    assert said(report) == ["SCN090"]
    (notice,) = (n for n in report.notices if n.code == "SCN090")
    assert "'rope_2'" in notice.message
    assert (notice.lines, notice.where) == ((13,), "systems[1].rope")
    stage = Usd.Stage.Open(str(tmp_path / "shot.usdc"))
    names = [prim.GetName() for prim in stage.GetPrimAtPath("/shot").GetChildren()]
    assert names == ["rope", "rope_2"]


def test_particles_that_are_never_there_are_said(tmp_path: Path) -> None:
    for emitter in ("{speed: 2}", "{rate: 9, start: 5.5}"):
        systems = DUST.replace("{rate: 100, speed: 2, lifetime: 1}", emitter)
        assert said(baked(tmp_path, systems, BakeOptions(overwrite=True))) == ["SIM188"]
        codes = [fault.code for fault in validate(tmp_path / "shot.scene.yaml")]
        assert codes == ["SIM188"] * ("start" in emitter)
    for emitter in ("{rate: 100}", "{bursts: [[0, 3]], lifetime: 0.01}"):
        systems = DUST.replace("{rate: 100, speed: 2, lifetime: 1}", emitter)
        assert said(baked(tmp_path, systems, BakeOptions(overwrite=True))) == []


def test_frames_without_particles_have_an_extent_like_others(tmp_path: Path) -> None:
    baked(tmp_path, DUST)
    assert check_layer(tmp_path / "shot.usdc") == []


def test_springs_twice_as_long_are_said(tmp_path: Path) -> None:
    heavy = ROPE.replace("mass: 0.5", "mass: 500")
    options = BakeOptions(frame_range=FrameRange(1, 24), overwrite=True)
    assert said(baked(tmp_path, heavy, options)) == ["SIM200", "SIM187"]
    tearing = heavy.replace("ratio: 0.1", "ratio: 0.1, tear: 9")
    drawn = ROPE.replace("ratio: 0.1", "ratio: 0.1, rest: 0.2")
    for systems, codes in ((ROPE, []), (tearing, ["SIM200"]), (drawn, [])):
        assert said(baked(tmp_path, systems, options)) == codes


def test_charges_gain_speed_of_each_other(tmp_path: Path) -> None:
    assert said(baked(tmp_path, CHARGES)) == ["SIM101"]


def test_samples_before_the_beginning_are_the_beginning(tmp_path: Path) -> None:
    offsets = (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
    for systems in (ROPE, DUST):
        options = BakeOptions(samples=offsets, overwrite=True)
        baked(tmp_path, systems, options)
        stage = Usd.Stage.Open(str(tmp_path / "shot.usdc"))
        (prim,) = stage.GetPrimAtPath("/shot").GetChildren()
        points = prim.GetAttribute("points")
        assert points.GetTimeSamples()[0] == 0.75
        assert points.Get(0.75) == points.Get(1)


def test_the_share_done_ascends_from_none_to_all(tmp_path: Path) -> None:
    shares: list[float] = []
    bake(written(tmp_path, ROPE), tmp_path / "shot.usdc", progress=shares.append)
    assert shares[0] == 0
    assert shares[-1] == 1
    assert shares == sorted(shares)


def test_what_an_entry_of_a_table_lacks_is_named(tmp_path: Path) -> None:
    systems = DUST + "    colliders: [{shape: {sphere: {}}}]\n"
    with pytest.raises(AnimtoolError) as error:
        baked(tmp_path, systems)
    (fault,) = error.value.faults
    assert (fault.code, fault.message) == ("SCN002", "key 'radius' is missing")
