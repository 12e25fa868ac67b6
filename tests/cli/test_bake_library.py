"""``bake`` of several sources, and ``--take``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.bvh import random_rows, small_bvh
from support.cli import animtool
from support.clips import hero, write_clip
from support.usd import open_stage, skeleton_query, validation_errors

from animtool.usd.takes.read import read_usd

CONTROLS = """\
- {target: control/lean, interp: catmull_rom,
   keys: [{t: 1, v: 0}, {t: 3, v: 0.4}, {t: 9, v: -1}, {t: LAST, v: 1}]}
"""


@pytest.fixture
def takes(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "walk.bvh", tmp_path / "run.bvh"]
    for seed, path in enumerate(paths):
        path.write_text(small_bvh(random_rows(6 + seed, seed=seed)))
    return paths


@pytest.fixture
def clips(tmp_path: Path) -> list[Path]:
    """Return two clips of one rig."""
    assert hero(tmp_path).controls
    paths = []
    for name, last in (("sit", "13"), ("stand", "25")):
        path = write_clip(tmp_path, CONTROLS.replace("LAST", last))
        paths.append(path.rename(tmp_path / f"{name}.clip.yaml"))
    return paths


def test_the_summary_says_what_became_of_each(
    takes: list[Path], tmp_path: Path
) -> None:
    done = animtool("bake", *takes, "-o", tmp_path / "lib.usda")
    assert (done.code, done.stdout) == (0, ""), done.stderr
    for said in (
        "2 takes, frames 1 to 7 at 30 fps",
        "take walk: 6 samples, frames 1 to 6",
        "take run: 7 samples, frames 1 to 7",
        "(take '",
    ):
        assert said in done.stderr
    assert done.stderr.count("error of float32") == 3


def test_the_report_in_json_too(takes: list[Path], tmp_path: Path) -> None:
    output = tmp_path / "lib.usdc"
    done = animtool("bake", *takes, "-o", output, "--format", "json")
    report = json.loads(done.stdout)
    assert (report["samples"], report["start"], report["end"]) == (13, 1, 7)
    walk, run = report["takes"]
    assert (walk["take"], walk["source"]) == ("walk", str(takes[0]))
    assert (run["samples"], run["source_frames"], run["end"]) == (7, 7, 7)
    errors = [take["error"]["meters"] for take in report["takes"]]
    assert report["error"]["meters"] == max(errors) > 0
    assert report["error"]["take"] in {"walk", "run"}
    assert "source" not in report


def test_a_take_is_baked_out_of_a_library(takes: list[Path], tmp_path: Path) -> None:
    library = tmp_path / "lib.usda"
    assert animtool("bake", *takes, "-o", library).code == 0
    out = tmp_path / "out.usdc"
    done = animtool("bake", library, "--take", "run", "-o", out)
    assert done.code == 0, done.stderr
    assert animtool("diff", takes[1], out).code == 0
    back = tmp_path / "back.bvh"
    assert animtool("convert", library, back, "--take", "run").code == 0
    assert animtool("diff", takes[1], back).code == 0
    unknown = animtool("bake", library, "--take", "jump", "-o", tmp_path / "x.usda")
    assert unknown.code == 2
    assert "USD031" in unknown.stderr
    assert "run, walk" in unknown.stderr


def test_takes_are_listed(takes: list[Path], tmp_path: Path) -> None:
    library = tmp_path / "lib.usda"
    animtool("bake", *takes, "-o", library)
    done = animtool("info", library)
    assert "takes     run, walk; this is 'walk'" in done.stdout
    done = animtool("info", library, "--take", "run", "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert (found["takes"], found["take"], found["frames"]) == (
        ["run", "walk"],
        "run",
        7,
    )
    (found,) = json.loads(animtool("info", takes[0], "--format", "json").stdout)[
        "files"
    ]
    assert (found["takes"], found["take"]) == ([], "")


def test_a_scene_reads_a_take(takes: list[Path], tmp_path: Path) -> None:
    animtool("bake", *takes, "-o", tmp_path / "lib.usda")
    scene = tmp_path / "x.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nsource: {file: lib.usda, take: run}\n"
        "passes: [{trim: {first: 2, last: 6}}]\noutput: {file: o.usda}\n"
    )
    assert animtool("bake", scene).code == 0
    assert read_usd(tmp_path / "o.usda").collect().clock.count == 5
    # As a take itself it gives its motion; how to bake is said for all.
    scene.write_text(scene.read_text() + "fps: 12\n")
    done = animtool("bake", takes[0], scene, "-o", tmp_path / "all.usda")
    assert done.code == 0, done.stderr
    assert "CLI103" in done.stderr
    found = read_usd(tmp_path / "all.usda", take="x").collect().clock
    assert (found.count, found.fps) == (5, 30)


def test_sources_of_several_kinds(clips: list[Path], tmp_path: Path) -> None:
    assert animtool("bake", clips[0], "-o", tmp_path / "idle.usda").code == 0
    library = tmp_path / "lib.usda"
    # What is for clips is for the clips among them.
    done = animtool("bake", *clips, tmp_path / "idle.usda", "--clamp", "-o", library)
    assert done.code == 0, done.stderr
    same = (
        read_usd(library, take="idle").collect(),
        read_usd(library, take="sit").collect(),
    )
    assert np.abs(same[0].world().positions - same[1].world().positions).max() < 1e-6
    done = animtool("bake", *clips, "--units", "m", "-o", tmp_path / "x.usda")
    assert done.code == 2
    assert done.stderr.count("CLI004") == 2


@pytest.mark.parametrize("form", ["--as=stage", "--split"])
def test_curves_are_kept_of_each_take(
    clips: list[Path], tmp_path: Path, form: str
) -> None:
    library = tmp_path / "lib.usda"
    options = ["--keep-curves", "--reduce", "1mm", "--format", "json", form]
    done = animtool("bake", *clips, "-o", library, *options)
    assert done.code == 0, done.stderr
    for take, last in zip(json.loads(done.stdout)["takes"], (13, 25), strict=True):
        assert [curve["control"] for curve in take["curves"]] == ["lean"]
        assert take["curves"][0]["difference"] <= 1e-12
        assert take["reduction"]["samples"] == last
        assert take["reduction"]["kept"] == take["samples"] < last
    stage = open_stage(library)
    assert validation_errors(stage) == []
    takes = stage.GetDefaultPrim().GetVariantSet("take")
    for name, last in (("sit", 13), ("stand", 25)):
        takes.SetVariantSelection(name)
        prim = skeleton_query(stage).GetAnimQuery().GetPrim()
        assert prim.GetAttribute("animtool:control:lean").Get(last) == pytest.approx(1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "name it with -o"),
        (["--table"], "--table measures one SOURCE"),
        (["-o", "walk.txt"], "OUT004"),
        (["-o", "there.usda"], "OUT001"),
        (["-o", "-", "--split"], "CLI002"),
    ],
)
def test_what_makes_no_sense(
    takes: list[Path], tmp_path: Path, arguments: list[str], said: str
) -> None:
    (tmp_path / "there.usda").write_text("mine")
    before = sorted(tmp_path.iterdir())
    done = animtool("bake", *takes, *arguments, cwd=tmp_path)
    assert done.code == 2, done.stderr
    assert said in done.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["out.bvh", "out.clip.yaml", "o ut.glb", "o.usdc"])
@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_an_output_without_its_option(
    takes: list[Path], tmp_path: Path, name: str, options: list[str]
) -> None:
    quoted = f"'{name}'" if " " in name else name
    done = animtool("bake", takes[0], name, *options, cwd=tmp_path)
    assert done.code == 2
    assert f"{name} does not exist; to write it, use -o {quoted}" in done.stderr
    (tmp_path / name).write_bytes(b"")
    done = animtool("bake", takes[0], name, *options, cwd=tmp_path)
    assert done.code == 2
    assert f"if {name} is the output, write -o {quoted}." in done.stderr


@pytest.mark.parametrize("name", ["out.usdc", "o ut.bvh"])
def test_an_output_before_the_source_names_the_command(
    takes: list[Path], tmp_path: Path, name: str
) -> None:
    quoted = f"'{name}'" if " " in name else name
    for command in ("bake", "loop"):
        done = animtool(command, name, takes[0], cwd=tmp_path)
        assert done.code == 2
        assert f"{name} does not exist" in done.stderr
        assert f"{command} {takes[0]} -o {quoted}" in done.stderr


@pytest.mark.parametrize("command", [["retarget", "--to"], ["mocap", "solve", "--rig"]])
def test_a_source_in_place_of_the_output_is_not_to_be_overwritten(
    takes: list[Path], root: Path, command: list[str]
) -> None:
    rig = root / "rigs/biped/biped.rig.yaml"
    template = ["--template", rig] if "mocap" in command else []
    done = animtool(*command, rig, "out.usdc", "-o", takes[0], *template)
    assert done.code == 2
    assert f"out.usdc does not exist, but {takes[0]} does" in done.stderr
    assert "--overwrite" not in done.stderr


def test_no_source_is_overwritten(takes: list[Path], tmp_path: Path) -> None:
    second = tmp_path / "second.usda"
    animtool("bake", takes[1], "-o", second)
    done = animtool("bake", takes[0], second, "-o", second, "--overwrite")
    assert done.code == 2
    assert "OUT003" in done.stderr


def test_warnings_of_any_take_count_under_strict(
    takes: list[Path], tmp_path: Path
) -> None:
    takes[1].write_text(takes[1].read_text().replace("Frames: 7", "Frames: 9"))
    done = animtool("bake", *takes, "-o", tmp_path / "lib.usda", "--strict")
    assert done.code == 1
    assert "BVH101" in done.stderr
    assert not (tmp_path / "lib.usda").exists()


def test_a_library_on_stdout(takes: list[Path]) -> None:
    done = animtool("bake", *takes, "-o", "-")
    assert done.code == 0
