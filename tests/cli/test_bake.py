from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import fields
from fractions import Fraction
from pathlib import Path

import pytest
from support.bvh import HEADER, random_rows, small_bvh
from support.cli import animtool

from animtool.cli.bake import bake
from animtool.cli.bake_options import read_bake_options
from animtool.core.errors import ExitCode
from animtool.scene.bake.options import BakeOptions


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(6)))
    return path


def test_defaults_are_those_of_the_options() -> None:
    context = bake.make_context("bake", ["take.bvh"])
    assert read_bake_options(context.params) == BakeOptions()


def test_every_option_is_reachable() -> None:
    names = {p.name for p in bake.params} | {"source", "form"}
    for field in fields(BakeOptions):
        assert field.name in names


def test_summary_in_words(take: Path, tmp_path: Path) -> None:
    done = animtool("bake", take, "-o", tmp_path / "o.usdc")
    assert (done.code, done.stdout) == (0, "")
    for said in (
        "stage (no rig layer was set)",
        "30 fps",
        "lengths in cm; the source is assumed to be in cm",
        "float32",
        "B/s of source",
    ):
        assert said in done.stderr


@pytest.mark.parametrize("value", ["1e30", "1e300"])
def test_errors_leave_out_what_is_beyond_float32(tmp_path: Path, value: str) -> None:
    text = small_bvh(random_rows(2)).splitlines()
    text[-1] = " ".join([value, *text[-1].split()[1:]])
    (tmp_path / "far.bvh").write_text("\n".join(text))
    said = animtool("bake", tmp_path / "far.bvh", "-o", tmp_path / "o.usda").stderr
    assert ("float32 (without values beyond it): " in said) is (value == "1e300")
    assert (
        "the largest float32 is written; the reported error does not count them" in said
    ) is (value == "1e300")


def test_a_scene_has_no_size_to_read_by(take: Path, tmp_path: Path) -> None:
    scene = tmp_path / "walk.scene.yaml"
    text = f"scene: animtool/1\nsource: {{file: {take.name}, units: cm}}\n"
    scene.write_text(text + "output: {file: o.usda}\n", "utf-8")
    done = animtool("bake", scene)
    assert done.code == 0, done.stderr
    assert "of source" not in done.stderr
    done = animtool("bake", scene, "--overwrite", "--format", "json")
    assert json.loads(done.stdout)["megabytes_per_second"] is None


def test_summary_in_json(take: Path, tmp_path: Path) -> None:
    done = animtool("bake", take, "-o", tmp_path / "o.usdc", "--format", "json")
    report = json.loads(done.stdout)
    assert report["bake"] == "animtool/1"
    assert (report["samples"], report["rate"], report["units"]) == (6, "30", "cm")
    assert 0 < report["error"]["relative"] < 1e-6
    assert report["error"]["joint"] in {"Hips", "Spine"}
    assert set(report["seconds"]) == {"read", "author", "save", "total"}


def test_output_props_the_source(take: Path) -> None:
    assert animtool("bake", take).code == 0
    assert take.with_suffix(".usdc").exists()


def test_one_existing_file_of_a_split_stops_all(take: Path, tmp_path: Path) -> None:
    (tmp_path / "o.rig.usda").write_text("mine")
    done = animtool("bake", take, "-o", tmp_path / "o.usda", "--split")
    assert done.code == 2
    assert not (tmp_path / "o.usda").exists()


def test_skipping_wants_every_file_of_a_split(take: Path, tmp_path: Path) -> None:
    command = ("bake", take, "-o", tmp_path / "o.usda", "--split", "--skip-existing")
    (tmp_path / "o.rig.usda").write_text("mine")
    refused = animtool(*command)
    assert refused.code == 2
    assert "o.rig.usda" in refused.stderr
    assert "skip-existing" not in refused.stderr
    (tmp_path / "o.anim.usdc").write_text("mine")
    (tmp_path / "o.usda").write_text("mine")
    assert animtool(*command).code == 0
    assert (tmp_path / "o.usda").read_text() == "mine"


