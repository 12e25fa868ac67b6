"""Props, cameras and attributes beside the character of a scene."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Usd, UsdGeom
from support.cli import Done, animtool
from support.props import prop_matrices, write_props
from support.skinned_rig import write_pair
from support.usd import validation_errors

from animtool.core.errors import FormatError
from animtool.scene.file.read import load_scene

HEAD = "scene: animtool/1\nsource: {file: walk.bvh, units: cm}\n"
BOX = "- {from: props.usda, prim: /Set/box, path: Props/box, attributes: [state]}\n"
CAMERA = "- {from: props.usda, prim: /Set/camera, path: /Cameras/main}\n"


@pytest.fixture
def folder(walk: Path, tmp_path: Path) -> Path:
    """Return a folder with a walk of 64 frames at 30 fps, and props at 24."""
    shutil.copy(walk, tmp_path / "walk.bvh")
    write_props(tmp_path / "props.usda")
    (tmp_path / "animtool.toml").touch()
    return tmp_path


def bake(folder: Path, rest: str, *flags: object, props: str = BOX + CAMERA) -> Done:
    path = folder / "shot.scene.yaml"
    path.write_text(f"{HEAD}props:\n{props}{rest}", "utf-8")
    return animtool("bake", path, *flags)


def same(
    folder: Path, output: str, times: dict[float, float], prims: dict[str, str]
) -> None:
    """Check that prims of an output are at some frames where those of props are."""
    stage = Usd.Stage.Open(str(folder / output))
    for theirs, ours in prims.items():
        expected = prop_matrices(folder / "props.usda", theirs, times.values())
        found = prop_matrices(stage, ours, times)
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


PRIMS = {"/Set/box": "/walk/Props/box", "/Set/camera": "/Cameras/main"}


def test_they_are_where_they_are(folder: Path) -> None:
    done = bake(folder, "fps: 24\nrange: [1, 40]\noutput: {file: out.usda}\n")
    assert done.code == 0, done.stderr
    assert "  beside: /walk/Props/box, /Cameras/main\n" in done.stderr
    same(folder, "out.usda", {t: t for t in range(1, 41)}, PRIMS)
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Cameras/main"))
    assert camera.GetFocalLengthAttr().Get(11) == pytest.approx(36.1)
    assert camera.GetFocusDistanceAttr().Get(11) == pytest.approx(556)
    assert camera.GetHorizontalApertureAttr().GetNumTimeSamples() == 0
    assert tuple(camera.GetClippingRangeAttr().Get()) == (1, 5000)
    state = stage.GetPrimAtPath("/walk/Props/box").GetAttribute("state")
    assert [state.Get(t) for t in (1, 19, 20, 40)] == ["dry", "dry", "wet", "wet"]
    scale = stage.GetPrimAtPath("/walk/Props/box").GetAttribute("xformOp:scale")
    assert scale.GetNumTimeSamples() == 0
    assert validation_errors(stage) == []


@pytest.mark.parametrize(
    ("passes", "times"),
    [
        ("- time_scale: {speed: 0.5}", {t: 1 + (t - 1) / 2 for t in range(1, 60)}),
        (
            "- time_scale: {speed: -1, pivot: 20}",
            {t: 52.4 - t for t in range(13, 51)},
        ),
        ("- trim: {first: 11}", {t: t for t in range(9, 40)}),
        ("- resample: {fps: 60}\n- mirror: {}", {t: t for t in range(1, 41)}),
        (
            "- time_warp: {curve: [[1, 1], [31, 11], [51, 51]]}",
            {1 + i * 0.8: 1 + i * 0.8 / 3 for i in range(0, 30, 5)},
        ),
    ],
)
def test_changes_of_time_are_theirs_too(
    folder: Path, passes: str, times: dict[float, float]
) -> None:
    start = 9 if "trim" in passes else 1
    rest = f"fps: 24\npasses:\n{passes}\noutput: {{file: out.usda, start: {start}}}\n"
    done = bake(folder, rest)
    assert done.code == 0, done.stderr
    prims = dict(PRIMS)
    if any(time != round(time) for time in times.values()):
        # Between keys the camera shears, as its matrices are blended by USD.
        del prims["/Set/camera"]
    same(folder, "out.usda", times, prims)


def test_a_shot_has_frames_of_its_own(folder: Path) -> None:
    write_props(folder / "props.usda", first=1001)
    rest = "fps: 24\nshot: {start: 1001, cut: [1005, 1030], handles: 3}\n"
    done = bake(folder, rest + "output: {file: out.usda, samples: [-0.25, 0, 0.25]}\n")
    assert done.code == 0, done.stderr
    frames = [t + o for t in range(1002, 1034) for o in (-0.25, 0, 0.25)]
    box = {"/Set/box": PRIMS["/Set/box"]}
    same(folder, "out.usda", dict(zip(frames, frames, strict=True)), box)
    same(folder, "out.usda", {t: t for t in range(1002, 1034)}, PRIMS)


def test_a_frame_that_is_named(folder: Path) -> None:
    write_props(folder / "props.usda", first=1001)
    entry = "- {from: props.usda, prim: /Set/box, path: box, frame: 1006}\n"
    rest = "fps: 24\nrange: [1, 30]\noutput: {file: out.usda}\n"
    assert bake(folder, rest, props=entry).code == 0
    times = {t: t + 1005 for t in range(1, 31)}
    same(folder, "out.usda", times, {"/Set/box": "/walk/box"})


def test_a_loop_carries_them_on(folder: Path) -> None:
    rest = "passes:\n- loop: {first: 1, last: 25, repeats: 3, blend: 4}\n"
    done = bake(folder, rest + "output: {file: out.usda}\n")
    assert done.code == 0, done.stderr
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    codes = range(1, 1 + 72)
    found = prop_matrices(stage, PRIMS["/Set/box"], codes)
    expected = prop_matrices(
        folder / "props.usda", "/Set/box", [1 + 0.8 * i for i in range(20)]
    )
    assert_allclose(found[:20], expected, atol=1e-9)
    step = np.linalg.inv(found[0]) @ found[24]
    assert_allclose(found[24:], found[:-24] @ step, atol=1e-9)
    # Over the ground and about the up axis; in height it comes back.
    assert_allclose(step[1], [0, 1, 0, 0], atol=1e-12)
    assert step[3, 1] == pytest.approx(0, abs=1e-9)
    assert np.hypot(*step[3, [0, 2]]) > 10


def test_other_units_and_axis(folder: Path) -> None:
    write_props(folder / "props.usda", unit=1.0, up="Z")
    done = bake(folder, "fps: 24\nrange: [1, 40]\noutput: {file: out.usda}\n")
    assert done.code == 0, done.stderr
    frames = range(1, 41)
    expected = prop_matrices(folder / "props.usda", "/Set/box", frames)
    expected[:, 3, :3] *= 100
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    found = prop_matrices(folder / "out.usda", "/walk/Props/box", frames)
    assert_allclose(found, expected @ turn, atol=1e-9)
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Cameras/main"))
    assert camera.GetHorizontalApertureAttr().Get() == pytest.approx(2400)
    assert camera.GetFocalLengthAttr().Get(11) == pytest.approx(3610)


def test_a_reference_shows_it(folder: Path) -> None:
    write_props(folder / "props.usda", unit=1.0)
    entry = "- {from: props.usda, prim: /Set/box, path: Props/box, reference: true}\n"
    (folder / "out").mkdir()
    rest = "fps: 24\nrange: [1, 40]\noutput: {file: out/out.usda}\n"
    assert bake(folder, rest, props=entry).code == 0
    text = (folder / "out/out.usda").read_text("utf-8")
    assert "@../props.usda@</Set/box>" in text
    assert str(folder) not in text
    stage = Usd.Stage.Open(str(folder / "out/out.usda"))
    box = UsdGeom.Cube(stage.GetPrimAtPath("/walk/Props/box"))
    assert box.GetSizeAttr().Get() == 2
    found = prop_matrices(stage, "/walk/Props/box", range(1, 41))
    expected = prop_matrices(folder / "props.usda", "/Set/box", range(1, 41))
    expected[:, :, :3] *= 100
    assert_allclose(found, expected, rtol=1e-9, atol=1e-7)


def test_a_split_stage(folder: Path) -> None:
    rest = "fps: 24\nrange: [1, 40]\noutput: {file: out.usda, as: split}\n"
    assert bake(folder, rest).code == 0
    same(folder, "out.usda", {t: t for t in range(1, 41)}, PRIMS)
    rig = (folder / "out.rig.usda").read_text("utf-8")
    assert "Props" not in rig


SET = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
    timeCodesPerSecond = 24
)
def Xform "World"
{
    def Xform "hero" (
        references = @hero.rig.usda@
    )
    {
        double xformOp:rotateX = 90
        double3 xformOp:scale = (0.01, 0.01, 0.01)
        double3 xformOp:translate = (5, 0, 0)
        uniform token[] xformOpOrder = [
            "xformOp:translate", "xformOp:rotateX", "xformOp:scale"]
    }
    def Camera "shot"
    {
        double3 xformOp:translate = (1, 2, 3)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""


def test_a_layer_over_a_shot(folder: Path) -> None:
    """What is below the character is in its space; what is not, in the stage's."""
    assert animtool("bake", folder / "walk.bvh", "-o", "hero.usda", "--split",
                    "--units", "cm", cwd=folder).code == 0  # fmt: skip
    (folder / "set.usda").write_text(SET, "utf-8")
    entries = BOX + "- {from: props.usda, prim: /Set/camera, path: /World/shot}\n"
    layer = "rig_layer: set.usda, prim_path: /World/hero, start: 1"
    rest = f"range: [1, 40]\noutput: {{file: out.usda, {layer}}}\n"
    done = bake(folder, rest, props=entries)
    assert done.code == 0, done.stderr
    text = (folder / "out.usda").read_text("utf-8")
    assert 'over "shot"' in text
    assert 'def Xform "box"' in text
    stage = Usd.Stage.Open(str(folder / "set.usda"))
    stage.GetSessionLayer().subLayerPaths = [str(folder / "out.usda")]
    frames = range(1, 41)
    hero = prop_matrices(stage, "/World/hero", [1])[0]
    expected = prop_matrices(folder / "props.usda", "/Set/box", frames)
    found = prop_matrices(stage, "/World/hero/Props/box", frames)
    assert_allclose(found, expected @ hero, atol=1e-9)
    expected = prop_matrices(folder / "props.usda", "/Set/camera", frames)
    expected[:, 3, :3] *= 0.01
    turn = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    found = prop_matrices(stage, "/World/shot", frames)
    assert_allclose(found, expected @ turn, atol=1e-9)


