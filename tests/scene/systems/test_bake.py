"""Scenes that are simulated: read, baked, refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from support.faults import raises

from animtool import BakeOptions, bake
from animtool.cli.summary import BAKE_TEMPLATE
from animtool.core.errors import AnimtoolError, FormatError, OptionError, ToleranceError
from animtool.core.units import LengthUnit
from animtool.core.values import plain_value
from animtool.scene.bake.request import create_request
from animtool.scene.bake.steps import StepKind, bake_steps
from animtool.scene.file.read import load_scene
from animtool.scene.sources.open import SourceOptions
from animtool.scene.systems.simulation import open_systems

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 12]
systems:
- particles:
    name: embers
    preroll: 0.25
    step: 0.02
    emitters:
    - {rate: 120, place: {disc: {radius: 0.2}}, speed: 3, spread: 20, lifetime: 0.4}
    forces:
    - gravity:
    - turbulence: {strength: 4}
    colliders:
    - {shape: {plane: {}}, restitution: 0.4, friction: 0.3}
    - name: lid
      shape: {box: {size: [1, 1, 1]}}
      at: [1, 0, 0]
      moves: [[0, 0, 0, 0], [1, 0, 1, 0]]
    kill:
    - {shape: {sphere: {radius: 9}}, container: true}
output: {file: embers.usdc}
"""


def written(folder: Path, text: str, name: str = "shot.scene.yaml") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def codes(folder: Path, text: str) -> list[str]:
    with pytest.raises(FormatError) as error:
        load_scene(written(folder, text))
    return [fault.code for fault in error.value.faults]


def test_points_are_written_with_all_that_they_are(tmp_path: Path) -> None:
    scene = written(tmp_path, SCENE)
    report = bake(scene, tmp_path / "embers.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "embers.usdc"))
    assert stage.GetDefaultPrim().GetPath() == "/shot"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 12)
    points = UsdGeom.Points(stage.GetPrimAtPath("/shot/embers"))
    assert points.GetPointsAttr().GetTimeSamples() == list(range(1, 13))
    alive: set[int] = set()
    for code in range(1, 13):
        ids = np.array(points.GetIdsAttr().Get(code))
        places = np.array(points.GetPointsAttr().Get(code))
        widths = np.array(points.GetWidthsAttr().Get(code))
        speeds = np.array(points.GetVelocitiesAttr().Get(code))
        assert len(ids) == len(places) == len(widths) == len(speeds)
        assert (np.diff(ids) > 0).all()
        low, high = np.array(points.GetExtentAttr().Get(code))
        assert (places >= low).all()
        assert (places <= high).all()
        computed = UsdGeom.Points.ComputeExtent(
            points.GetPointsAttr().Get(code), points.GetWidthsAttr().Get(code)
        )
        np.testing.assert_allclose(computed, [low, high], atol=1e-6)
        alive |= set(ids.tolist())
    ages = UsdGeom.PrimvarsAPI(points).GetPrimvar("age")
    assert max(ages.Get(12)) <= 0.4
    assert report.takes[0].meshes[0].written.samples == 12
    assert len(alive) > 40
    assert points.GetWidthsInterpolation() == "vertex"


def test_the_summary_says_what_was_simulated(tmp_path: Path) -> None:
    report = bake(written(tmp_path, SCENE), tmp_path / "embers.usdc")
    lines = BAKE_TEMPLATE.text(report)
    assert any("1 system of shot.scene.yaml, simulated" in line for line in lines)
    assert any("embers: up to" in line and "12 frames" in line for line in lines)
    (mesh,) = plain_value(report)["meshes"]
    assert (mesh["kind"], mesh["prim"]) == ("particles", "/shot/embers")