@pytest.mark.parametrize(
    ("source", "output", "code"),
    [
        ("none.bvh", "o.usda", 3),
        ("folder.bvh", "o.usda", 3),
        ("take.bvh", "o.fbx", 2),
        ("take.bvh", "none/o.usda", 3),
        ("take.bvh", "folder.bvh", 3),
        ("take.bvh", "folder.bvh/../take.bvh", 2),
        ("take.xyz", "o.usda", 2),
    ],
)
def test_bad_paths(take: Path, source: str, output: str, code: int) -> None:
    folder = take.parent
    (folder / "folder.bvh").mkdir()
    (folder / "take.xyz").write_text("")
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    done = animtool("bake", source, "-o", output, cwd=folder)
    assert done.code == code, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["--as", "layer"],
        ["--as", "stage", "--rig-layer", "r.usda"],
        ["--rig-layer", "r.usda", "--bones"],
        ["--rig-layer", "r.usda", "--rest", "frame:1"],
        ["--rig-layer", "r.usda", "--to-units", "m"],
        ["--keep-samples", "--samples", "0,.5"],
        ["--prim-path", "hero"],
        ["--prim-path", "/"],
        ["--range", "100-200"],
        ["--rest", "frame:99"],
    ],
)
def test_options_that_make_no_sense(
    take: Path, tmp_path: Path, arguments: list[str]
) -> None:
    done = animtool("bake", take, "-o", tmp_path / "o.usda", *arguments)
    assert done.code == 2, done.stderr
    assert not (tmp_path / "o.usda").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--start", "1/0"],
        ["--start", "1e400"],
        ["--start", "soon"],
        ["--fps", "1e12"],
        ["--source-fps", "1e400"],
    ],
)
def test_numbers_beyond_reason(take: Path, arguments: list[str]) -> None:
    done = animtool("bake", take, "-o", "-", *arguments)
    assert done.code == 2, done.stderr


def test_a_range_beyond_the_take_is_said(take: Path, tmp_path: Path) -> None:
    done = animtool("bake", take, "-o", tmp_path / "o.usda", "--range", "5-500")
    assert done.code == 0
    assert "SCN202" in done.stderr
    strict = animtool("bake", take, "-o", "-", "--range", "5-500", "--strict")
    assert (strict.code, strict.stdout) == (1, "")