def test_they_are_read_back(folder: Path) -> None:
    """What is written is a source of the same."""
    rest = "fps: 24\nrange: [1, 40]\noutput: {file: out.usda}\n"
    assert bake(folder, rest).code == 0
    again = "- {from: out.usda, prim: /walk/Props/box, path: b, attributes: [state]}\n"
    again += "- {from: out.usda, prim: /Cameras/main, path: c}\n"
    assert bake(folder, rest.replace("out.", "two."), props=again).code == 0
    prims = {"/Set/box": "/walk/b", "/Set/camera": "/walk/c"}
    same(folder, "two.usda", {t: t for t in range(1, 41)}, prims)


def notices(done: Done) -> dict[str, str]:
    """Return what was said, by code."""
    found = {}
    for line in done.stderr.splitlines():
        for word in line.split():
            if word.startswith("SCN"):
                found[word] = line
    return found


def test_frames_that_they_lack_are_named(folder: Path) -> None:
    done = bake(folder, "output: {file: out.usda}\n", props=BOX)
    assert done.code == 0
    line = notices(done)["SCN107"]
    assert "4:3" in line
    assert "/walk/Props/box is constant at frames 51 to 64" in line
    done = bake(folder, "output: {file: out.usda}\n", "--strict", "--overwrite")
    assert done.code == 1
    write_props(folder / "props.usda", first=1001)
    done = bake(folder, "output: {file: other.usda}\n", props=BOX)
    assert "constant at frames 1 to 64" in notices(done)["SCN107"]
    assert "frame:" in done.stderr


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        ("{from: props.usda, prim: /Bare}", "SCN108"),
        ("{from: props.usda, prim: /Post}", "SCN109"),
        ("{from: props.usda, prim: /Set/box}", "SCN110"),
        ("{from: sheared.usda, prim: /Set/box}", "SCN111"),
        ("{from: props.usda, prim: /Set/camera}", "SCN113"),
    ],
)
def test_what_is_worth_saying(folder: Path, entry: str, code: str) -> None:
    write_props(folder / "sheared.usda", shear=True)
    rest = "range: [1, 40]\noutput: {file: out.usda}\n"
    done = bake(folder, rest, props=f"- {entry}\n")
    assert done.code == 0, done.stderr
    assert "4:3" in notices(done)[code]


