"""What a scene will do, how far, and at what cost."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest
from support.cli import animtool

from animtool import open_source
from animtool.core.errors import OptionError
from animtool.scene.bake.request import create_request
from animtool.scene.bake.steps import StepKind, bake_steps
from animtool.scene.file.read import load_scene

SCENE = """scene: animtool/1
source: {file: walk.bvh, units: cm}
shot: {start: 1001, cut: [1001, 1010], preroll: 5}
passes:
- trim: {first: 3}
- mirror:
- trim: {last: 30}
output:
- {file: shot.usda, sparse: true, reduce: 1mm}
- {file: shot.bvh}
"""


@pytest.fixture
def shot(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    path = tmp_path / "shot.scene.yaml"
    path.write_text(SCENE, "utf-8")
    return path


def test_the_steps_of_a_scene(shot: Path) -> None:
    steps = bake_steps(create_request(shot, None))
    assert [(step.kind, Path(step.name).name, step.where) for step in steps] == [
        (StepKind.SOURCE, "walk.bvh", "source"),
        (StepKind.PASS, "trim", "passes[0].trim"),
        (StepKind.PASS, "mirror", "passes[1].mirror"),
        (StepKind.PASS, "trim", "passes[2].trim"),
        (StepKind.OUTPUT, "shot.usda", "output[0]"),
        (StepKind.OUTPUT, "shot.bvh", "output[1]"),
    ]
    source, trim, mirror, _, stage, capture = steps
    assert source.makes == ("64 frames at 30 fps", "21 joints")
    assert any("20 translations" in entry for entry in source.left_out)
    assert trim.makes == ("clock",)
    assert mirror.reads == ("rig", "joints")
    assert mirror.makes == ("joints",)
    assert "pre-roll" in trim.left_out[0]
    assert any("1001 to 1010" in entry for entry in stage.left_out)
    assert any("1 mm" in entry for entry in stage.left_out)
    assert stage.makes[1:] == (str(shot.parent / "shot.usda"),)
    assert capture.left_out == ()


def test_a_plan_runs_and_writes_nothing(shot: Path) -> None:
    before = sorted(shot.parent.iterdir())
    done = animtool("bake", shot, "--plan")
    assert done.code == 0, done.stderr
    assert sorted(shot.parent.iterdir()) == before
    assert "3  pass mirror (passes[1].mirror)\n" in done.stdout
    as_json = json.loads(animtool("bake", shot, "--plan", "--format", "json").stdout)
    assert as_json["plan"] == "animtool/1"
    assert [step["kind"] for step in as_json["steps"]] == [
        step.kind for step in bake_steps(create_request(shot, None))
    ]


def test_what_is_there_is_marked(shot: Path, walk: Path) -> None:
    out = shot.parent / "walk.usdc"
    [_, output] = bake_steps(create_request(walk, out))
    assert output.makes[1] == str(out)
    out.touch()
    [_, output] = bake_steps(create_request(walk, out))
    assert output.makes[1] == f"{out} (exists)"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), ["deformed points", "curves of controls: not requested (keep_curves)"]),
        (("--keep-curves",), ["deformed points"]),
        (("--deform",), ["skeleton and its animation", "velocities"]),
    ],
)
def test_curves_and_meshes(
    root: Path, tmp_path: Path, options: tuple[str, ...], words: list[str]
) -> None:
    clip = root / "samples/speech/speech.clip.yaml"
    done = animtool("bake", clip, "--plan", "-o", tmp_path / "o.usdc", *options)
    assert done.code == 0, done.stderr
    _, _, output = done.stdout.partition("output ")
    for word in words:
        assert f"skips {word}" in output
    assert ("keep_curves" in output) == (words[-1].startswith("curves"))


def test_a_pass_that_takes_curves_is_named(workplace: Path) -> None:
    path = workplace / "speech.scene.yaml"
    path.write_text(
        "scene: animtool/1\nsource: {file: samples/speech/speech.clip.yaml}\n"
        "passes: [{trim: {first: 3}}]\noutput: {file: o.usdc, keep_curves: true}\n",
        "utf-8",
    )
    _, trim, output = bake_steps(create_request(path, None))
    assert any("curves of controls" in entry for entry in trim.left_out)
    assert "curves of controls: the pass trim may change these" in output.left_out


def test_several_sources_are_steps(workplace: Path) -> None:
    path = workplace / "two.scene.yaml"
    path.write_text(
        "scene: animtool/1\nsource:\n- {file: samples/walk/walk.bvh}\n"
        "- {file: samples/walk/walk.bvh, tracks: {joints: [Head]}}\n",
        "utf-8",
    )
    steps = bake_steps(create_request([path, path], workplace / "o.usdc"))
    assert [step.kind for step in steps].count(StepKind.SOURCE) == 4


@pytest.mark.parametrize(
    ("stop", "names"),
    [
        ("0", []),
        ("1", ["trim"]),
        ("mirror", ["trim", "mirror"]),
        ("3", ["trim", "mirror", "trim"]),
    ],
)
def test_until_a_pass(shot: Path, stop: str, names: list[str]) -> None:
    scene = load_scene(shot).until(stop)
    assert [entry.pass_.name for entry in scene.passes] == names


@pytest.mark.parametrize("stop", ["trim", "4", "miror", ""])
def test_no_pass_to_stop_at(shot: Path, stop: str) -> None:
    with pytest.raises(OptionError) as caught:
        load_scene(shot).until(stop)
    assert caught.value.code == "SCN043"
    assert "1 trim, 2 mirror, 3 trim" in (caught.value.faults[0].hint or "")


def test_what_is_there_is_written(shot: Path) -> None:
    done = animtool("bake", shot, "--until", "0")
    assert done.code == 0, done.stderr
    ours = open_source(shot.parent / "shot.bvh").collect()
    source = open_source(shot.parent / "walk.bvh").collect()
    first = source.motion.rotations.dense()[:10]
    assert abs(ours.motion.rotations.dense() - first).max() < 1e-6
    assert animtool("bake", shot.parent / "walk.bvh", "--until", "1").code == 2


def test_what_stages_cost(workplace: Path) -> None:
    done = animtool(
        "bake",
        workplace / "samples/stride/rail.scene.yaml",
        *("--stats", "--format", "json", "-o", workplace / "o.usdc"),
    )
    assert done.code == 0, done.stderr
    source, ik, output = json.loads(done.stdout)["stats"]
    assert (source["stage"], ik["stage"]) == ("stride.clip.yaml", "ik")
    assert source["error"] is None
    assert 0 < ik["error"] < 1e-3
    assert 0 < output["error"] < 1e-5
    assert output["output"] == str(workplace / "o.usdc")
    for stage in (source, ik):
        assert (stage["peak_bytes"] is None) == (sys.platform == "win32")
        assert stage["seconds"] > 0


def test_stages_that_stream_are_counted_apart(shot: Path) -> None:
    done = animtool("bake", shot, "--stats")
    assert done.code == 0, done.stderr
    lines = done.stderr.splitlines()
    table = lines[next(i for i, line in enumerate(lines) if "peak MB" in line) :]
    assert [line.split()[0] for line in table[1:4]] == ["walk.bvh", "trim", "mirror"]
    assert all(line.split()[2].replace(".", "").isdigit() for line in table[1:5])


@pytest.mark.parametrize(
    "options", [("--plan", "--table"), ("--stats", "--plan"), ("--stats", "--table")]
)
def test_options_that_exclude_each_other(walk: Path, options: tuple[str, str]) -> None:
    assert animtool("bake", walk, *options).code == 2
