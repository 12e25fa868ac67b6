from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.bvh import random_rows, small_bvh
from support.cli import animtool


@pytest.fixture
def takes(tmp_path: Path) -> tuple[Path, Path]:
    rows = random_rows(6)
    one, two = tmp_path / "one.bvh", tmp_path / "two.bvh"
    one.write_text(small_bvh(rows))
    rows[3, 6] += 1.0
    two.write_text(small_bvh(rows))
    return one, two


def test_info_of_several_files(takes: tuple[Path, Path], tmp_path: Path) -> None:
    animtool("bake", takes[0], "-o", tmp_path / "one.usdc")
    files = (takes[0], tmp_path / "one.usdc", tmp_path / "none.bvh")
    done = animtool("info", *files, "--format", "json")
    assert done.code == 3
    assert "none.bvh" in done.stderr
    bvh, usd = json.loads(done.stdout)["files"]
    for key in (
        "joints",
        "frames",
        "fps",
        "duration",
        "animated",
        "units",
        "up",
        "roots",
    ):
        assert bvh[key] == usd[key], key
    assert (bvh["frames"], bvh["channels"], usd["channels"]) == (6, 9, None)
    for mine, theirs in zip(bvh["bounds"], usd["bounds"], strict=True):
        assert mine == pytest.approx(theirs, rel=1e-6)
    text = animtool("info", takes[0]).stdout
    assert "2 below Hips, 9 channels" in text


def test_diff(takes: tuple[Path, Path]) -> None:
    assert animtool("diff", takes[0], takes[0]).code == 0
    done = animtool("diff", *takes, "--format", "json")
    assert done.code == 1
    found = json.loads(done.stdout)
    assert found["rotation"]["joint"] == "Spine"
    assert found["rotation"]["code"] == 4
    assert found["rotation"]["value"] == pytest.approx(1.0, abs=1e-9)
    assert animtool("diff", *takes, "--tol", "1", "--tol-degrees", "1.1").code == 0
    assert "different" in animtool("diff", *takes).stdout


def test_diff_names_what_one_has_not(takes: tuple[Path, Path], tmp_path: Path) -> None:
    short = tmp_path / "short.bvh"
    text = takes[0].read_text().replace("Spine", "Tail")
    short.write_text(text.replace("Frames: 6", "Frames: 5").rsplit("\n", 2)[0] + "\n")
    found = json.loads(animtool("diff", takes[0], short, "--format", "json").stdout)
    said = " ".join(found["mismatches"])
    assert not found["same"]
    assert "Spine" in said
    assert "6 frames against 5" in said


def test_bvh_to_usd_to_bvh_to_usd(takes: tuple[Path, Path], tmp_path: Path) -> None:
    a, b, c = tmp_path / "a.usdc", tmp_path / "b.bvh", tmp_path / "c.usdc"
    for source, output in ((takes[0], a), (a, b), (b, c)):
        assert animtool("convert", source, output).code == 0
    assert animtool("diff", a, c, "--tol", "3e-8", "--tol-degrees", "2e-5").code == 0
    assert "JOINT Spine" in b.read_text()
    refused = animtool("convert", a, b)
    assert refused.code == 2
    assert animtool("convert", a, tmp_path / "d.fbx").code == 2
    report = animtool("convert", a, b, "--overwrite", "--format", "json")
    assert json.loads(report.stdout)["frames"] == 6


def test_what_a_usd_file_states_is_not_stated_again(takes: tuple[Path, Path]) -> None:
    animtool("bake", takes[0])
    done = animtool("bake", takes[0].with_suffix(".usdc"), "--units", "m", "-o", "-")
    assert done.code == 2
    assert "--to-units" in done.stderr


def test_skipping_a_clip_wants_its_rig_too(walk: Path, tmp_path: Path) -> None:
    clip, rig = tmp_path / "keys.clip.yaml", tmp_path / "keys.rig.yaml"
    rig.write_text("mine")
    refused = animtool("convert", walk, clip, "--skip-existing")
    assert refused.code == 2
    assert "keys.rig.yaml" in refused.stderr
    assert not clip.exists()
    clip.write_text("mine")
    assert animtool("convert", walk, clip, "--skip-existing").code == 0
    assert clip.read_text() == "mine"


def test_a_length_without_a_unit_is_refused(walk: Path, tmp_path: Path) -> None:
    done = animtool("convert", walk, tmp_path / "keys.clip.yaml", "--reduce", "1")
    assert done.code == 2
    assert "write 1mm or 1m" in done.stderr


def test_physics_says_that_motion_is_left_out(walk: Path, tmp_path: Path) -> None:
    done = animtool("convert", walk, tmp_path / "rig.usda", "--physics")
    assert done.code == 0
    assert "CLI104" in done.stderr
    again = animtool("convert", tmp_path / "rig.usda", tmp_path / "b.usda", "--physics")
    assert again.code == 0
    assert "CLI104" not in again.stderr
