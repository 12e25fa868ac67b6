"""Systems beside a character: what they meet of it, and where they are written."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pxr import Usd, UsdGeom
from support.cli import animtool
from support.point_caches import layered, world_points
from support.skinned_rig import write_pair
from support.suite import some_quick
from support.usd import validation_errors

from animtool import BakeOptions, bake
from animtool.cli.summary import BAKE_TEMPLATE
from animtool.core.errors import AnimtoolError, FormatError, OptionError
from animtool.core.shot import FrameRange
from animtool.core.units import LengthUnit, UpAxis
from animtool.core.values import plain_value
from animtool.rig.file import load_rig
from animtool.scene.bake.bake import bake_outputs
from animtool.scene.bake.request import create_request
from animtool.scene.bake.steps import StepKind, bake_steps
from animtool.scene.file.read import load_scene
from animtool.scene.sources.open import open_source

CODES = [float(code) for code in range(1, 10)]
Array = npt.NDArray[np.float64]
CAPSULES = """\
colliders:
- {joint: hips, capsule: {radius: 20, length: 60, axis: [0, 1, 0]}}
- {joint: arm, capsule: {radius: 8, length: 40, axis: [1, 0, 0]}}
"""
# Dust that hangs in the air until it is pushed.
SYSTEMS = """\
systems:
- particles:
    name: dust
    step: 0.01
    emitters: [{bursts: [[0, 300]], place: {box: {size: [1.2, 1.2, 0.4]}}, at: AT}]
    characters: [CHARACTER]
"""
PROPS = """\
#usda 1.0
(
    timeCodesPerSecond = 24
)

