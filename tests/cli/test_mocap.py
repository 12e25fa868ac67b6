"""``animtool mocap clean``: from files to files, and what it says."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool

from animtool import open_source
from animtool.mocap.clean import CleanOptions
from animtool.scene.clean import clean_source

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
    report = clean_source(root / WALK, output, CleanOptions(smooth=False))
    assert not report.notices
    before, after = (open_source(p).collect().motion for p in (root / WALK, output))
    assert abs(before.rotations.dense() - after.rotations.dense()).max() < 1e-6