def test_a_start_says_when_the_simulation_begins(tmp_path: Path) -> None:
    later = SCENE.replace("embers.usdc}", "embers.usdc, start: 1001}")
    later = later.replace("range: [1, 12]", "range: [1004, 1006]")
    bake(written(tmp_path, SCENE), tmp_path / "whole.usda")
    bake(written(tmp_path, later, "later.scene.yaml"), tmp_path / "part.usda")
    whole, part = (
        Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usda"))
        for name in ("whole", "part")
    )
    found = part.QueryTimeSample("/later/embers.points", 1004)
    assert found == whole.QueryTimeSample("/shot/embers.points", 4)


def test_units_and_names_of_the_output(tmp_path: Path) -> None:
    scene = written(tmp_path, SCENE.replace("name: embers", "name: my embers!"))
    bake(scene, tmp_path / "m.usda", BakeOptions(prim_path="/World/fx"))
    bake(scene, tmp_path / "cm.usda", BakeOptions(to_units=LengthUnit("cm")))
    one = Usd.Stage.Open(str(tmp_path / "m.usda"))
    two = Usd.Stage.Open(str(tmp_path / "cm.usda"))
    (fx,) = one.GetPrimAtPath("/World/fx").GetChildren()
    (other,) = two.GetPrimAtPath("/shot").GetChildren()
    assert UsdGeom.GetStageMetersPerUnit(two) == 0.01
    a, b = (np.array(p.GetAttribute("points").Get(12)) for p in (fx, other))
    np.testing.assert_allclose(a * 100, b, rtol=1e-6)


def test_a_velocity_field_and_a_mesh(tmp_path: Path) -> None:
    points = [[0.0, 0, 0], [1, 0, 0], [0, 0, 1]]
    np.savez(tmp_path / "tri.npz", points=points, triangles=[[0, 2, 1]])
    text = re.sub(r"    forces:.*?    colliders:", "    colliders:", SCENE, flags=re.S)
    mesh = "{points: tri.npz, triangles: tri.npz}"
    text = text.replace("{disc: {radius: 0.2}}", f"{{mesh: {mesh}}}")
    text = text.replace(
        "    colliders:", "    velocity: {x: '-z', z: x, y: '1'}\n    colliders:"
    )
    bake(written(tmp_path, text), tmp_path / "out.usda")
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    attributes = UsdGeom.Points(stage.GetPrimAtPath("/shot/embers"))
    points = np.array(attributes.GetPointsAttr().Get(12))
    speeds = np.array(attributes.GetVelocitiesAttr().Get(12))
    assert len(points) > 20
    x, _, z = points.T
    field = np.stack([-z, np.ones_like(x), x], axis=1)
    free = x < 0.4  # away from the lid
    np.testing.assert_allclose(speeds[free], field[free], atol=1e-5)


def test_particles_run_into_characters(root: Path, tmp_path: Path) -> None:
    clip = root / "samples/stride/stride.clip.yaml"
    character = f"    characters:\n    - {{file: {str(clip)!r}, friction: 0.2}}\n"
    rain = SCENE.replace("    kill:", f"{character}    kill:")
    systems = load_scene(written(tmp_path, rain), {"at": str(root)}).systems
    (particles,) = open_systems(systems)
    hit = particles.simulation.setup.colliders  # type: ignore[attr-defined]
    assert len(hit) > 6
    assert hit[2].name
    assert len(hit[2].poses.sample_times) > 10