def test_clips_and_captures_have_no_place_for_them(folder: Path) -> None:
    rest = "output:\n- {file: out.clip.yaml}\n- {file: out.bvh}\n- {file: out.usda}\n"
    done = bake(folder, rest, props=BOX)
    assert done.code == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if "SCN112" in line]
    assert len(lines) == 2
    assert (folder / "out.usda").exists()


@pytest.mark.parametrize(
    ("entries", "code"),
    [
        ("{from: props.usda, prim: /Set/bax}", "SCN048"),
        ("{from: props.usda, prim: /Set/box, path: a-b}", "SCN048"),
        ("{from: walk.bvh, prim: /Set/box}", "SCN048"),
        ("{from: props.usda, prim: /Set/box, attributes: [nothing]}", "SCN049"),
        ("{from: props.usda, prim: /Set/box, path: Rig}", "SCN047"),
        ("{from: props.usda, prim: /Set/box, path: /walk}", "SCN047"),
        ("{from: props.usda, prim: /Set/box, path: Rig/Skel/box}", "SCN047"),
        ("{from: no.usda, prim: /Set/box}", "DOC015"),
    ],
)
def test_what_is_refused(folder: Path, entries: str, code: str) -> None:
    done = bake(folder, "output: {file: out.usda}\n", props=f"- {entries}\n")
    assert done.code in {2, 3}
    assert code in done.stderr
    assert "shot.scene.yaml:4:" in done.stderr
    assert not (folder / "out.usda").exists()


