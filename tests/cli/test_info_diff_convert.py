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