def test_a_character_without_capsules_is_said(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    text = SCENE.replace("    kill:", "    characters: [{file: walk.bvh}]\n    kill:")
    with pytest.raises(FormatError) as error:
        bake(written(tmp_path, text), tmp_path / "o.usdc")
    assert error.value.code == "SIM020"
    missing = text.replace("walk.bvh", "run.bvh")
    assert codes(tmp_path, missing) == ["DOC015"]


def test_what_a_bake_would_do_is_said(tmp_path: Path) -> None:
    steps = bake_steps(create_request(written(tmp_path, SCENE), tmp_path / "x.usdc"))
    assert [step.kind for step in steps] == [StepKind.SYSTEM, StepKind.OUTPUT]
    assert steps[0].reads == ("1 emitter", "2 forces", "2 colliders")


# Faults


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rate: 120", "rate: -1", ["SIM021"]),
        ("lifetime: 0.4", "lifetime: -0.4", ["SIM021"]),
        ("rate: 120", "rate: 120, mass: 0", ["SIM021"]),
        ("gravity:", "gravty:", ["SIM023"]),
        ("strength: 4", "strengh: 4", ["SCN001"]),
        ("strength: 4", "strength: lots", ["SCN002"]),
        ("strength: 4", "size: 0", ["SIM022"]),
        ("gravity:", "field: {x: 'spam + 1'}", ["SIM022"]),
        ("radius: 0.2", "radius: -0.2", ["SIM021"]),
        ("disc:", "disk:", ["SIM021"]),
        ("plane:", "plain:", ["SIM020"]),
        ("size: [1, 1, 1]", "size: [1, 0, 1]", ["SIM020"]),
        ("restitution: 0.4", "restitution: 1.4", ["SIM020"]),
        ("[1, 0, 1, 0]", "[0, 0, 1, 0]", ["SIM020"]),
        ("step: 0.02", "step: 0", ["SIM004"]),
        ("step: 0.02", "step: -1", ["SIM004"]),
        ("step: 0.02", "method: rk5", ["SIM001"]),
        ("range: [1, 12]\n", "", ["SCN061"]),
        ("range: [1, 12]", "rig: x.rig.yaml", ["DOC015", "SCN060", "SCN061"]),
        ("embers.usdc", "embers.bvh", ["SCN060"]),
        ("forces:", "velocity: {x: '1'}\n    forces:", ["SIM024"]),
        ("forces:", "velocity: {x: '1 +'}\n    forces:", ["SIM022"]),
        ("{disc: {radius: 0.2}}", "{mesh: {points: no.npz}}", ["DOC015", "SCN002"]),
    ],
)
def test_faults_have_codes_and_places(
    tmp_path: Path, old: str, new: str, expected: list[str]
) -> None:
    assert old in SCENE
    text = SCENE.replace(old, new, 1)
    assert sorted(codes(tmp_path, text)) == expected
    with pytest.raises(FormatError) as error:
        load_scene(written(tmp_path, text))
    assert all(fault.lines for fault in error.value.faults)


def test_all_faults_are_said_at_once(tmp_path: Path) -> None:
    text = SCENE.replace("gravity:", "gravty:").replace("rate: 120", "rate: -1")
    text = text.replace("restitution: 0.4", "restitution: 4")
    assert sorted(codes(tmp_path, text)) == ["SIM020", "SIM021", "SIM023"]


def test_a_system_is_of_one_kind(tmp_path: Path) -> None:
    assert codes(tmp_path, SCENE.replace("- particles:", "- {}\n- particles:")) == [
        "SCN065"
    ]
    assert codes(tmp_path, SCENE.replace("- particles:", "- partcles:")) == ["DOC020"]
    nothing = SCENE.partition("- particles:")[0] + "- particles:\n"
    assert codes(tmp_path, nothing) == ["DOC022"]


def test_a_scene_has_systems_or_a_source(tmp_path: Path) -> None:
    assert codes(tmp_path, "scene: animtool/1\n") == ["DOC021"]


@pytest.mark.parametrize(
    "options",
    [
        BakeOptions(bones=True),
        BakeOptions(strip_namespace=1),
        BakeOptions(reduce=0.1),
        BakeOptions(form="split"),
        BakeOptions(source=SourceOptions(unit=LengthUnit.CM)),
        BakeOptions(source=SourceOptions(take="run")),
    ],
)
def test_what_is_for_characters_is_refused(
    tmp_path: Path, options: BakeOptions
) -> None:
    with pytest.raises(OptionError) as error:
        bake(written(tmp_path, SCENE), tmp_path / "o.usdc", options)
    assert error.value.code == "SCN062"
    assert not (tmp_path / "o.usdc").exists()


