"""Captured motion as keys: written, read, baked, and still the same motion."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool
from support.data import data_files

from animtool import compare


@pytest.mark.parametrize("tolerance", [("0.5mm", 5e-4), ("5mm", 5e-3)])
def test_the_walk_as_keys(
    walk: Path, tmp_path: Path, tolerance: tuple[str, float]
) -> None:
    clip = tmp_path / "walk.clip.yaml"
    done = animtool("convert", walk, clip, "--reduce", tolerance[0], "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)["reduction"]
    assert found["held"]
    assert found["error"]["meters"] <= tolerance[1]
    assert found["keys"] < found["samples"] / 2
    assert (tmp_path / "walk.rig.yaml").is_file()
    baked = animtool("bake", clip, "-o", tmp_path / "walk.usdc")
    assert baked.code == 0, baked.stderr
    assert compare(walk, tmp_path / "walk.usdc").within(meters=tolerance[1], degrees=90)


def test_an_existing_rig_is_not_overwritten(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.rig.yaml").write_text("mine")
    done = animtool("convert", walk, tmp_path / "walk.clip.yaml")
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert (tmp_path / "walk.rig.yaml").read_text() == "mine"
    assert not (tmp_path / "walk.clip.yaml").exists()


@pytest.mark.parametrize("path", data_files("bvh", "pybvh_*.bvh"))
def test_captures_as_keys(path: Path, tmp_path: Path) -> None:
    clip = tmp_path / "take.clip.yaml"
    done = animtool("convert", path, clip, "--reduce", "2mm")
    assert done.code == 0, done.stderr
    baked = animtool("bake", clip, "-o", tmp_path / "take.usdc")
    assert baked.code == 0, baked.stderr
    found = compare(path, tmp_path / "take.usdc")
    assert found.within(meters=2e-3 + 1e-6, degrees=360)
