"""Outputs that name the systems that go into them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from support.bvh import random_rows, small_bvh
from support.cli import animtool

from animtool.core.errors import FormatError
from animtool.report.describe_scene import describe_scene
from animtool.scene.bake.request import create_request
from animtool.scene.bake.steps import StepKind, bake_steps
from animtool.scene.file.read import load_scene
from animtool.scene.systems import simulation

HEAD = "scene: animtool/1\nfps: 24\n"
RANGE = "range: [1, 6]\n"
SYSTEMS = """\
systems:
- cloth:
    name: flag
    mass: 0.3
    radius: 0.01
    across: [1, 0, 0]
    resolution: [5, 4]
    springs: {structural: {stiffness: 100}}
- rope:
    name: cord
    from: [0, 1, 0]
    to: [1, 1, 0]
    count: 5
    mass: 0.1
    springs: {structural: {stiffness: 100}}
- particles:
    name: snow
    emitters: [{rate: 200, speed: 1, at: [0.5, 1, 0]}]
    forces: [{gravity: }]
    systems: [{system: flag}]
"""


def written(folder: Path, output: str, head: str = HEAD + RANGE) -> Path:
    path = folder / "shot.scene.yaml"
    path.write_text(f"{head}{SYSTEMS}output:{output}\n", "utf-8")
    return path


def prims(path: Path) -> list[str]:
    stage = Usd.Stage.Open(str(path))
    return [p.GetName() for p in stage.Traverse() if p.GetAttribute("points")]


def same_points(one: Path, other: Path, prim: str) -> bool:
    stages = [Usd.Stage.Open(str(path)) for path in (one, other)]
    found = [stage.GetPrimAtPath(prim).GetAttribute("points") for stage in stages]
    codes = found[0].GetTimeSamples()
    return codes == found[1].GetTimeSamples() and all(
        np.array_equal(*(np.array(each.Get(code)) for each in found)) for code in codes
    )


def test_each_output_has_its_own(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "\n- {file: snow.usdc, systems: [snow]}\n"
        "- {file: springs.usdc, systems: [cord, flag]}\n- {file: all.usdc}",
    )
    done = animtool("bake", path)
    assert done.code == 0, done.stderr
    assert prims(tmp_path / "snow.usdc") == ["snow"]
    assert prims(tmp_path / "springs.usdc") == ["flag", "cord"]
    assert prims(tmp_path / "all.usdc") == ["flag", "cord", "snow"]
    for name in ("flag", "cord"):
        pair = (tmp_path / "springs.usdc", tmp_path / "all.usdc")
        assert same_points(*pair, f"/shot/{name}")
    assert same_points(tmp_path / "snow.usdc", tmp_path / "all.usdc", "/shot/snow")


def test_only_what_is_needed_is_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[list[str]] = []
    one_after_another = simulation.simulation_order

    def in_order(systems):  # type: ignore[no-untyped-def]
        opened.append([system.name for system in systems])
        return one_after_another(systems)

    monkeypatch.setattr(simulation, "simulation_order", in_order)
    path = written(tmp_path, " {file: snow.usdc, systems: [snow]}")
    assert animtool("bake", path).code == 0
    assert opened == [["flag", "snow"]]
    assert prims(tmp_path / "snow.usdc") == ["snow"]


def test_props_a_character(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(small_bvh(random_rows(6)))
    head = "scene: animtool/1\nsource: {file: walk.bvh}\n"
    path = written(
        tmp_path,
        "\n- {file: shot.usdc, systems: [cord]}\n- {file: bare.usdc, systems: []}",
        head,
    )
    done = animtool("bake", path)
    assert done.code == 0, done.stderr
    assert prims(tmp_path / "shot.usdc") == ["cord"]
    assert not prims(tmp_path / "bare.usdc")


def test_chunks_are_of_what_is_written(tmp_path: Path) -> None:
    path = written(tmp_path, " {file: snow.usdc, systems: [snow], chunk: 3}")
    assert animtool("bake", path).code == 0
    assert prims(tmp_path / "snow.usdc") == ["snow"]
    assert (tmp_path / "snow.systems.0002.usdc").exists()
    none = written(tmp_path, " {file: snow.usdc, systems: [], chunk: 3}")
    with pytest.raises(FormatError) as error:
        load_scene(none)
    assert [fault.code for fault in error.value.faults] == ["SCN081"]


def test_a_name_that_there_is_none_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        load_scene(written(tmp_path, " {file: a.usdc, systems: [flag, snwo, x]}"))
    one, other = error.value.faults
    assert (one.code, other.code) == ("SCN063", "SCN063")
    assert one.where == "output.systems[1]"
    assert "snow" in str(one.hint)
    assert "cord, flag, snow" in str(other.hint)


def test_plans_and_info_say_what_goes_where(tmp_path: Path) -> None:
    text = (
        "\n- {file: snow.usdc, systems: [snow]}\n- {file: flag.usdc, systems: [flag]}"
    )
    scene = load_scene(written(tmp_path, text))
    steps = bake_steps(create_request(scene, None))
    systems = [step.name for step in steps if step.kind is StepKind.SYSTEM]
    made = [step.makes[0] for step in steps if step.kind is StepKind.OUTPUT]
    assert systems == ["flag", "snow"]
    assert [text.split(",")[0] for text in made] == [
        "stage with snow",
        "stage with flag",
    ]
    found = describe_scene(scene)
    assert [output.systems for output in found.outputs] == [["snow"], ["flag"]]
    files = create_request(scene, None).files
    assert [path.name for path in files] == ["snow.usdc", "flag.usdc"]


def test_none_is_written_where_one_cannot_be(tmp_path: Path) -> None:
    path = written(tmp_path, "\n- {file: a.usdc, systems: [cord]}\n- {file: b.usdc}")
    (tmp_path / "b.usdc").write_text("")
    assert animtool("bake", path).code != 0
    assert not (tmp_path / "a.usdc").exists()
    done = animtool("bake", path, "--overwrite", "--format", "json")
    assert done.code == 0, done.stderr
    reports = json.loads(done.stdout)
    assert reports