def test_what_blows_up_leaves_nothing_and_says_the_step(tmp_path: Path) -> None:
    text = SCENE.replace("turbulence: {strength: 4}", "spring: {k: 1e9}")
    text = text.replace("lifetime: 0.4", "mass: 1").split("    colliders:")[0]
    with pytest.raises(AnimtoolError) as error:
        bake(written(tmp_path, text), tmp_path / "o.usdc")
    assert isinstance(error.value, ToleranceError | FormatError)
    assert "SIM102" in {fault.code for fault in error.value.faults}
    assert not list(tmp_path.glob("*.usdc"))


STOPS = """\
scene: animtool/1
fps: 24
range: [1, 48]
systems:
- particles:
    name: it
    step: 0.01
    method: euler
    emitters: [{at: [1, 0, 0], bursts: [[0, 3]], speed: 1, mass: 1}]
    forces: [{spring: {anchor: [0, 0, 0], k: 4000}}]
"""


@pytest.mark.parametrize("chunk", [None, 2])
def test_frames_before_a_stop_are_kept_on_request(
    tmp_path: Path, chunk: int | None
) -> None:
    scene, output = written(tmp_path, STOPS), tmp_path / "o.usdc"
    with raises(ToleranceError, "SIM101", "SIM102", match="blew up.*, before frame 5"):
        bake(scene, output, BakeOptions(chunk=chunk))
    assert not list(tmp_path.glob("*.usd*"))
    report = bake(scene, output, BakeOptions(chunk=chunk, keep_stopped=True))
    assert report.stopped is not None
    assert [f.code for f in report.stopped.faults] == ["SIM101", "SIM102", "SIM193"]
    assert (report.span.first, report.span.last, report.result.samples) == (1, 4, 4)
    stage = Usd.Stage.Open(str(output))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 4)
    points = UsdGeom.Points(stage.GetPrimAtPath("/shot/it")).GetPointsAttr()
    assert points.GetTimeSamples()[-1] == 4
    assert all(np.isfinite(points.Get(code)).all() for code in range(1, 5))


def test_a_stop_before_the_first_frame_keeps_nothing(tmp_path: Path) -> None:
    early = STOPS.replace("step:", "preroll: 1\n    step:").replace("[[0,", "[[-1,")
    scene = written(tmp_path, early)
    with raises(ToleranceError, "SIM101", "SIM102", match="before frame 1"):
        bake(scene, tmp_path / "o.usdc", BakeOptions(keep_stopped=True))
    assert not list(tmp_path.glob("*.usd*"))


def test_kept_frames_of_no_simulation_are_refused(tmp_path: Path) -> None:
    with raises(OptionError, "CLI002"):
        bake(tmp_path / "x.bvh", tmp_path / "o.usdc", BakeOptions(keep_stopped=True))


def test_warnings_stop_where_none_are_wanted(tmp_path: Path) -> None:
    text = SCENE.replace("step: 0.02", "max_particles: 3")
    scene = written(tmp_path, text)
    report = bake(scene, tmp_path / "o.usdc")
    assert [notice.code for notice in report.notices] == ["SIM121"]
    with pytest.raises(AnimtoolError):
        bake(scene, tmp_path / "p.usdc", BakeOptions(strict=True))
    assert not (tmp_path / "p.usdc").exists()


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("lifetime: 0.4", "lifetime: -1", "emitters[0].lifetime"),
        ("speed: 3, spread", "speed: 3, end: -1, start: 1, spread", "emitters[0].end"),
        ("friction: 0.3", "friction: -1", "colliders[0].friction"),
        ("{sphere: {radius: 9}}", "{sphere: {radius: 0}}", "kill[0].shape"),
    ],
)
def test_what_makes_no_sense_is_said_at_its_key(
    tmp_path: Path, old: str, new: str, where: str
) -> None:
    with pytest.raises(FormatError) as error:
        load_scene(written(tmp_path, SCENE.replace(old, new)))
    (fault,) = error.value.faults
    assert fault.where == f"systems[0].particles.{where}"