@pytest.mark.parametrize("other", ["Props/box", "Props", "Props/box/lid"])
def test_two_at_one_place(folder: Path, other: str) -> None:
    entries = BOX + CAMERA.replace("/Cameras/main", other)
    done = bake(folder, "", props=entries)
    assert done.code == 3
    assert "SCN046" in done.stderr
    assert "shot.scene.yaml:5:" in done.stderr
    # What is the same only where the character is known.
    entries = BOX + CAMERA.replace("/Cameras/main", f"/walk/{other}")
    done = bake(folder, "output: {file: out.usda}\n", props=entries)
    assert done.code == 3
    assert "SCN046" in done.stderr
    assert "shot.scene.yaml:5:" in done.stderr


def test_every_fault_is_said_at_once(folder: Path) -> None:
    entries = "- {from: props.usda, prim: /no}\n- {from: props.usda, prim: /none}\n"
    path = folder / "shot.scene.yaml"
    path.write_text(f"{HEAD}props:\n{entries}", "utf-8")
    with pytest.raises(FormatError) as error:
        load_scene(path).open()
    assert [fault.lines for fault in error.value.faults] == [(4,), (5,)]


def test_the_plan_and_the_costs(folder: Path) -> None:
    done = bake(folder, "passes:\n- mirror: {}\noutput: {file: out.usda}\n", "--plan")
    assert "beside /Set/box of" in done.stdout
    assert "2 props with it" in done.stdout
    path = folder / "shot.scene.yaml"
    steps = json.loads(animtool("bake", path, "--plan", "--format", "json").stdout)
    kinds = [step["kind"] for step in steps["steps"]]
    assert kinds == ["source", "beside", "beside", "pass", "output"]
    assert "tracks" not in steps["steps"][3]["reads"]
    done = bake(folder, "output: {file: out.usda}\n", "--stats")
    assert "props.usda (props[0])" in done.stderr


