"""Several outputs of one scene: one run, all or none, each on its own terms."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import bake, open_source
from animtool.core.errors import (
    AnimtoolError,
    FormatError,
    OptionError,
    Severity,
    StrictError,
)
from animtool.motion.passes import PASSES, FrameScope, Pass, PassContext
from animtool.motion.take import Take
from animtool.scene.bake.bake import bake_outputs
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.request import create_request
from animtool.scene.file.read import load_scene

SCENE = """scene: animtool/1
fps: 24
range: [1005, 1012]
source: {file: walk.bvh, units: cm}
passes:
- mirror:
output:
- {file: shot.usdc, start: 1001}
- {file: parts.usda, as: split, start: 1001}
- {file: shot.clip.yaml, reduce: 0.1mm, start: 1001}
- {file: shot.bvh, start: 1001}
"""
FILES = [
    "parts.anim.usdc",
    "parts.rig.usda",
    "parts.usda",
    "shot.bvh",
    "shot.clip.yaml",
    "shot.rig.yaml",
    "shot.usdc",
]


@pytest.fixture
def shot(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    path = tmp_path / "shot.scene.yaml"
    path.write_text(SCENE, "utf-8")
    return path


def made(shot: Path) -> list[str]:
    given = {"walk.bvh", "shot.scene.yaml"}
    return sorted(path.name for path in shot.parent.iterdir() if path.name not in given)


def test_all_outputs_hold_the_same_take(shot: Path) -> None:
    reports = bake_outputs(load_scene(shot))
    assert len(reports) == 4
    assert made(shot) == FILES
    wanted = open_source(shot.parent / "shot.usdc").collect()
    assert (wanted.clock.start, wanted.clock.count) == (1005, 8)
    for name, tolerance in (
        ("parts.usda", 0.0),
        ("shot.clip.yaml", 2e-4),
        ("shot.bvh", 1e-5),
    ):
        found = open_source(shot.parent / name).collect()
        assert found.clock.count == wanted.clock.count, name
        assert found.clock.rate == 24, name
        apart = found.world().positions - wanted.world().positions
        assert np.abs(apart).max() <= tolerance, name
    assert open_source(shot.parent / "shot.clip.yaml").collect().clock.start == 1005


def test_passes_run_once(shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[int] = []

    def counted(take: Take, _: object, __: PassContext) -> Take:
        runs.append(take.clock.count)
        return take

    options = type(load_scene(shot).passes[0].options)
    counting = Pass("counting", "Count", options, FrameScope.CLIP, counted)
    monkeypatch.setattr("scene.bake.test_outputs.COUNTING", counting, raising=False)
    monkeypatch.setitem(PASSES, "counting", "scene.bake.test_outputs:COUNTING")
    shot.write_text(SCENE.replace("mirror", "counting"), "utf-8")
    bake_outputs(load_scene(shot))
    assert runs == [64]


def test_an_output_that_fails_leaves_none(
    shot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("animtool.formats.bvh.write.build_bvh_text", full)
    before = made(shot)
    with pytest.raises(OSError, match="No space"):
        bake_outputs(load_scene(shot))
    assert made(shot) == before


def test_warnings_under_strict_leave_none(shot: Path) -> None:
    text = SCENE.replace("mirror:", "loop: {first: 1, last: 17}")
    shot.write_text(text, "utf-8")
    with pytest.raises(StrictError):
        bake_outputs(load_scene(shot), None, BakeOptions(strict=True))
    assert made(shot) == []


def test_accepted_warnings_are_no_warnings_under_strict(shot: Path) -> None:
    text = SCENE.replace("mirror:", "loop: {first: 1, last: 17}")
    shot.write_text(text, "utf-8")
    codes = {
        notice.code
        for report in bake_outputs(load_scene(shot), None, BakeOptions(overwrite=True))
        for notice in report.notices
        if notice.severity is Severity.WARNING
    }
    accepted = ", ".join(f"{{code: {code}, why: known}}" for code in sorted(codes))
    assert codes
    shot.write_text(f"{text}ignore: [{accepted}]\n", "utf-8")
    bake_outputs(load_scene(shot), None, BakeOptions(strict=True, overwrite=True))
    assert made(shot) == FILES


def test_every_output_is_checked_before(shot: Path) -> None:
    for name in ("shot.usdc", "shot.bvh"):
        (shot.parent / name).touch()
    with pytest.raises(OptionError) as caught:
        bake_outputs(load_scene(shot))
    said = [(f.code, Path(f.path or "").name) for f in caught.value.faults]
    assert said == [("OUT001", "shot.usdc"), ("OUT001", "shot.bvh")]
    bake_outputs(load_scene(shot), None, BakeOptions(overwrite=True))
    assert made(shot) == FILES


def test_two_outputs_of_one_file(shot: Path) -> None:
    text = SCENE.replace("parts.usda, as: split", "Shot.usdc")
    shot.write_text(text, "utf-8")
    with pytest.raises(OptionError) as caught:
        bake_outputs(load_scene(shot))
    [fault] = caught.value.faults
    assert (fault.code, fault.lines, fault.where) == ("OUT007", (9,), "output[1]")


def test_an_output_that_is_read(shot: Path) -> None:
    shot.write_text(SCENE.replace("shot.bvh", "walk.bvh"), "utf-8")
    with pytest.raises(OptionError) as caught:
        bake_outputs(load_scene(shot), None, BakeOptions(overwrite=True))
    assert caught.value.code == "OUT003"
    stage = shot.parent / "walk.usda"
    assert animtool("bake", shot.parent / "walk.bvh", "-o", stage).code == 0
    text = f"scene: animtool/1\nsource: {{file: {stage.name}}}\n"
    shot.write_text(text + f"output: {{file: {stage.name}}}\n", "utf-8")
    done = animtool("bake", shot, "--overwrite")
    assert done.code == 2
    assert "OUT003" in done.stderr


@pytest.mark.parametrize(
    ("entry", "code", "where"),
    [
        ("{start: 1001}", "DOC021", "output[4]"),
        ("{file: a.bvh, reduce: 1mm}", "SCN039", "output[4].reduce"),
        ("{file: a.clip.yaml, as: split}", "SCN039", "output[4].as"),
        ("{file: a.usdc, deform: true, chunk: 5}", "SCN039", "output[4].chunk"),
        ("{file: a.usdc, as: splt}", "DOC022", "output[4].as"),
        ("{file: a.usdc, sprase: true}", "DOC020", "output[4].sprase"),
    ],
)
def test_faults_have_the_place_of_their_output(
    shot: Path, entry: str, code: str, where: str
) -> None:
    shot.write_text(f"{SCENE}- {entry}\n", "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot)
    said = [(f.code, f.lines, f.where) for f in caught.value.faults]
    assert said == [(code, (12,), where)]


def test_the_command_line(shot: Path) -> None:
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    assert made(shot) == FILES
    for name in ("shot.usdc", "parts.usda", "shot.clip.yaml", "shot.bvh"):
        assert f"{name}: " in done.stderr
    done = animtool("bake", shot, "--skip-existing", "--format", "json")
    assert json.loads(done.stdout)["skipped"] == str(shot)
    done = animtool("bake", shot, "--overwrite", "--format", "json")
    written = json.loads(done.stdout)["written"]
    assert [("bake" in one, "convert" in one) for one in written] == [
        *[(True, False)] * 2,
        *[(False, True)] * 2,
    ]
    assert animtool("bake", shot, "-o", shot.parent / "one.usdc").code == 2


def test_files_are_known_beforehand(shot: Path) -> None:
    found = create_request(load_scene(shot), None).files
    assert sorted(path.name for path in found) == FILES


def test_one_output_that_is_no_usd(shot: Path) -> None:
    text = SCENE.partition("output")[0] + "output: {file: shot.bvh}\n"
    shot.write_text(text, "utf-8")
    assert animtool("bake", shot).code == 2
    shot.write_text(text.replace("range: [1005, 1012]\n", ""), "utf-8")
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    assert made(shot) == ["shot.bvh"]


def test_a_bake_without_an_output_writes_what_the_scene_names(shot: Path) -> None:
    report = bake(shot, None)
    assert made(shot) == FILES
    assert report.result.outputs == [shot.parent / "shot.usdc"]
    text = SCENE.partition("output")[0] + "output: {file: one.usda, start: 1001}\n"
    shot.write_text(text, "utf-8")
    loaded = load_scene(shot)
    bake(loaded, None, BakeOptions(frame_range=(1006, 1008)))
    assert open_source(shot.parent / "one.usda").collect().clock.count == 3


def test_a_bake_of_a_scene_to_no_usd_file_is_refused(shot: Path) -> None:
    text = SCENE.partition("output")[0] + "output: {file: one.bvh}\n"
    shot.write_text(text, "utf-8")
    with pytest.raises(OptionError) as caught:
        bake(shot, None)
    assert caught.value.code == "SCN044"
    assert made(shot) == []


def test_stdout_is_asked_for_by_its_name(
    shot: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    bake(shot, "-")
    assert capfdbinary.readouterr().out.startswith(b"#usda 1.0")
    assert made(shot) == []


@pytest.mark.parametrize(
    ("name", "code"), [("none/shot.bvh", "OUT002"), ("shot.mp4", "OUT004")]
)
def test_an_output_is_at_fault_where_the_scene_names_it(
    shot: Path, name: str, code: str
) -> None:
    shot.write_text(SCENE.replace("shot.bvh", name), "utf-8")
    with pytest.raises(AnimtoolError) as caught:
        bake_outputs(load_scene(shot))
    [fault] = caught.value.faults
    assert (fault.code, fault.path, fault.where) == (code, str(shot), "output[3].file")
    line = shot.read_text("utf-8").splitlines()[fault.lines[0] - 1]
    assert line[(fault.column or 0) - 1 :].startswith(name)