def Xform "box"
{
    double3 xformOp:translate = (1, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
AT = "[0.5, 0.9, 0]"
OWN = "{source: true, friction: 0.1}"
FILE = "{file: pair.clip.yaml, friction: 0.1}"


def scene(
    folder: Path, extra: str = "", character: str = OWN, source: bool = True
) -> Path:
    if not (folder / "pair.clip.yaml").exists():
        write_pair(folder)
        rig = folder / "pair.rig.yaml"
        rig.write_text(rig.read_text("utf-8") + CAPSULES, "utf-8")
    systems = SYSTEMS.replace("CHARACTER", character).replace("AT", AT)
    head = "source: {file: pair.clip.yaml}" if source else "range: [1, 9]"
    path = folder / "shot.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\n{head}\n{systems}{extra}"
    path.write_text(text, "utf-8")
    return path


def dust(stage: Usd.Stage) -> Any:
    (found,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Points)]
    return found


def values(path: Path, name: str = "points") -> dict[float, Array]:
    stage = Usd.Stage.Open(str(path))
    attribute = dust(stage).GetAttribute(name)
    return {code: np.array(attribute.Get(code)) for code in attribute.GetTimeSamples()}


def assert_same(one: dict[float, Array], other: dict[float, Array]) -> None:
    assert list(one) == list(other)
    for code, array in one.items():
        np.testing.assert_array_equal(array, other[code])


def test_the_scenes_own_character_is_as_one_of_a_file(tmp_path: Path) -> None:
    bake(scene(tmp_path, character=FILE, source=False), tmp_path / "alone.usdc")
    bake(
        scene(tmp_path), tmp_path / "beside.usdc", BakeOptions(to_units=LengthUnit("m"))
    )
    alone = values(tmp_path / "alone.usdc")
    assert_same(alone, values(tmp_path / "beside.usdc"))
    assert np.ptp(np.stack(list(alone.values())), axis=0).max() > 0.05


def test_it_is_met_behind_the_passes(tmp_path: Path) -> None:
    passes = "passes: [{trim: {first: 5}}]\n"
    bake(scene(tmp_path, passes), tmp_path / "o.usdc")
    bake(scene(tmp_path), tmp_path / "raw.usdc")
    found, raw = values(tmp_path / "o.usdc"), values(tmp_path / "raw.usdc")
    assert np.abs(found[5] - raw[5]).max() > 1


def test_nothing_is_inside_of_what_is_written(tmp_path: Path) -> None:
    bake(scene(tmp_path), tmp_path / "o.usdc")
    rig = load_rig(tmp_path / "pair.rig.yaml")
    world = open_source(tmp_path / "pair.clip.yaml").collect().world()
    hips = world.positions[:, rig.index("hips")]
    # In centimetres, as the rig is.
    points = np.stack(list(values(tmp_path / "o.usdc").values())) / 100
    away = points - hips[:, None]
    away[..., 1] -= np.clip(away[..., 1], -0.3, 0.3)
    far = np.linalg.norm(away, axis=-1)
    # What began inside comes out little by little.
    outside = far[0] > 0.2
    assert outside.sum() > 100
    assert far[:, outside].min() > 0.2 - 1e-3


def test_nothing_is_inside_where_a_shot_begins_before_its_take(tmp_path: Path) -> None:
    shot = "shot: {start: 4, cut: [4, 9], handles: 3}\n"
    report = bake(scene(tmp_path, shot), tmp_path / "o.usdc")
    assert "SCN106" in [n.code for n in report.notices]
    found = values(tmp_path / "o.usdc")
    assert list(found) == list(range(1, 13))
    world = open_source(tmp_path / "o.usdc").collect().world()
    hips = world.positions[:, load_rig(tmp_path / "pair.rig.yaml").index("hips")]
    np.testing.assert_allclose(hips[:3], hips[[3, 3, 3]], atol=1e-12)
    away = np.stack(list(found.values())) / 100 - hips[:, None]
    away[..., 1] -= np.clip(away[..., 1], -0.3, 0.3)
    far = np.linalg.norm(away, axis=-1)
    outside = far[0] > 0.2
    assert outside.sum() > 100
    assert far[:, outside].min() > 0.2 - 1e-3


LEAD = """\
systems:
- rope:
    name: lead
    from: [0, 0.9, 0]
    to: [0.5, 0.9, 0]
    count: 6
    mass: 0.1
    springs: {structural: {stiffness: 1000, ratio: 0.1}}
    pins: [{particles: [start], joint: {CARRIER, joint: hips, offset: [0, 0, 0]}}]
"""


def lead(folder: Path, carrier: str, *, source: bool) -> Path:
    path = scene(folder, source=source, character=FILE)
    text = path.read_text("utf-8")
    systems = LEAD.replace("CARRIER", carrier)
    path.write_text(text[: text.index("systems:")] + systems, "utf-8")
    return path


def test_a_joint_of_the_scenes_own_character_carries(tmp_path: Path) -> None:
    metres = BakeOptions(to_units=LengthUnit("m"))
    bake(lead(tmp_path, "file: pair.clip.yaml", source=False), tmp_path / "alone.usdc")
    bake(lead(tmp_path, "source: true", source=True), tmp_path / "own.usdc", metres)
    stages = [
        Usd.Stage.Open(str(tmp_path / f"{name}.usdc")) for name in ("alone", "own")
    ]
    alone, own = (
        world_points(stage, path, CODES)
        for stage, path in zip(stages, ("/shot/lead", "/pair/lead"), strict=True)
    )
    np.testing.assert_array_equal(own, alone)
    take = open_source(tmp_path / "pair.clip.yaml").collect()
    hips = take.world().positions[:, take.rig.index("hips")]
    np.testing.assert_allclose(own[:, 0], hips, atol=1e-6)


def test_a_joint_that_the_scenes_own_character_lacks(tmp_path: Path) -> None:
    path = lead(tmp_path, "source: true", source=True)
    path.write_text(path.read_text("utf-8").replace("joint: hips", "joint: hip"))
    with pytest.raises(FormatError) as error:
        bake(path, tmp_path / "o.usdc")
    (fault,) = error.value.faults
    assert (fault.code, fault.where) == (
        "SIM053",
        "systems[0].rope.pins[0].joint.joint",
    )
    text = path.read_text("utf-8").splitlines()
    assert text[fault.lines[0] - 1][(fault.column or 0) - 1 :].startswith("hip,")
    assert not list(tmp_path.glob("o.*"))
    missing = lead(tmp_path, "offset: [0, 0, 1]", source=True)
    missing.write_text(missing.read_text("utf-8").replace(", offset: [0, 0, 0]}", "}"))
    with pytest.raises(FormatError) as error:
        load_scene(missing)
    assert error.value.code == "SCN066"


def test_it_is_below_the_character(tmp_path: Path) -> None:
    report = bake(scene(tmp_path), tmp_path / "o.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "o.usdc"))
    assert dust(stage).GetPath() == "/pair/dust"
    assert stage.GetPrimAtPath("/pair/Rig/Anim")
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 9)
    assert not validation_errors(stage)
    text = "\n".join(BAKE_TEMPLATE.text(report))
    assert "1 system of shot.scene.yaml, simulated" in text
    assert "4 joints" in text
    (mesh,) = plain_value(report)["meshes"]
    assert (mesh["kind"], mesh["prim"]) == ("particles", "/pair/dust")
    assert mesh["of"] == "shot.scene.yaml"


FORMS: dict[str, dict[str, Any]] = {
    "text.usda": {},
    "split.usda": {"form": "split"},
    "chunk.usdc": {"chunk": 4},
    "split_chunk.usdc": {"form": "split", "chunk": 4},
    "deform.usdc": {"deform": True},
    "deform_chunk.usdc": {"deform": True, "chunk": 4},
    "reduced.usdc": {"reduce": 0.01, "sparse": True},
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the scene baked without any option."""
    folder = tmp_path_factory.mktemp("plain")
    bake(scene(folder), folder / "plain.usdc")
    return folder / "plain.usdc"


@pytest.mark.slow
@pytest.mark.parametrize("name", some_quick(FORMS, 3))
def test_every_form_has_the_same(name: str, plain: Path, tmp_path: Path) -> None:
    path = scene(tmp_path)
    report = bake(path, tmp_path / name, BakeOptions(**FORMS[name]))
    for attribute in ("points", "ids", "velocities", "widths", "extent"):
        expected = values(plain, attribute)
        assert_same(expected, values(tmp_path / name, attribute))
    stage = Usd.Stage.Open(str(tmp_path / name))
    assert not validation_errors(stage)
    assert set(report.files) == set(tmp_path.glob(f"{Path(name).stem}.*"))
    assert report.result.bytes == sum(p.stat().st_size for p in report.files)
    done = animtool("validate", *map(str, report.files), cwd=tmp_path)
    assert done.code == 0, done.stdout


@pytest.mark.parametrize("options", [{}, {"chunk": 4}, {"deform": True, "chunk": 4}])
def test_a_layer_over_a_rig(
    options: dict[str, Any], plain: Path, tmp_path: Path
) -> None:
    path = scene(tmp_path)
    done = animtool("convert", "pair.rig.yaml", "pair.usda", cwd=tmp_path)
    assert done.code == 0
    rig = tmp_path / "pair.usda"
    layer = tmp_path / "layer.usdc"
    bake(path, layer, BakeOptions(rig_layer=rig, **options))
    shot = Usd.Stage.Open(str(layered(tmp_path, layer, rig)))
    assert dust(shot).GetPath() == "/pair/dust"
    expected = values(plain)
    for code, points in expected.items():
        found = np.array(dust(shot).GetAttribute("points").Get(code))
        np.testing.assert_array_equal(found, points)
    # The shot that has it is baked anew.
    bake(path, layer, BakeOptions(rig_layer=rig, overwrite=True, **options))


@pytest.mark.parametrize("source", [True, False])
def test_other_axes_and_units_show_the_same_world(source: bool, tmp_path: Path) -> None:
    path = scene(tmp_path, character=OWN if source else FILE, source=source)
    turned = BakeOptions(to_up=UpAxis.Z, to_units=LengthUnit("in"))
    bake(path, tmp_path / "y.usda")
    bake(path, tmp_path / "z.usda", turned)
    stages = [Usd.Stage.Open(str(tmp_path / name)) for name in ("y.usda", "z.usda")]
    y, z = (
        world_points(stage, str(dust(stage).GetPath()), CODES)
        * UsdGeom.GetStageMetersPerUnit(stage)
        for stage in stages
    )
    stood = np.stack([y[..., 0], -y[..., 2], y[..., 1]], axis=-1)
    np.testing.assert_allclose(z, stood, atol=1e-5)


def test_a_part_is_a_part_of_the_whole(tmp_path: Path) -> None:
    path = scene(tmp_path)
    bake(path, tmp_path / "whole.usdc")
    part = BakeOptions(frame_range=FrameRange(5, 7), samples=(Fraction(0),))
    bake(path, tmp_path / "part.usdc", part)
    fast = BakeOptions(fps=Fraction(48))
    bake(path, tmp_path / "fast.usdc", fast)
    whole = values(tmp_path / "whole.usdc")
    found = values(tmp_path / "part.usdc")
    assert list(found) == [5, 6, 7]
    assert_same({code: whole[code] for code in found}, found)
    for code, points in values(tmp_path / "fast.usdc").items():
        if code % 2 == 1:
            np.testing.assert_allclose(points, whole[(code + 1) / 2], atol=1e-3)


def test_time_codes_are_those_of_the_character(tmp_path: Path) -> None:
    options = BakeOptions(start=Fraction(1001), samples=(Fraction(-1, 4), Fraction()))
    bake(scene(tmp_path), tmp_path / "o.usdc", options)
    stage = Usd.Stage.Open(str(tmp_path / "o.usdc"))
    anim = stage.GetPrimAtPath("/pair/Rig/Anim").GetAttribute("rotations")
    assert anim.GetTimeSamples() == list(values(tmp_path / "o.usdc"))


def test_the_same_bytes_each_time(tmp_path: Path) -> None:
    path = scene(tmp_path)
    for name in ("a.usdc", "b.usdc"):
        bake(path, tmp_path / name)
    assert (tmp_path / "a.usdc").read_bytes() == (tmp_path / "b.usdc").read_bytes()


def test_several_outputs(tmp_path: Path) -> None:
    outputs = "output: [{file: a.usdc}, {file: b.usdc, deform: true}, {file: c.bvh}]\n"
    reports = bake_outputs(load_scene(scene(tmp_path, outputs)))
    assert_same(values(tmp_path / "a.usdc"), values(tmp_path / "b.usdc"))
    assert "SCN112" in {notice.code for notice in reports[2].notices}


def test_what_a_bake_would_do_is_said(tmp_path: Path) -> None:
    steps = bake_steps(create_request(scene(tmp_path), tmp_path / "x.usdc"))
    kinds = [step.kind for step in steps]
    assert kinds == [StepKind.SOURCE, StepKind.SYSTEM, StepKind.OUTPUT]
    assert steps[1].reads == ("1 emitter", "the character")
    assert "1 system" in steps[2].makes[0]


# Faults


@pytest.mark.parametrize(
    ("character", "source"),
    [("{friction: 1}", True), ("{file: a, source: true}", True), (OWN, False)],
)
def test_which_character_is_meant(character: str, source: bool, tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        load_scene(scene(tmp_path, character=character, source=source))
    (fault,) = error.value.faults
    assert fault.code == "SCN066"
    assert fault.lines


def test_a_character_without_capsules_is_said(tmp_path: Path) -> None:
    path = scene(tmp_path)
    write_pair(tmp_path)
    with pytest.raises(FormatError) as error:
        bake(path, tmp_path / "o.usdc")
    assert error.value.code == "SIM020"
    assert not list(tmp_path.glob("*.usdc"))


def test_a_library_has_no_place_for_systems(tmp_path: Path) -> None:
    with pytest.raises(OptionError) as error:
        bake(scene(tmp_path), tmp_path / "o.usdc", BakeOptions(form="library"))
    assert error.value.code == "SCN067"


@pytest.mark.parametrize(("name", "props"), [("Rig", False), ("box", True)])
def test_systems_have_places_of_their_own(
    name: str, props: bool, tmp_path: Path
) -> None:
    (tmp_path / "props.usda").write_text(PROPS, "utf-8")
    extra = "props: [{from: props.usda, prim: /box}]\n" if props else ""
    path = scene(tmp_path, extra)
    path.write_text(path.read_text("utf-8").replace("name: dust", f"name: {name}"))
    with pytest.raises(FormatError) as error:
        bake(path, tmp_path / "o.usdc")
    assert error.value.code == "SCN068"


def test_bodies_that_a_rig_layer_has_of_a_bake_are_written_again(
    tmp_path: Path,
) -> None:
    path, shot = scene(tmp_path), tmp_path / "shot.usdc"
    boxes = "bodies: [{name: a, shape: {box: {size: [1, 1, 1]}}}]"
    system = f"- rigid: {{name: rubble, prims: xforms, {boxes}}}\n"
    head = path.read_text("utf-8").split("systems:")[0]
    path.write_text(f"{head}systems:\n{system}", "utf-8")
    bake(path, shot)
    over = bake(path, tmp_path / "over.usdc", BakeOptions(rig_layer=shot))
    assert over.notices == []
    path.write_text(path.read_text("utf-8").replace("rubble", "Rig"), "utf-8")
    with pytest.raises(FormatError) as error:
        bake(path, tmp_path / "no.usdc", BakeOptions(rig_layer=shot))
    assert error.value.code == "SCN068"


@pytest.mark.parametrize("options", [{}, {"form": "split"}, {"chunk": 2}])
@pytest.mark.parametrize("deform", [False, True])
def test_nothing_is_left_where_warnings_are_errors(
    options: dict[str, Any], deform: bool, tmp_path: Path
) -> None:
    path = scene(tmp_path)
    text = path.read_text("utf-8").replace("    step: 0.01", "    max_particles: 3")
    path.write_text(text, "utf-8")
    if deform and "form" in options:
        options = {}
    given = BakeOptions(strict=True, deform=deform, **options)
    with pytest.raises(AnimtoolError) as error:
        bake(path, tmp_path / "o.usdc", given)
    assert "SIM121" in {fault.code for fault in error.value.faults}
    assert not list(tmp_path.glob("o.*"))