def test_nothing_of_it_is_there_without(folder: Path) -> None:
    path = folder / "shot.scene.yaml"
    path.write_text(f"{HEAD}output: {{file: out.usda}}\n", "utf-8")
    assert animtool("bake", path, cwd=folder).code == 0
    assert "Props" not in (folder / "out.usda").read_text("utf-8")


def test_a_library_binds_them_with_its_takes(folder: Path) -> None:
    bake(folder, "fps: 24\n", "--plan", props=BOX)
    shutil.copy(folder / "walk.bvh", folder / "run.bvh")
    done = animtool("bake", folder / "shot.scene.yaml", folder / "run.bvh",
                    "-o", folder / "lib.usda", "--units", "cm")  # fmt: skip
    assert done.code == 0, done.stderr
    stage: Any = Usd.Stage.Open(str(folder / "lib.usda"))
    takes = stage.GetDefaultPrim().GetVariantSet("take")
    names = takes.GetVariantNames()
    assert takes.GetVariantSelection() == "shot"
    path = f"{stage.GetDefaultPrim().GetPath()}/Props/box"
    assert stage.GetPrimAtPath(path)
    takes.SetVariantSelection(next(name for name in names if name != "shot"))
    assert not stage.GetPrimAtPath(path)


def test_a_camera_of_the_shot_is_not_retimed(folder: Path) -> None:
    write_props(folder / "props.usda", first=1001)
    camera = CAMERA.replace("}", ", retimed: false}")
    rest = "fps: 24\nshot: {start: 1001, cut: [1005, 1030], handles: 3}\n"
    rest += "passes:\n- time_scale: {speed: 0.5}\n- trim: {first: 11}\n"
    done = bake(folder, rest + "output: {file: out.usda}\n", props=camera + BOX)
    assert done.code == 0, done.stderr
    frames = range(1002, 1034)
    camera_times = {t: t for t in frames}
    same(folder, "out.usda", camera_times, {"/Set/camera": "/Cameras/main"})
    box_times = {t: 1001 + 10 / 30 * 12 + (t - 1001) / 2 for t in frames}
    same(folder, "out.usda", box_times, {"/Set/box": "/walk/Props/box"})
    plan = animtool("bake", folder / "shot.scene.yaml", "--plan").stdout
    assert "skips changes of time by passes" in plan


@pytest.mark.parametrize("flags", [(), ("--chunk", "4")])
def test_point_caches_have_them_too(tmp_path: Path, flags: tuple[str, ...]) -> None:
    write_pair(tmp_path)
    write_props(tmp_path / "props.usda")
    text = "scene: animtool/1\nsource: {file: pair.clip.yaml}\nfps: 24\n"
    path = tmp_path / "pair.scene.yaml"
    path.write_text(f"{text}props:\n{BOX}{CAMERA}output: {{file: out.usda}}\n")
    done = animtool("bake", path, "--deform", *flags)
    assert done.code == 0, done.stderr
    prims = {"/Set/box": "/pair/Props/box", "/Set/camera": "/Cameras/main"}
    same(tmp_path, "out.usda", {t: t for t in range(1, 9)}, prims)