@pytest.mark.slow
def test_stdout_is_utf8_whatever_the_locale(tmp_path: Path) -> None:
    path = tmp_path / "take.bvh"
    path.write_text(
        small_bvh(random_rows(2), header=HEADER.replace("Spine", "Brüst")), "utf-8"
    )
    command = [sys.executable, "-P", "-m", "animtool", "bake", str(path), "-o", "-"]
    done = subprocess.run(
        command,
        capture_output=True,
        check=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert "Hips/Brüst" in done.stdout.decode("utf-8")


def test_the_first_frame(take: Path, tmp_path: Path) -> None:
    def first(*arguments: object) -> float:
        done = animtool(
            "bake",
            take,
            "-o",
            tmp_path / "o.usda",
            "--overwrite",
            "--format",
            "json",
            *arguments,
        )
        return float(json.loads(done.stdout)["start"])

    assert first() == 1
    (tmp_path / "animtool.toml").write_text("start = 1001")
    assert first() == 1001
    assert first("--start", "7") == 7


def test_rates(take: Path, tmp_path: Path) -> None:
    done = animtool(
        "bake", take, "-o", tmp_path / "o.usda", "--fps", "23.976", "--format", "json"
    )
    assert Fraction(json.loads(done.stdout)["rate"]) == Fraction(24000, 1001)
    odd = tmp_path / "odd.bvh"
    odd.write_text(small_bvh(random_rows(3), frame_time="1.0"))
    assert animtool("bake", odd, "--strict").code == 1
    assert animtool("bake", odd, "--strict", "--source-fps", "60").code == 0


def test_a_size_that_fits_another_unit(walk: Path, tmp_path: Path) -> None:
    done = animtool("bake", walk, "-o", tmp_path / "o.usda", "--units", "cm")
    assert "RIG217" not in done.stderr
    for command in (["info", walk], ["bake", walk, "-o", tmp_path / "m.usda"]):
        done = animtool(*command, "--units", "m")
        assert done.code == 0
        assert (
            " m, which is not plausible for a character; --units cm would make it"
            in done.stderr
        )
    text = walk.read_text().splitlines()
    for i, line in enumerate(text):
        if line.strip().startswith("OFFSET"):
            numbers = [repr(float(x) / 100) for x in line.split()[1:]]
            text[i] = " ".join(["OFFSET", *numbers])
    start = next(i for i, line in enumerate(text) if line.startswith("Frame Time"))
    for i, line in enumerate(text[start + 1 :], start + 1):
        row = line.split()
        text[i] = " ".join([*(repr(float(x) / 100) for x in row[:3]), *row[3:]])
    path = tmp_path / "metres.bvh"
    path.write_text("\n".join(text))
    done = animtool("bake", path, "--strict", "--bones")
    assert done.code == 0
    assert "RIG217" in done.stderr
    assert "--units m" in done.stderr


def test_strict_says_why_even_when_quiet(take: Path, tmp_path: Path) -> None:
    take.write_text(take.read_text().replace("Frames: 6", "Frames: 9"))
    done = animtool("bake", take, "-o", tmp_path / "o.usda", "--strict", "-q")
    assert done.code == 1
    assert f"{take}:" in done.stderr
    assert "warning: BVH101" in done.stderr


def test_more_is_said_when_asked(take: Path, tmp_path: Path) -> None:
    done = animtool("bake", take, "-o", tmp_path / "o.usda", "-v")
    assert "Frame Time" in done.stderr or "frame_time 0.0333333" in done.stderr
    assert "seconds: read" in done.stderr


def test_a_mistyped_rate_is_refused_before_the_work(take: Path, tmp_path: Path) -> None:
    take.write_text(take.read_text().replace("0.0333333", "100000"))
    done = animtool("bake", take, "-o", tmp_path / "o.usda", "--fps", "1000")
    assert done.code == 2
    assert "frames" in done.stderr


def test_a_stopped_simulation_keeps_its_frames_and_the_exit_code(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "shot.scene.yaml"
    forces = "forces: [{spring: {anchor: [0, 0, 0], k: 4000}}]"
    emitters = "emitters: [{at: [1, 0, 0], bursts: [[0, 3]], mass: 1}]"
    system = f"{{name: it, step: 0.01, method: euler, {emitters}, {forces}}}"
    text = f"scene: animtool/1\nrange: [1, 48]\nsystems: [{{particles: {system}}}]\n"
    scene.write_text(text, "utf-8")
    output = tmp_path / "o.usda"
    asked = "bake", scene, "-o", output, "--format", "json"
    done = animtool(*asked)
    assert (done.code, output.exists()) == (4, False)
    done = animtool(*asked, "--keep-stopped")
    found = json.loads(done.stdout)
    assert (done.code, output.exists()) == (4, True)
    assert [fault["code"] for fault in found["stopped"]][-1] == "SIM193"
    assert f"before frame {found['end'] + 1:g}" in done.stderr


@pytest.mark.parametrize("source", [".", "/", "takes"])
def test_a_folder_is_for_batch(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "takes").mkdir()
    done = animtool("bake", source)
    assert done.code == ExitCode.MALFORMED
    assert "IO001 cannot be read: it is a folder; animtool batch" in done.stderr


def test_an_empty_path_is_refused() -> None:
    done = animtool("bake", "")
    assert done.code == ExitCode.USAGE
    assert "the path is empty; is a variable of the shell not set?" in done.stderr


def test_a_folder_as_the_output_is_named(tmp_path: Path) -> None:
    source = tmp_path / "a.bvh"
    source.write_text(small_bvh(random_rows(3)), "utf-8")
    (tmp_path / "out").mkdir()
    done = animtool("bake", source, "-o", tmp_path / "out")
    assert done.code == ExitCode.USAGE
    assert "OUT004 is a folder" in done.stderr
    assert "out/shot.usdc" in done.stderr


def test_a_swapped_source_and_a_forgotten_o_are_usage_errors(
    tmp_path: Path, walk: Path
) -> None:
    missing = tmp_path / "new.usdc"
    swapped = animtool("bake", missing, "-o", walk)
    assert (swapped.code, "did you swap" in swapped.stderr) == (2, True)
    forgotten = animtool("bake", walk, missing)
    assert (forgotten.code, f"use -o {missing}" in forgotten.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--range", "900-901"), ("--range", "1-64", "--start 900")),
        (("--start", "1001", "--range", "1-10"), ("1001-1064", "--range 1001-1010")),
        (("--rest", "frame:0"), ("--rest", "1-64")),
    ],
)
def test_frames_outside_of_a_take_name_the_option(
    walk: Path, tmp_path: Path, arguments: tuple[str, ...], said: tuple[str, ...]
) -> None:
    done = animtool("bake", walk, "-o", tmp_path / "a.usdc", *arguments)
    assert (done.code, done.stderr.startswith(f"{walk}: CLI005")) == (2, True)
    assert all(words in done.stderr for words in said)


def test_a_variable_of_a_shell_in_a_path(tmp_path: Path) -> None:
    done = animtool("bake", "$SHOT/a.bvh", "-o", tmp_path / "a.usdc")
    assert (done.code, "IO001" in done.stderr) == (3, True)
    assert "write ${SHOT}" in done.stderr
