"""``animtool mocap clean``: from files to files, and what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool

from animtool import open_source
from animtool.mocap.clean_options import CleanOptions
from animtool.passes import find_pass
from animtool.scene.passed import convert_passed

WALK = "samples/walk/walk.bvh"


@pytest.mark.parametrize("suffix", ["usda", "bvh"])
def test_takes_are_cleaned(root: Path, tmp_path: Path, suffix: str) -> None:
    outputs = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for output in outputs:
        done = animtool("mocap", "clean", root / WALK, "-o", output, "--cutoff", "4")
        assert done.code == 0, done.stderr
        assert "CAP101" in done.stderr
        assert "4 Hz" in done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_a_frequency_that_makes_no_sense_writes_nothing(
    root: Path, tmp_path: Path
) -> None:
    output = tmp_path / "clean.bvh"
    done = animtool("mocap", "clean", root / WALK, "-o", output, "--cutoff", "0")
    assert done.code == 2
    assert "CAP001" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_take_without_spikes_stays(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "same.bvh"
    passes = [(find_pass("clean"), CleanOptions(keep_noise=True))]
    report = convert_passed(root / WALK, output, passes)
    assert not report.notices
    before, after = (open_source(p).collect().motion for p in (root / WALK, output))
    assert abs(before.rotations.dense() - after.rotations.dense()).max() < 1e-6


def test_feet_are_held_and_what_was_done_is_said(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "held.bvh"
    arguments = ("--feet", "hold", "--noise", "keep", "--format", "json")
    done = animtool("mocap", "clean", root / WALK, "-o", output, *arguments)
    assert done.code == 0, done.stderr
    passes = {one["pass"]: one["scores"] for one in json.loads(done.stdout)["scores"]}
    assert list(passes) == ["clean", "feet"]
    drift = next(score for score in passes["feet"] if score["name"] == "drift")
    assert drift["value"] < 1e-6
